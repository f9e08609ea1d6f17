#include "compile_beside.h"

#include <algorithm>
#include <system_error>
#include <utility>

namespace tr::cuda {

CompileBeside::~CompileBeside() {
    drop();
    for (std::thread &thread : threads_) thread.join();
}

std::shared_ptr<CompileBeside::Job> CompileBeside::begin(std::function<std::string()> compile) {
    auto job = std::make_shared<Job>();
    job->compile = std::move(compile);
    std::unique_lock<std::mutex> lock(mutex_);
    waiting_.push_back(job);
    if (working_ == 0) {  // those of before have come to their ends
        for (std::thread &thread : threads_) thread.join();
        threads_.clear();
    }
    if (working_ >= std::min(8u, std::max(1u, std::thread::hardware_concurrency()))) return job;
    ++working_;
    try {
        threads_.emplace_back([this] { work(); });
    } catch (const std::system_error &) {  // there may be no more threads
        if (working_ > 1) {
            --working_;
        } else {
            lock.unlock();
            work();
        }
    }
    return job;
}

const std::string &CompileBeside::wait(const Job &job) {
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [&] { return job.done; });
    if (job.error) std::rethrow_exception(job.error);
    return job.made;
}

void CompileBeside::drop() {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting_.clear();
}

void CompileBeside::work() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (!waiting_.empty()) {
        const std::shared_ptr<Job> next = std::move(waiting_.front());
        waiting_.pop_front();
        lock.unlock();
        try {
            next->made = next->compile();
        } catch (...) {
            next->error = std::current_exception();
        }
        lock.lock();
        next->done = true;
        done_.notify_all();
    }
    --working_;
}

}  // namespace tr::cuda
