#include "emulated.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <exception>
#include <functional>
#include <map>
#include <mutex>
#include <new>
#include <numeric>
#include <stdexcept>
#include <string>
#include <thread>

#include "host/parallel.h"

namespace tr {

namespace {

constexpr uint32_t Poison = 0x7fa00000;  // a signalling NaN; as an index it is far outside
constexpr size_t Alignment = 256, RedZone = 256;

// SplitMix64: Steele, Lea and Flood 2014.
uint64_t mixed(uint64_t x) {
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

void poison(char *begin, size_t bytes) {
    for (size_t i = 0; i < bytes; i += 4) std::memcpy(begin + i, &Poison, std::min<size_t>(4, bytes - i));
}

// Address space, of which pages become memory as they are touched.
class Arena {
public:
    explicit Arena(size_t capacity) : capacity_(capacity) {
        void *found = mmap(nullptr, capacity, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (found == MAP_FAILED) throw std::bad_alloc();
        begin_ = static_cast<char *>(found);
    }
    Arena(const Arena &) = delete;
    Arena &operator=(const Arena &) = delete;
    ~Arena() { munmap(begin_, capacity_); }

    void protect(bool open) {
        if (used_ != 0) mprotect(begin_, used_, open ? PROT_READ | PROT_WRITE : PROT_NONE);
    }

    // The first place that fits, between red zones. Memory has to be open, as for everything below.
    char *take(size_t bytes) {
        const size_t room = RedZone + (std::max<size_t>(bytes, 1) + Alignment - 1) / Alignment * Alignment + RedZone;
        size_t at = 0;
        for (const auto &[begin, block] : blocks_) {
            if (begin - at >= room) break;
            at = begin + block.room;
        }
        if (at + room > capacity_) throw std::bad_alloc();
        const size_t page = size_t(sysconf(_SC_PAGESIZE)), end = (at + room + page - 1) / page * page;
        if (end > used_) {
            if (mprotect(begin_ + used_, end - used_, PROT_READ | PROT_WRITE) != 0) throw std::bad_alloc();
            used_ = end;
        }
        blocks_[at] = {room, bytes};
        poison(begin_ + at, room);
        return begin_ + at + RedZone;
    }
    // False: no allocation begins there.
    bool give_back(const void *memory) {
        auto found = blocks_.find(size_t(static_cast<const char *>(memory) - begin_) - RedZone);
        if (found == blocks_.end()) return false;
        poison(begin_ + found->first, found->second.room);
        blocks_.erase(found);
        return true;
    }
    // Whether these bytes are of one allocation.
    bool holds(const void *memory, size_t bytes) const {
        const char *p = static_cast<const char *>(memory);
        if (p < begin_ || p >= begin_ + capacity_) return false;
        const size_t at = size_t(p - begin_);
        auto after = blocks_.upper_bound(at);
        if (after == blocks_.begin()) return false;
        const auto &[begin, block] = *std::prev(after);
        return at >= begin + RedZone && at + bytes <= begin + RedZone + block.bytes;
    }
    // Whether nothing was written beside an allocation.
    bool intact() const {
        return std::all_of(blocks_.begin(), blocks_.end(), [&](const auto &entry) {
            const auto &[begin, block] = entry;
            const char *p = begin_ + begin;
            return is_poison(p, 0, RedZone) && is_poison(p, RedZone + block.bytes, block.room);
        });
    }

private:
    struct Block {
        size_t room, bytes;
    };
    char *begin_ = nullptr;
    size_t capacity_, used_ = 0;
    std::map<size_t, Block> blocks_;

    static bool is_poison(const char *block, size_t from, size_t to) {
        char pattern[4];
        std::memcpy(pattern, &Poison, 4);
        for (size_t i = from; i < to; ++i)
            if (block[i] != pattern[i % 4]) return false;
        return true;
    }
};

class Emulated final : public Launcher {
public:
    explicit Emulated(const EmulatedOptions &options) : options_(options), arena_(options.capacity) {
        if (options.late) worker_ = std::thread([this] { work(); });
    }
    ~Emulated() override {
        if (!worker_.joinable()) return;
        {
            std::lock_guard<std::mutex> lock(mutex_);
            ended_ = true;
        }
        changed_.notify_all();
        worker_.join();
    }

    void *allocate(size_t bytes) override {
        const Open open(*this);
        std::lock_guard<std::mutex> lock(memory_);
        return arena_.take(bytes);
    }
    void release(void *memory) noexcept override {
        if (busy()) fail("memory is released while something that was launched may need it");
        const Open open(*this);
        std::lock_guard<std::mutex> lock(memory_);
        if (!arena_.give_back(memory)) fail("what is released was not allocated");
    }

    void upload(void *to, const void *from, size_t bytes) override {
        require(to, bytes, "an upload");
        const char *begin = static_cast<const char *>(from);
        submit([to, bytes, kept = std::vector<char>(begin, begin + bytes)] { std::memcpy(to, kept.data(), bytes); });
    }
    void download(void *to, const void *from, size_t bytes) override {
        synchronize();
        require(from, bytes, "a download");
        const Open open(*this);
        std::memcpy(to, from, bytes);
    }
    void copy(void *to, const void *from, size_t bytes) override {
        char *target = place(to, bytes);
        const char *source = place(const_cast<void *>(from), bytes);
        submit([target, source, bytes] { std::memcpy(target, source, bytes); });
    }
    void synchronize() override {
        std::unique_lock<std::mutex> lock(mutex_);
        changed_.wait(lock, [&] { return waiting_ == 0; });
        if (std::exception_ptr error = std::exchange(error_, nullptr)) std::rethrow_exception(error);
    }

private:
    const EmulatedOptions options_;
    std::mutex memory_;  // what is in the arena, and whether it is open; never held while a kernel runs
    Arena arena_;
    int open_ = 0;  // how many want it to be
    uint64_t launches_ = 0;
    std::mutex mutex_;  // everything below
    std::condition_variable changed_;
    std::deque<std::function<void()>> queue_;
    size_t waiting_ = 0;  // in the queue or at work
    bool ended_ = false;
    std::exception_ptr error_;
    std::thread worker_;

    // While one of these lives, memory can be reached.
    struct Open {
        explicit Open(Emulated &of) : of(of) {
            std::lock_guard<std::mutex> lock(of.memory_);
            if (of.open_++ == 0 && of.options_.strict) of.arena_.protect(true);
        }
        Open(const Open &) = delete;
        Open &operator=(const Open &) = delete;
        ~Open() {
            std::lock_guard<std::mutex> lock(of.memory_);
            if (--of.open_ == 0 && of.options_.strict) of.arena_.protect(false);
        }
        Emulated &of;
    };

    void launch(const Kernel &kernel, const void *functor, uint32_t n, int) override {
        kernel.pointers(functor, [&](const void *p) {
            if (p) require(p, 1, kernel.name);
        });
        const char *begin = static_cast<const char *>(functor);
        submit([this, kernel, n, order = mixed(options_.seed + ++launches_),
                kept = std::vector<char>(begin, begin + kernel.size)] { run_items(kernel, kept.data(), n, order); });
    }

    // Item number a * k + b of n, with a that has no divisor in common with n: each once.
    void run_items(const Kernel &kernel, const char *bytes, uint32_t n, uint64_t order) {
        // vectors of bytes are aligned for every plain type
        uint64_t a = order % n, b = mixed(order) % n;
        while (std::gcd(a, uint64_t(n)) != 1) a = (a + 1) % n;
        for_ranges(
            n, kernel.adds(bytes) ? 1 : options_.threads,
            [&](size_t first, size_t last, int) {
                for (size_t k = first; k < last; ++k) kernel.item(bytes, uint32_t((a * k + b) % n));
            },
            64);
        std::lock_guard<std::mutex> lock(memory_);
        if (!arena_.intact()) throw std::logic_error(std::string(kernel.name) + " has written beside an allocation");
    }

    void require(const void *memory, size_t bytes, const char *what) {
        std::lock_guard<std::mutex> lock(memory_);
        if (!arena_.holds(memory, bytes))
            throw std::logic_error(std::string(what) + ": a pointer to memory that is not the device's");
    }

    // Of a tensor, or of the device's own.
    char *place(void *memory, size_t bytes) {
        const auto address = reinterpret_cast<uintptr_t>(memory);
        if (address & EmulatedTensor) return reinterpret_cast<char *>(address & ~EmulatedTensor);
        require(memory, bytes, "a copy");
        return static_cast<char *>(memory);
    }
    void submit(std::function<void()> task) {
        if (!options_.late) return perform(task);
        {
            std::lock_guard<std::mutex> lock(mutex_);
            queue_.push_back(std::move(task));
            ++waiting_;
        }
        changed_.notify_all();
    }
    void perform(const std::function<void()> &task) {
        const Open open(*this);
        task();
    }
    void work() {
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            changed_.wait(lock, [&] { return ended_ || !queue_.empty(); });
            if (queue_.empty()) return;
            const std::function<void()> task = std::move(queue_.front());
            queue_.pop_front();
            const bool skipped = error_ != nullptr;  // as on a card, on which nothing goes on after an error
            lock.unlock();
            std::exception_ptr error;
            try {
                if (!skipped) perform(task);
            } catch (...) {
                error = std::current_exception();
            }
            lock.lock();
            if (error && !error_) error_ = error;
            --waiting_;
            changed_.notify_all();
        }
    }
    bool busy() {
        std::lock_guard<std::mutex> lock(mutex_);
        return waiting_ != 0;
    }
    void fail(const char *what) noexcept {
        std::lock_guard<std::mutex> lock(mutex_);
        if (!error_) error_ = std::make_exception_ptr(std::logic_error(what));
    }
};

}  // namespace

std::unique_ptr<Launcher> make_emulated(const EmulatedOptions &options) { return std::make_unique<Emulated>(options); }

}  // namespace tr
