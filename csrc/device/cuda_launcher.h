// Kernels on a card, through the driver. Tests have a driver of their own.
#pragma once

#include <map>
#include <memory>
#include <string>

#include "compiler.h"
#include "driver.h"
#include "launcher.h"

namespace tr::cuda {

// Where memory of cards is taken from and given back to, in place of the driver, by requests that are served or, after
// an error, not. One for no bytes asks to give the driver what nobody uses, for what it needs itself.
struct CardMemory {
    struct Request {
        size_t bytes;
        int ordinal;
        void *stream;  // of work that the memory is for
        void *memory;  // null: it is asked for, and there is none if it stays so. Else it is given back.
        int served;
    };
    void (*serve)(Request *request) = nullptr;
};

// On the primary context of the card, which others (PyTorch) share, and on its default stream unless told otherwise.
// `api` and `compiler` have to live longer. std::runtime_error, with the kernel's name, for what the driver reports;
// errors of a launch come from what is called after it.
std::unique_ptr<Launcher> make_launcher(const Api &api, const KernelCompiler &compiler, int ordinal,
                                        const CardMemory &memory = {});

// Where TORCHRENDER_CUDA_SYNC is set the host waits for every kernel, so that errors are named at their place: how
// often each was launched since the last call, and how long that took.
struct KernelTime {
    uint64_t launches = 0;
    double seconds = 0;
};
std::map<std::string, KernelTime> take_kernel_times();

}  // namespace tr::cuda
