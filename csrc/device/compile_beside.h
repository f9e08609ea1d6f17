// Kernels that are compiled at once, by threads of the host: NVRTC takes half a second to three for one. Its version
// 13.5 compiles two in the time of one on two processors, 12.9 is a quarter faster than with one thread, and 12.2 lets
// one thread compile at a time.
#pragma once

#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace tr::cuda {

class CompileBeside {
public:
    struct Job {
        std::function<std::string()> compile;
        std::string made;
        std::exception_ptr error;
        bool done = false;
    };

    CompileBeside() = default;
    CompileBeside(const CompileBeside &) = delete;
    CompileBeside &operator=(const CompileBeside &) = delete;
    // Waits for what has begun.
    ~CompileBeside();

    // In the order of the calls, as many at once as there are processors, but no more than eight, which take some
    // hundred megabytes each.
    std::shared_ptr<Job> begin(std::function<std::string()> compile);
    // What compile() has returned, or throws what it has thrown, once it is done.
    const std::string &wait(const Job &job);
    // Those that have not begun never will, and nobody may wait for them.
    void drop();

private:
    std::mutex mutex_;
    std::condition_variable done_;
    std::deque<std::shared_ptr<Job>> waiting_;
    std::vector<std::thread> threads_;
    unsigned working_ = 0;

    void work();
};

}  // namespace tr::cuda
