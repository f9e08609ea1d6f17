// Native tests: the renderer without Python, for sanitizers and debuggers.
//
//     native_tests PATH_OF_EMBREE [WORD ...]      runs the cases whose name or file contains one of the words
#include <algorithm>
#include <cstring>
#include <exception>

#include "harness.h"

#if defined(__SANITIZE_ADDRESS__)
// The leak search at exit walks the stacks of Embree's worker threads and can crash there.
extern "C" const char *__asan_default_options() { return "detect_leaks=0"; }
#endif

int main(int argc, char **argv) {
    using namespace tr::testing;
    if (argc < 2) {
        std::fprintf(stderr, "usage: %s PATH_OF_EMBREE_LIBRARY [WORD ...]\n", argv[0]);
        return 2;
    }
    embree_path() = argv[1];
    int passed = 0, failed = 0;
    for (const Case &one : cases()) {
        const auto named = [&](const char *word) { return std::strstr(one.name, word) || std::strstr(one.file, word); };
        if (argc > 2 && std::none_of(argv + 2, argv + argc, named)) continue;
        failures() = 0;
        try {
            one.run();
        } catch (const std::exception &error) {
            report("", 0, std::string("unexpected exception: ") + error.what());
        }
        if (failures()) std::printf("FAILED %s: %d checks\n", one.name, failures());
        ++(failures() ? failed : passed);
        std::fflush(stdout);
    }
    std::printf("%d passed, %d failed\n", passed, failed);
    return failed || !passed;
}
