// Native tests: the renderer without Python, for sanitizers and debuggers.
//
//     native_tests PATH_OF_EMBREE [-jN] [WORD ...]      runs the cases whose name or file contains one of the words
//
// With -jN in N processes, which take the next case when they are done with one.
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <new>

#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "harness.h"

#if defined(__SANITIZE_ADDRESS__)
// The leak search at exit walks the stacks of Embree's worker threads and can crash there.
extern "C" const char *__asan_default_options() { return "detect_leaks=0"; }
#endif

namespace {

using namespace tr::testing;

struct Progress {  // in memory that processes share
    std::atomic<size_t> next{0};
    std::atomic<int> passed{0}, failed{0};
};

void run(const Case &one, Progress &progress) {
    failures() = 0;
    try {
        one.run();
    } catch (const std::exception &error) {
        report("", 0, std::string("unexpected exception: ") + error.what());
    }
    if (failures()) std::printf("FAILED %s: %d checks\n", one.name, failures());
    ++(failures() ? progress.failed : progress.passed);
    std::fflush(stdout);
}

void work(const std::vector<Case> &chosen, Progress &progress) {
    for (size_t i; (i = progress.next++) < chosen.size();) run(chosen[i], progress);
}

}  // namespace

int main(int argc, char **argv) {
    if (argc < 2) {
        std::fprintf(stderr, "usage: %s PATH_OF_EMBREE_LIBRARY [-jN] [WORD ...]\n", argv[0]);
        return 2;
    }
    embree_path() = argv[1];
    char **words = argv + 2;
    int processes = 1;
    if (argc > 2 && !std::strncmp(*words, "-j", 2)) processes = std::atoi(*words++ + 2);
    std::vector<Case> chosen;
    for (const Case &one : cases()) {
        const auto named = [&](const char *word) { return std::strstr(one.name, word) || std::strstr(one.file, word); };
        if (words == argv + argc || std::any_of(words, argv + argc, named)) chosen.push_back(one);
    }
    void *shared = mmap(nullptr, sizeof(Progress), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (shared == MAP_FAILED) return std::perror("mmap"), 2;
    auto &progress = *new (shared) Progress;
    int crashed = 0;
    if (processes <= 1) {
        work(chosen, progress);
    } else {
        for (int i = 0; i < processes; ++i) {
            const pid_t child = fork();
            if (child < 0) return std::perror("fork"), 2;
            if (child == 0) {
                work(chosen, progress);
                std::_Exit(0);
            }
        }
        for (int status; wait(&status) > 0;) crashed += status != 0;
        if (crashed) std::printf("%d processes did not end well\n", crashed);
    }
    const int passed = progress.passed, failed = progress.failed + crashed;
    std::printf("%d passed, %d failed\n", passed, failed);
    return failed || !passed;
}
