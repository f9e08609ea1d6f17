// Large arrays of zeros that are written to here and there: gradients of textures. Each page that is touched for the
// first time is a fault, which with pages of 4 KiB takes longer than clearing it; in large pages there are 512 times
// fewer.
#pragma once

#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <new>
#include <utility>

namespace tr {

constexpr size_t LargePage = size_t(1) << 21;
// What malloc of the GNU library may keep for later is not larger; the rest comes from the system and returns there.
constexpr size_t LargeArray = size_t(32) << 20;

// Asks for large pages in a large array that has not been touched yet, where the system has them.
inline void use_large_pages([[maybe_unused]] void *memory, [[maybe_unused]] size_t bytes) {
#ifdef MADV_HUGEPAGE
    if (bytes < LargeArray) return;
    uintptr_t page = uintptr_t(sysconf(_SC_PAGESIZE)), begin = (uintptr_t(memory) + page - 1) / page * page,
              end = (uintptr_t(memory) + bytes) / page * page;
    // a wish: where it is not granted everything is slower, but right
    (void)madvise(reinterpret_cast<void *>(begin), size_t(end - begin), MADV_HUGEPAGE);
#endif
}

template <class S>
class Zeros {
public:
    // Throws std::bad_alloc.
    explicit Zeros(size_t n) {
        size_t bytes = n * sizeof(S);
        if (bytes < LargeArray) {
            data_ = static_cast<S *>(std::calloc(n ? n : 1, sizeof(S)));
            if (!data_) throw std::bad_alloc();
            return;
        }
        mapped_ = bytes + LargePage;
        mapping_ = mmap(nullptr, mapped_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (mapping_ == MAP_FAILED) throw std::bad_alloc();
        uintptr_t begin = (uintptr_t(mapping_) + LargePage - 1) / LargePage * LargePage;
        data_ = reinterpret_cast<S *>(begin);
        use_large_pages(data_, bytes);
    }
    Zeros(Zeros &&other) noexcept
        : data_(std::exchange(other.data_, nullptr)), mapping_(other.mapping_), mapped_(other.mapped_) {}
    Zeros &operator=(Zeros &&) = delete;
    ~Zeros() {
        if (!data_) return;
        if (mapped_)
            munmap(mapping_, mapped_);
        else
            std::free(data_);
    }
    S *data() const { return data_; }

private:
    S *data_ = nullptr;
    void *mapping_ = nullptr;
    size_t mapped_ = 0;
};

}  // namespace tr
