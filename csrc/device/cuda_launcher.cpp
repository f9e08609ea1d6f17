#include "cuda_launcher.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <utility>
#include <vector>

#include "compile_beside.h"

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
            for (auto &[name, loaded] : modules_)
                if (loaded.module) api_.ModuleUnload(loaded.module);
            Context before;
            api_.CtxPopCurrent(&before);
        }
        api_.DevicePrimaryCtxRelease(device_);
    }

    void *allocate(size_t bytes) override {
        if (memory_.serve) {
            CardMemory::Request request{std::max<size_t>(bytes, 1), ordinal_, static_cast<void *>(stream_), nullptr, 0};
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
        start_waiting();
        busy_ = true;
        // of pageable memory it was read when this returns
        check(api_, api_.MemcpyHtoDAsync(address(to), from, bytes, stream_), "copying to " + card_.name);
    }
    void download(void *to, const void *from, size_t bytes) override {
        const Current current(*this);
        start_waiting();
        check(api_, api_.MemcpyDtoHAsync(to, address(from), bytes, stream_), "copying from " + card_.name);
        wait();
    }
    void copy(void *to, const void *from, size_t bytes) override {
        const Current current(*this);
        start_waiting();
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
        start_waiting();
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
    // What a kernel was compiled to, once that is done: until then launches of it wait, and so do all behind these.
    struct Loaded {
        Module module = nullptr;
        Function function = nullptr;
        std::shared_ptr<CompileBeside::Job> code;
    };
    struct Waiting {
        const Kernel &kernel;
        Loaded &loaded;
        std::vector<std::max_align_t> functor;
        uint32_t n;
    };
    std::map<std::string, Loaded> modules_;                   // by kernel and all that it was compiled for
    std::map<std::pair<const char *, int>, Loaded *> known_;  // those for these facts, by kernel and BSDF
    std::vector<Waiting> waiting_;
    CompileBeside compiling_;
    std::string last_;  // what was launched
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

    Loaded &loaded(const Kernel &kernel, int bsdf) {
        if (!knows_bsdf(kernel.knows)) bsdf = -1;
        Loaded *&known = known_[{kernel.name, bsdf}];
        if (known) return *known;
        const std::vector<std::string> options = facts_.options(kernel.knows, bsdf);
        std::string key = kernel.name;
        for (const std::string &option : options) key += option;
        known = &modules_[key];
        if (!known->function && !known->code)
            known->code = compiling_.begin(
                [this, options, &kernel] { return compiler_.for_card(kernel, card_.capability, options); });
        return *known;
    }
    void load(const Kernel &kernel, Loaded &to) {
        if (to.function) return;
        const std::string &code = compiling_.wait(*to.code), doing = std::string("loading ") + kernel.name;
        check(api_, api_.ModuleLoadData(&to.module, code.data()), doing);
        check(api_, api_.ModuleGetFunction(&to.function, to.module, KernelCompiler::EntryPoint), doing);
        to.code = nullptr;
    }

    void launch(const Kernel &kernel, const void *functor, uint32_t n, int bsdf) override {
        const Current current(*this);
        Loaded &to = loaded(kernel, bsdf);
        if (to.function && waiting_.empty()) return start(kernel, to, functor, n);
        std::vector<std::max_align_t> kept((kernel.size - 1) / sizeof(std::max_align_t) + 1);
        std::memcpy(kept.data(), functor, kernel.size);
        waiting_.push_back({kernel, to, std::move(kept), n});
        busy_ = true;
        if (waits_) start_waiting();
    }
    // In their order. Where one fails the others are forgotten, and what is not loaded is compiled anew when it is
    // launched again.
    void start_waiting() {
        const std::vector<Waiting> all = std::exchange(waiting_, {});
        try {
            for (const Waiting &each : all) {
                load(each.kernel, each.loaded);
                start(each.kernel, each.loaded, each.functor.data(), each.n);
            }
        } catch (...) {
            compiling_.drop(), known_.clear();
            for (auto at = modules_.begin(); at != modules_.end();) {
                if (at->second.function) {
                    ++at;
                    continue;
                }
                if (at->second.module) api_.ModuleUnload(at->second.module);
                at = modules_.erase(at);
            }
            throw;
        }
    }
    bool gives_room() const {
        CardMemory::Request request{0, ordinal_, static_cast<void *>(stream_), nullptr, 0};
        if (memory_.serve) memory_.serve(&request);
        return request.served != 0;
    }
    void start(const Kernel &kernel, const Loaded &loaded, const void *functor, uint32_t n) {
        const unsigned most = unsigned(card_.multiprocessors) * BlocksPerMultiprocessor,
                       threads = kernel.blocks ? BlockSize : Threads,
                       blocks = std::min(kernel.blocks ? n : (n - 1) / Threads + 1, most);
        void *parameters[] = {const_cast<void *>(functor), &n};
        last_ = kernel.name, busy_ = true;
        const auto begin = std::chrono::steady_clock::now();
        const auto launched = [&] {
            return api_.LaunchKernel(loaded.function, blocks, 1, 1, threads, 1, 1, 0, stream_, parameters, nullptr);
        };
        Result result = launched();
        if (result == OutOfMemory && gives_room()) result = launched();  // stacks of all threads are the driver's
        check(api_, result, "launching " + last_);
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
