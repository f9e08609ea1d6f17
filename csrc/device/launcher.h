// A device's memory, and launches of kernels on it. Everything happens in the order of the calls, but later: only
// `download` and `synchronize` wait. Used by one thread at a time.
#pragma once

#include <new>
#include <utility>
#include <vector>

#include "kernel.h"
#include "scene_facts.h"

namespace tr {

// What is left to say when batches cannot be smaller.
struct DeviceMemoryError : std::bad_alloc {
    const char *what() const noexcept override {
        return "the device has not enough memory for this scene and image: smaller textures, meshes and films take "
               "less, and so do parts of a film (crop)";
    }
};

class Launcher {
public:
    Launcher() = default;
    Launcher(const Launcher &) = delete;
    Launcher &operator=(const Launcher &) = delete;
    virtual ~Launcher() = default;

    // Aligned to 256 bytes; what is in it is undefined. std::bad_alloc if there is no room.
    virtual void *allocate(size_t bytes) = 0;
    // Nothing that was launched may still need it: there was a download or synchronize since.
    virtual void release(void *memory) noexcept = 0;
    // Memory of the host that is copied from and to without detours. std::bad_alloc if there is none.
    virtual void *allocate_host(size_t bytes) { return ::operator new(bytes); }
    virtual void release_host(void *memory) noexcept { ::operator delete(memory); }
    // `from` is of the host and may be changed after the call, but what `allocate_host` returned not before the device
    // is done.
    virtual void upload(void *to, const void *from, size_t bytes) = 0;
    virtual void download(void *to, const void *from, size_t bytes) = 0;
    // Of the device, of which one may be a tensor of PyTorch's that is said to lie there.
    virtual void copy(void *to, const void *from, size_t bytes) = 0;
    virtual void synchronize() = 0;

    // Whether kernels may be given the addresses of such tensors.
    virtual bool reaches_tensors() const { return false; }
    // In whose order everything happens from now on; 0: the device's own.
    virtual void use_stream(uintptr_t) {}

    // Bytes that the paths of a batch should take.
    virtual size_t batch_memory() const { return size_t(16) << 20; }

    // Of each small sum that many items add to at once, so many are kept.
    virtual uint32_t gradient_copies() const { return 4; }

    // What kernels are compiled for from now on, where they are compiled at all.
    virtual void know(const SceneFacts &) {}

    // The items 0 .. n - 1. `bsdf`: the kind that the kernel shades, where it has to know that.
    template <class K>
    void run(const K &kernel, uint32_t n, int bsdf = -1) {
        if (n != 0) launch(kernel_of<K>(), &kernel, n, bsdf);
    }

private:
    virtual void launch(const Kernel &kernel, const void *functor, uint32_t n, int bsdf) = 0;
};

// Memory of the host for copies, which is released with its owner. The launcher has to live longer.
class HostBuffer {
public:
    HostBuffer() = default;
    HostBuffer(HostBuffer &&other) noexcept { *this = std::move(other); }
    HostBuffer &operator=(HostBuffer &&other) noexcept {
        std::swap(launcher_, other.launcher_), std::swap(at_, other.at_), std::swap(capacity_, other.capacity_);
        return *this;
    }
    ~HostBuffer() {
        if (at_) launcher_->release_host(at_);
    }
    // Room for so many bytes; if there was less, what was there is lost, once the device is done with it.
    void *reserve(Launcher &launcher, size_t bytes) {
        if (bytes > capacity_ || !at_) {
            if (at_) launcher_->synchronize();
            *this = HostBuffer();
            at_ = launcher.allocate_host(bytes);
            launcher_ = &launcher, capacity_ = bytes;
        }
        return at_;
    }
    void *get() const { return at_; }

private:
    Launcher *launcher_ = nullptr;
    void *at_ = nullptr;
    size_t capacity_ = 0;
};

// Memory of a device that is released with its owner. The launcher has to live longer.
template <class T>
class DeviceArray {
public:
    DeviceArray() = default;
    DeviceArray(Launcher &launcher, size_t n) { reserve(launcher, n); }
    DeviceArray(DeviceArray &&other) noexcept { swap(other); }
    DeviceArray &operator=(DeviceArray &&other) noexcept {
        swap(other);
        return *this;
    }
    DeviceArray(const DeviceArray &) = delete;
    DeviceArray &operator=(const DeviceArray &) = delete;
    ~DeviceArray() {
        if (at_) launcher_->release(static_cast<void *>(at_));
    }

    // Room for n of them, of none of which there is no address. If there was less, what was there is lost, once the
    // device is done with it.
    void reserve(Launcher &launcher, size_t n) {
        if (n <= capacity_) return;
        if (at_) launcher_->synchronize();
        DeviceArray().swap(*this);
        at_ = static_cast<T *>(launcher.allocate(n * sizeof(T)));
        launcher_ = &launcher, capacity_ = n;
    }
    void upload(Launcher &launcher, const T *from, size_t n) {
        reserve(launcher, n);
        if (n != 0) launcher.upload(static_cast<void *>(at_), static_cast<const void *>(from), n * sizeof(T));
    }
    // The same of a tensor that is `there`, see Launcher::copy, or of the host.
    void take(Launcher &launcher, const T *from, size_t n, bool there) {
        if (!there) return upload(launcher, from, n);
        reserve(launcher, n);
        if (n != 0) launcher.copy(static_cast<void *>(at_), static_cast<const void *>(from), n * sizeof(T));
    }
    void download(T *to, size_t n) const {
        if (n != 0) launcher_->download(static_cast<void *>(to), static_cast<const void *>(at_), n * sizeof(T));
    }
    T *get() const { return at_; }

private:
    Launcher *launcher_ = nullptr;
    T *at_ = nullptr;
    size_t capacity_ = 0;

    void swap(DeviceArray &other) noexcept {
        std::swap(launcher_, other.launcher_), std::swap(at_, other.at_), std::swap(capacity_, other.capacity_);
    }
};

}  // namespace tr
