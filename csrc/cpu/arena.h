// Memory of structures of arrays: columns of one allocation, aligned for packets, that live as long as a thread
// renders.
#pragma once

#include <cstdlib>
#include <memory>
#include <new>

#include "core/state/columns.h"

namespace tr {

class Arena {
public:
    Arena() = default;
    Arena(Arena &&) = default;
    Arena &operator=(Arena &&) = default;

    // All arrays of some structs of columns, with room for n entries.
    template <class... Columns>
    void allocate(size_t n, Columns &...columns) {
        declare([&](Arena &arena) {
            auto add = [&](auto &of) { of.for_arrays([&](auto *&array) { arena.array(array, n); }); };
            (add(columns), ...);
        });
    }
    // Two passes over the same list of arrays: with no memory the first one counts.
    template <class Declare>
    void declare(Declare &&list) {
        used_ = 0;
        memory_.reset();
        list(*this);
        size_t size = used_ + 64;
        memory_.reset(static_cast<char *>(std::aligned_alloc(64, (size + 63) / 64 * 64)));
        if (!memory_) throw std::bad_alloc();
        used_ = 0;
        list(*this);
    }
    template <class T>
    void array(T *&pointer, size_t n) {
        pointer = memory_ ? reinterpret_cast<T *>(memory_.get() + used_) : nullptr;  // no arithmetic on a null pointer
        used_ += (n * sizeof(T) + 63) / 64 * 64;
    }

private:
    struct Free {
        void operator()(char *p) const { std::free(p); }
    };
    std::unique_ptr<char, Free> memory_;
    size_t used_ = 0;
};

}  // namespace tr
