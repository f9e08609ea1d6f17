#include "team.h"

#include <atomic>
#include <system_error>
#include <thread>
#include <vector>

#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace tr {

namespace {

OpenMp openmp;
// A forked process has the memory of OpenMP's threads, but not the threads: it would wait for them for ever.
std::atomic<bool> forked{false};

struct Team {
    int n;
    const Member &body, &absent;

    // As member `number` of those who are there; the first one cares for the others.
    void take_part(int number, int there) const {
        if (number > 0) {
            if (number < n) body(number);
            return;
        }
        std::vector<std::thread> others;
        int next = there;
        try {
            for (; next < n; ++next) others.emplace_back(body, next);
        } catch (const std::system_error &) {  // no more threads to be had
            for (; next < n; ++next) absent(next);
        }
        body(0);
        for (std::thread &t : others) t.join();
    }
};

void take_part(void *team) { static_cast<const Team *>(team)->take_part(openmp.number(), openmp.size()); }

}  // namespace

void use_openmp(const OpenMp &functions) {
#if defined(__unix__) || defined(__APPLE__)
    [[maybe_unused]] static const int watched = pthread_atfork(nullptr, nullptr, [] { forked = true; });
#endif
    openmp = functions;
}

void run_team(int n, const Member &body, const Member &absent) {
    Team team{n, body, absent};
    if (n > 1 && openmp.parallel && !forked)
        openmp.parallel(take_part, &team, unsigned(n), 0);
    else
        team.take_part(0, 1);
}

}  // namespace tr
