// A device that is none: kernels run on the host's threads. It is there to find mistakes, and hostile therefore.
#pragma once

#include <memory>

#include "launcher.h"

namespace tr {

struct EmulatedOptions {
    // The memory is out of reach but for kernels and copies: whoever else reads or writes there gets a segmentation
    // fault. Not while something that was launched late is at work.
    bool strict = true;
    // A thread of its own works off what is launched, so that the caller is ahead of the device.
    bool late = true;
    int threads = 2;
    uint64_t seed = 1;                  // of the order of a launch's items
    size_t capacity = size_t(1) << 34;  // of the memory: address space, pages are taken as they are used
};

// In addresses of tensors that are said to lie on the device, and lie in the host's memory: nobody else can follow
// them.
constexpr uintptr_t EmulatedTensor = uintptr_t(1) << 62;

// Fresh memory is full of signalling NaN, and so is what lies around an allocation. std::logic_error, if need be later
// (from synchronize, say), for a kernel with a pointer to other memory, for what was written beside an allocation, and
// for memory that is released while something launched may need it.
std::unique_ptr<Launcher> make_emulated(const EmulatedOptions &options = {});

}  // namespace tr
