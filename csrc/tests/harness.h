// A few lines of test framework: cases register themselves, checks count, main() prints "N passed, M failed".
#pragma once

#include <cmath>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

namespace tr::testing {

struct Case {
    const char *name, *file;
    std::function<void()> run;
};

inline std::vector<Case> &cases() {
    static std::vector<Case> all;
    return all;
}

struct Register {
    Register(const char *name, const char *file, std::function<void()> run) {
        cases().push_back({name, file, std::move(run)});
    }
};

// Failed checks of the running case.
inline int &failures() {
    static int n = 0;
    return n;
}

// The Embree library that was named on the command line.
inline std::string &embree_path() {
    static std::string path;
    return path;
}

inline void report(const char *file, int line, const std::string &what) {
    if (++failures() <= 10) std::printf("  %s:%d: %s\n", file, line, what.c_str());
}

inline void check(bool good, const char *text, const char *file, int line) {
    if (!good) report(file, line, std::string("is false: ") + text);
}

inline void check_near(double a, double b, double tolerance, const char *text, const char *file, int line) {
    if (std::abs(a - b) <= tolerance) return;  // also fails for NaN
    char values[160];
    std::snprintf(values, sizeof values, ": %.9g and %.9g differ by more than %.3g", a, b, tolerance);
    report(file, line, text + std::string(values));
}

}  // namespace tr::testing

#define TR_TEST(name)                                                            \
    static void name();                                                          \
    static const ::tr::testing::Register register_##name{#name, __FILE__, name}; \
    static void name()
#define CHECK(condition) tr::testing::check((condition), #condition, __FILE__, __LINE__)
#define CHECK_NEAR(a, b, tolerance) tr::testing::check_near((a), (b), (tolerance), #a " ~ " #b, __FILE__, __LINE__)
// The statement must throw `type` with a message that contains `words`.
#define CHECK_THROWS(statement, type, words)                                                  \
    do {                                                                                      \
        bool right = false;                                                                   \
        std::string message = "nothing was thrown";                                           \
        try {                                                                                 \
            statement;                                                                        \
        } catch (const type &error) {                                                         \
            message = error.what();                                                           \
            right = message.find(words) != std::string::npos;                                 \
        }                                                                                     \
        if (!right) tr::testing::report(__FILE__, __LINE__, #statement " (" + message + ")"); \
    } while (0)
