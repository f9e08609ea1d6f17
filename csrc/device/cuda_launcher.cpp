#include "cuda_launcher.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <stdexcept>
#include <utility>

namespace tr::cuda {

namespace {

constexpr unsigned Threads = 128, BlocksPerMultiprocessor = 16;

bool waits_for_kernels() {
    const char *given = std::getenv("TORCHRENDER_CUDA_SYNC");
    return given && *given && std::strcmp(given, "0") != 0;
}

std::mutex times_mutex;
std::map<std::string, KernelTime> times;

void add_time(const char *kernel, double seconds) {
    const std::lock_guard<std::mutex> lock(times_mutex);
    KernelTime &of = times[kernel];
    ++of.launches, of.seconds += seconds;
}

class CardLauncher final : public Launcher {
public:
    CardLauncher(const Api &api, const KernelCompiler &compiler, int ordinal, const CardMemory &memory)
        : api_(api), compiler_(compiler), card_(card(api, ordinal)), ordinal_(ordinal), memory_(memory) {
        check(api_, api_.DeviceGet(&device_, ordinal), "looking for a card");
        check(api_, api_.DevicePrimaryCtxRetain(&context_, device_), "starting to use " + card_.name);
    }
    ~CardLauncher() override {
        if (api_.CtxPushCurrent(context_) == Success) {
            for (auto &[name, loaded] : modules_) api_.ModuleUnload(loaded.first);
            Context before;
            api_.CtxPopCurrent(&before);
        }
        api_.DevicePrimaryCtxRelease(device_);
    }

    void *allocate(size_t bytes) override {
        if (memory_.serve) {
            CardMemory::Request request{bytes, ordinal_, static_cast<void *>(stream_), nullptr, 0};
            busy_ = true;  // it may be used by what went before on this stream
            memory_.serve(&request);
            if (!request.served)
                throw std::runtime_error("taking memory of " + card_.name + " from PyTorch was interrupted");
            if (!request.memory) throw std::bad_alloc();
            return request.memory;
        }
        const Current current(*this);
        DevicePointer memory = 0;
        check(api_, api_.MemAlloc(&memory, std::max<size_t>(bytes, 1)), "reserving memory");
        return reinterpret_cast<void *>(memory);
    }
    void release(void *memory) noexcept override {
        if (memory_.serve) {
            CardMemory::Request request{0, ordinal_, static_cast<void *>(stream_), memory, 0};
            return memory_.serve(&request);
        }
        if (api_.CtxPushCurrent(context_) != Success) return;
        api_.MemFree(address(memory));
        Context before;
        api_.CtxPopCurrent(&before);
    }
    void *allocate_host(size_t bytes) override {
        const Current current(*this);
        void *memory = nullptr;
        check(api_, api_.MemHostAlloc(&memory, std::max<size_t>(bytes, 1), 0), "reserving memory of the host");
        return memory;
    }
    void release_host(void *memory) noexcept override {
        if (api_.CtxPushCurrent(context_) != Success) return;
        api_.MemFreeHost(memory);
        Context before;
        api_.CtxPopCurrent(&before);
    }
    void upload(void *to, const void *from, size_t bytes) override {
        const Current current(*this);
        busy_ = true;
        // of pageable memory it was read when this returns
        check(api_, api_.MemcpyHtoDAsync(address(to), from, bytes, stream_), "copying to " + card_.name);
    }
    void download(void *to, const void *from, size_t bytes) override {
        const Current current(*this);
        check(api_, api_.MemcpyDtoHAsync(to, address(from), bytes, stream_), "copying from " + card_.name);
        wait();
    }
    void copy(void *to, const void *from, size_t bytes) override {
        const Current current(*this);
        busy_ = true;
        check(api_, api_.MemcpyDtoDAsync(address(to), address(from), bytes, stream_), "copying on " + card_.name);
    }
    bool reaches_tensors() const override { return true; }  // PyTorch's are in the same context
    void use_stream(uintptr_t stream) override {
        const auto other = reinterpret_cast<Stream>(stream);
        if (other == stream_) return;
        if (busy_) synchronize();
        stream_ = other;
    }
    size_t batch_memory() const override { return size_t(512) << 20; }
    uint32_t gradient_copies() const override { return 1024; }
    void know(const SceneFacts &facts) override {
        facts_ = facts;
        known_.clear();
    }
    void synchronize() override {
        const Current current(*this);
        wait();
    }

private:
    const Api &api_;
    const KernelCompiler &compiler_;
    const Card card_;
    const int ordinal_;
    const CardMemory memory_;
    Stream stream_ = nullptr;
    bool busy_ = false;  // something that it was given may not be done
    Device device_ = 0;
    Context context_ = nullptr;
    SceneFacts facts_;
    std::map<std::pair<const char *, int>, Function> known_;      // compiled for these facts, by kernel and BSDF
    std::map<std::string, std::pair<Module, Function>> modules_;  // by kernel and all that it was compiled for
    std::string last_;                                            // what was launched
    const bool waits_ = waits_for_kernels();

    struct Current {
        explicit Current(const CardLauncher &of) : api(of.api_) {
            check(api, api.CtxPushCurrent(of.context_), "using " + of.card_.name);
        }
        Current(const Current &) = delete;
        Current &operator=(const Current &) = delete;
        ~Current() {
            Context before;
            api.CtxPopCurrent(&before);
        }
        const Api &api;
    };

    static DevicePointer address(const void *memory) { return reinterpret_cast<DevicePointer>(memory); }
    void wait() {
        check(api_, api_.StreamSynchronize(stream_), last_.empty() ? "waiting for the card" : "running " + last_);
        busy_ = false;
    }

    Function function(const Kernel &kernel, int bsdf) {
        if (!knows_bsdf(kernel.knows)) bsdf = -1;
        Function &known = known_[{kernel.name, bsdf}];
        if (!known) known = load(kernel, facts_.options(kernel.knows, bsdf));
        return known;
    }
    Function load(const Kernel &kernel, const std::vector<std::string> &options) {
        std::string key = kernel.name;
        for (const std::string &option : options) key += option;
        auto found = modules_.find(key);
        if (found != modules_.end()) return found->second.second;
        const std::string code = compiler_.for_card(kernel, card_.capability, options),
                          doing = std::string("loading ") + kernel.name;
        std::pair<Module, Function> loaded;
        check(api_, api_.ModuleLoadData(&loaded.first, code.data()), doing);
        modules_[key] = loaded;  // unloaded also if the function is not in it
        check(api_, api_.ModuleGetFunction(&loaded.second, loaded.first, KernelCompiler::EntryPoint), doing);
        modules_[key] = loaded;
        return loaded.second;
    }

    void launch(const Kernel &kernel, const void *functor, uint32_t n, int bsdf) override {
        const Current current(*this);
        const Function entry = function(kernel, bsdf);
        const unsigned most = unsigned(card_.multiprocessors) * BlocksPerMultiprocessor,
                       threads = kernel.blocks ? BlockSize : Threads,
                       blocks = std::min(kernel.blocks ? n : (n - 1) / Threads + 1, most);
        void *parameters[] = {const_cast<void *>(functor), &n};
        last_ = kernel.name, busy_ = true;
        const auto begin = std::chrono::steady_clock::now();
        check(api_, api_.LaunchKernel(entry, blocks, 1, 1, threads, 1, 1, 0, stream_, parameters, nullptr),
              "launching " + last_);
        if (!waits_) return;
        wait();
        const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        add_time(kernel.name, seconds);
    }
};

}  // namespace

std::map<std::string, KernelTime> take_kernel_times() {
    const std::lock_guard<std::mutex> lock(times_mutex);
    return std::exchange(times, {});
}

std::unique_ptr<Launcher> make_launcher(const Api &api, const KernelCompiler &compiler, int ordinal,
                                        const CardMemory &memory) {
    return std::make_unique<CardLauncher>(api, compiler, ordinal, memory);
}

}  // namespace tr::cuda
