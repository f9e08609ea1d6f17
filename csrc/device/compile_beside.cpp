#include "compile_beside.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

namespace tr::cuda {

namespace {

struct Turns {
    std::mutex mutex;
    std::condition_variable freed;
    unsigned left = std::min(8u, std::max(1u, std::thread::hardware_concurrency()));
};

Turns &turns() {
    static auto *const all = new Turns;  // threads may need it when the process ends
    return *all;
}

class Turn {
public:
    Turn() {
        std::unique_lock<std::mutex> lock(turns().mutex);
        turns().freed.wait(lock, [] { return turns().left > 0; });
        --turns().left;
    }
    Turn(const Turn &) = delete;
    Turn &operator=(const Turn &) = delete;
    ~Turn() {
        {
            const std::lock_guard<std::mutex> lock(turns().mutex);
            ++turns().left;
        }
        turns().freed.notify_one();
    }
};

}  // namespace

std::future<std::string> compile_beside(std::function<std::string()> compile) {
    return std::async(std::launch::async, [compile = std::move(compile)] {
        const Turn turn;
        return compile();
    });
}

}  // namespace tr::cuda
