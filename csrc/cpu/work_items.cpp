#include "work_items.h"

#include <atomic>
#include <chrono>
#include <exception>
#include <stdexcept>

#include "host/team.h"

namespace tr {

void run_items(size_t n_items, int threads, Assignment assignment, const std::function<bool(double)> &interrupted,
               bool &was_interrupted, const std::function<ItemWork(int)> &make) {
    std::atomic<size_t> next{0}, done{0};
    std::atomic<bool> stop{false};
    std::exception_ptr error;
    std::mutex mutex;
    std::condition_variable finished;
    auto fail = [&](std::exception_ptr why) {
        std::lock_guard<std::mutex> lock(mutex);
        if (!error) error = std::move(why);
        stop = true;
    };
    auto poll = [&] {
        if (!stop && interrupted && interrupted(double(done) / double(n_items))) {
            was_interrupted = true;
            stop = true;
        }
    };
    auto body = [&](int thread) {
        try {
            const ItemWork work = make(thread);
            const Stop stopped = [&, thread] {
                if (thread == 0) poll();
                return stop.load();
            };
            bool fixed = assignment == Assignment::Interleaved;
            for (size_t item = fixed ? size_t(thread) : next++; item < n_items && !stop;
                 item = fixed ? item + size_t(threads) : next++) {
                work(item, stopped);
                ++done;
            }
        } catch (...) {
            fail(std::current_exception());
        }
    };
    const int n = int(std::clamp<size_t>(n_items, 1, size_t(std::max(1, threads))));
    int running = n - 1;
    auto leave = [&] {
        std::lock_guard<std::mutex> lock(mutex);
        --running;
        finished.notify_one();
    };
    auto part = [&](int thread) {
        body(thread);
        if (thread > 0) return leave();
        std::unique_lock<std::mutex> lock(mutex);
        while (running > 0) {
            finished.wait_for(lock, std::chrono::milliseconds(20));
            lock.unlock();
            poll();
            lock.lock();
        }
    };
    run_team(n, part, [&](int) {
        fail(std::make_exception_ptr(std::runtime_error("there are no more threads to be had")));
        leave();
    });
    if (error) std::rethrow_exception(error);
}

void OrderedMerge::push(size_t item, std::vector<FilmBlock> &&blocks, const Stop &stop) {
    std::unique_lock<std::mutex> lock(mutex_);
    while (item != next_ && waiting_.size() >= limit_) {
        merged_.wait_for(lock, std::chrono::milliseconds(5));
        lock.unlock();
        bool stopped = stop();
        lock.lock();
        if (stopped) return;
    }
    waiting_.emplace(item, std::move(blocks));
    for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(next_)) {
        WorkItem work = schedule_.work_item(next_);
        for (size_t u = 0; u < work.size(); ++u) film_.add(schedule_.tile(work.tile_of(u)), it->second[u]);
        waiting_.erase(it);
        ++next_;
        merged_.notify_all();
    }
}

}  // namespace tr
