#include "team.h"

#include <atomic>
#include <condition_variable>
#include <mutex>
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

// Where members wait for the last one. OpenMP's own wait spins for milliseconds: where other programs want the
// processors, the one that is waited for does not get this one.
class Meeting {
public:
    // With so many members, of which this is one.
    void wait_for(int members) {
        if (++arrived_ == members) {
            const std::lock_guard<std::mutex> lock(mutex_);
            all_.notify_all();
            return;
        }
        for (int i = 0; i < ShortSpin; ++i)
            if (arrived_ == members) return;
        std::unique_lock<std::mutex> lock(mutex_);
        all_.wait(lock, [&] { return arrived_ == members; });
    }

private:
    static constexpr int ShortSpin = 20000;  // ten microseconds or so, less than waking up takes
    std::atomic<int> arrived_{0};
    std::mutex mutex_;
    std::condition_variable all_;
};

struct Team {
    int n;
    const Member &body, &absent;
    Meeting meeting{};

    // As member `number` of those who are there; the first one cares for the others.
    void take_part(int number, int there) {
        if (number > 0) {
            if (number < n) body(number);
            return meeting.wait_for(there);
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
        meeting.wait_for(there);
    }
};

void take_part(void *team) { static_cast<Team *>(team)->take_part(openmp.number(), openmp.size()); }

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
