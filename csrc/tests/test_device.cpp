// Launchers: the emulated one's traps, the card's calls of a driver that is none, compiling and keeping kernels.
#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <thread>

#include "device/cuda_launcher.h"
#include "device/emulated.h"
#include "device/ray_kernels.h"
#include "device/sha256.h"
#include "device_kernels.h"
#include "find_nvrtc.h"
#include "harness.h"

namespace tr::testing {

namespace {

constexpr EmulatedOptions AllModes[] = {{false, false, 1}, {true, false, 2}, {false, true, 3}, {true, true, 4}};

// Whether the process of its own that does this dies of a segmentation fault.
template <class Do>
bool faults(Do &&f) {
    std::fflush(stdout);
    const pid_t child = fork();
    if (child == 0) {
        const auto fault = [](int) { _exit(33); };
        signal(SIGSEGV, fault), signal(SIGBUS, fault);
        f();
        _exit(0);
    }
    int status = 0;
    waitpid(child, &status, 0);
    return WIFEXITED(status) && WEXITSTATUS(status) == 33;
}

// Only on a device that is the host.
struct WaitForHost {
    static constexpr const char *Name = "tr::testing::WaitForHost", *Header = "";
    std::atomic<bool> *begun;
    const std::atomic<bool> *go;
    void operator()(uint32_t) const {
        *begun = true;
        while (!*go) std::this_thread::yield();
    }
    template <class Visit>
    void for_pointers(Visit &&) const {}
};

struct TemporaryFolder {
    std::string path = "/tmp/torchrender_device_XXXXXX";
    TemporaryFolder() { CHECK(mkdtemp(path.data()) != nullptr); }
    ~TemporaryFolder() {
        for (const std::string &name : files()) std::remove((path + "/" + name).c_str());
        rmdir(path.c_str());
    }
    TemporaryFolder(const TemporaryFolder &) = delete;
    TemporaryFolder &operator=(const TemporaryFolder &) = delete;
    std::vector<std::string> files() const {
        std::vector<std::string> names;
        DIR *folder = opendir(path.c_str());
        while (const dirent *found = readdir(folder))
            if (found->d_name[0] != '.') names.emplace_back(found->d_name);
        closedir(folder);
        return names;
    }
};

}  // namespace

TR_TEST(emulated_kernels_reach_every_item_once) {
    for (const EmulatedOptions &options : AllModes) {
        const auto device = make_emulated(options);
        for (uint32_t n : {0u, 1u, 2u, 7u, 64u, 1000u, 4099u}) {
            std::vector<float> numbers(n);
            std::iota(numbers.begin(), numbers.end(), 0.f);
            DeviceArray<float> array;
            array.upload(*device, numbers.data(), n);
            numbers.assign(n, -1.f);  // it was copied
            device->run(AddOne{array.get()}, n);
            device->run(AddOne{array.get()}, n);
            array.download(numbers.data(), n);
            for (uint32_t i = 0; i < n; ++i) CHECK(numbers[i] == float(i) + 2);
        }
    }
}

TR_TEST(emulated_items_are_shuffled) {
    const auto device = make_emulated({true, false, 1});
    const uint32_t n = 100, zero = 0;
    DeviceArray<uint32_t> counter, order(*device, n);
    counter.upload(*device, &zero, 1);
    std::vector<uint32_t> first(n), second(n);
    for (auto *found : {&first, &second}) {
        counter.upload(*device, &zero, 1);
        device->run(NoteOrder{counter.get(), order.get()}, n);
        order.download(found->data(), n);
    }
    CHECK(first != second);
    for (auto *found : {&first, &second}) {
        CHECK(!std::is_sorted(found->begin(), found->end()));
        std::sort(found->begin(), found->end());
        for (uint32_t i = 0; i < n; ++i) CHECK((*found)[i] == i);
    }
}

TR_TEST(emulated_memory_is_out_of_reach) {
    CHECK(faults([] {
        const auto device = make_emulated({true, false, 1});
        DeviceArray<float> array(*device, 10);
        *static_cast<volatile float *>(array.get()) = 1;
    }));
    CHECK(!faults([] {
        const auto device = make_emulated({false, false, 1});
        DeviceArray<float> array(*device, 10);
        *static_cast<volatile float *>(array.get()) = 1;
    }));
}

TR_TEST(emulated_memory_is_poisoned) {
    const auto device = make_emulated();
    for (int round = 0; round < 2; ++round) {
        DeviceArray<float> array(*device, 1001);
        std::vector<float> numbers(1001, 0.f);
        array.download(numbers.data(), numbers.size());
        for (float x : numbers) CHECK(std::isnan(x));
        numbers.assign(1001, 1.f);
        array.upload(*device, numbers.data(), numbers.size());
        device->synchronize();
    }
}

TR_TEST(emulated_device_refuses_memory_of_the_host) {
    for (const EmulatedOptions &options : AllModes) {
        const auto device = make_emulated(options);
        std::vector<float> host(4);
        CHECK_THROWS(device->run(AddOne{host.data()}, 4), std::logic_error,
                     "tr::testing::AddOne: a pointer to memory that is not the device's");
        CHECK_THROWS(device->upload(host.data(), host.data(), 4), std::logic_error, "an upload");
        DeviceArray<float> array(*device, 4);
        CHECK_THROWS(device->download(host.data(), array.get(), 20), std::logic_error, "a download");
        CHECK_THROWS(device->run(AddOne{array.get() + 4}, 1), std::logic_error, "not the device's");
    }
}

// Tensors that are said to lie on the device have addresses that nobody else can follow.
TR_TEST(emulated_device_copies_tensors) {
    for (const EmulatedOptions &options : AllModes) {
        const auto device = make_emulated(options);
        std::vector<float> from{1, 2, 3, 4}, to(4);
        const auto there = [](std::vector<float> &host) {
            return reinterpret_cast<float *>(reinterpret_cast<uintptr_t>(host.data()) | EmulatedTensor);
        };
        DeviceArray<float> array(*device, 4), more(*device, 4);
        device->copy(array.get(), there(from), 4 * sizeof(float));
        device->run(AddOne{array.get()}, 4);
        device->copy(more.get(), array.get(), 4 * sizeof(float));
        device->copy(there(to), more.get(), 4 * sizeof(float));
        device->synchronize();
        CHECK((to == std::vector<float>{2, 3, 4, 5}));
        CHECK(!device->reaches_tensors());
        CHECK_THROWS(device->run(AddOne{there(from)}, 4), std::logic_error, "not the device's");
        CHECK_THROWS(device->copy(array.get(), from.data(), 16), std::logic_error, "a copy: a pointer to memory");
        CHECK_THROWS(device->copy(array.get() + 1, there(from), 16), std::logic_error, "a copy: a pointer to memory");
        CHECK_THROWS(device->upload(there(to), from.data(), 16), std::logic_error, "an upload");
    }
}

TR_TEST(emulated_device_finds_what_is_written_beside) {
    for (const EmulatedOptions &options : AllModes) {
        const auto device = make_emulated(options);
        for (int32_t beside : {-1, 5}) {
            DeviceArray<float> array(*device, 5);
            CHECK_THROWS((device->run(WriteAt{array.get(), beside}, 1), device->synchronize()), std::logic_error,
                         "tr::testing::WriteAt has written beside an allocation");
        }
    }
}

TR_TEST(emulated_launches_come_late) {
    const auto device = make_emulated({false, true, 1});
    const float zero = 0;
    float found = 1;
    DeviceArray<float> array(*device, 1), other(*device, 1);
    array.upload(*device, &zero, 1);
    std::atomic<bool> begun{false}, go{false};
    const auto run_until_go = [&] {
        begun = go = false;
        device->run(WaitForHost{&begun, &go}, 1);
        while (!begun) std::this_thread::yield();
    };
    run_until_go();
    device->run(AddOne{array.get()}, 1);
    go = true;  // what was launched waits for this thread, which did not wait for it
    array.download(&found, 1);
    CHECK(found == 1);
    run_until_go();
    other = DeviceArray<float>();
    go = true;
    CHECK_THROWS(device->synchronize(), std::logic_error, "released while something that was launched may need it");
    device->synchronize();
}

TR_TEST(sha256_of_known_texts) {
    CHECK(sha256("") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    CHECK(sha256("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    CHECK(sha256("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq") ==
          "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
    CHECK(sha256(std::string(1000000, 'a')) == "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TR_TEST(compiled_kernels_are_kept) {
    const TemporaryFolder folder;
    const KernelCache cache(folder.path, 1000);
    CHECK(!cache.find("a"));
    cache.put("a", std::string("one\0two", 7));
    CHECK(cache.find("a") == std::string("one\0two", 7));
    CHECK(folder.files() == std::vector<std::string>{"a.cubin"});
    // what is not whole is none
    const std::string path = folder.path + "/a.cubin";
    CHECK(truncate(path.c_str(), 70) == 0);
    CHECK(!cache.find("a"));
    // the one that was not used for longest goes
    cache.put("a", std::string(300, 'a'));
    cache.put("b", std::string(300, 'b'));
    const timespec old[] = {{1000, 0}, {1000, 0}}, older[] = {{500, 0}, {500, 0}};
    utimensat(AT_FDCWD, path.c_str(), older, 0);
    utimensat(AT_FDCWD, (folder.path + "/b.cubin").c_str(), old, 0);
    CHECK(cache.find("a").has_value());
    cache.put("c", std::string(300, 'c'));
    CHECK(cache.find("a") && !cache.find("b") && cache.find("c"));
    // a place that cannot be written to
    const KernelCache none("/proc/torchrender_none");
    none.put("a", "x");
    CHECK(!none.find("a"));
}

TR_TEST(translation_units_of_kernels_check_sizes) {
    const std::string unit = cuda::KernelCompiler::unit(kernel_of<WriteAt>());
    CHECK(unit.find("#include \"tests/device_kernels.h\"\n") == 0);
    CHECK(unit.find("sizeof(tr::testing::WriteAt) == 16 && alignof(tr::testing::WriteAt) == 8") != std::string::npos);
}

// -------------------------------------------------------------------------------------------------- a driver of our
// own
namespace {

// What is called, and what is to go wrong. Memory is the host's; a launch runs the kernel that was asked for.
struct FakeDriver {
    std::string calls;
    int version = 12020, cards = 1;
    cuda::Result init = 0, launch = 0, wait = 0;
    int contexts = 0, allocations = 0;
    unsigned grid = 0;
    cuda::Stream stream = nullptr;  // of what was asked last
} fake;

cuda::Api fake_api() {
    using namespace cuda;
    Api api;
    api.Init = [](unsigned) { return fake.init; };
    api.DriverGetVersion = [](int *version) { return *version = fake.version, 0; };
    api.GetErrorName = [](Result, const char **name) { return *name = "CUDA_ERROR_TESTED", 0; };
    api.GetErrorString = [](Result, const char **text) { return *text = "an error of the test", 0; };
    api.DeviceGetCount = [](int *count) { return *count = fake.cards, 0; };
    api.DeviceGet = [](Device *device, int ordinal) { return *device = ordinal + 100, 0; };
    api.DeviceGetName = [](char *name, int, Device) { return std::strcpy(name, "Test Card"), 0; };
    api.DeviceGetAttribute = [](int *value, Attribute which, Device) {
        return *value = which == ComputeCapabilityMajor ? 9 : which == ComputeCapabilityMinor ? 0 : 2, 0;
    };
    api.DevicePrimaryCtxRetain = [](Context *context, Device device) {
        CHECK(device == 100);
        *context = reinterpret_cast<Context>(&fake);
        return fake.calls += "retain ", 0;
    };
    api.DevicePrimaryCtxRelease = [](Device) { return fake.calls += "let go ", 0; };
    api.CtxPushCurrent = [](Context context) {
        CHECK(context == reinterpret_cast<Context>(&fake));
        return ++fake.contexts, 0;
    };
    api.CtxPopCurrent = [](Context *) { return --fake.contexts, 0; };
    api.ModuleLoadData = [](Module *module, const void *image) {
        fake.calls += "load:" + std::string(static_cast<const char *>(image)) + " ";
        return *module = reinterpret_cast<Module>(&fake), 0;
    };
    api.ModuleUnload = [](Module) { return fake.calls += "unload ", 0; };
    api.ModuleGetFunction = [](Function *function, Module, const char *name) {
        CHECK(!std::strcmp(name, KernelCompiler::EntryPoint));
        return *function = reinterpret_cast<Function>(&fake), 0;
    };
    api.MemAlloc = [](DevicePointer *memory, size_t bytes) {
        if (bytes > 1000000) return int(OutOfMemory);
        ++fake.allocations;
        return *memory = reinterpret_cast<DevicePointer>(std::malloc(bytes)), 0;
    };
    api.MemFree = [](DevicePointer memory) {
        --fake.allocations;
        return std::free(reinterpret_cast<void *>(memory)), 0;
    };
    api.MemHostAlloc = [](void **memory, size_t bytes, unsigned) {
        ++fake.allocations;
        return *memory = std::malloc(bytes), 0;
    };
    api.MemFreeHost = [](void *memory) {
        --fake.allocations;
        return std::free(memory), 0;
    };
    api.MemcpyHtoDAsync = [](DevicePointer to, const void *from, size_t bytes, Stream) {
        return std::memcpy(reinterpret_cast<void *>(to), from, bytes), 0;
    };
    api.MemcpyDtoHAsync = [](void *to, DevicePointer from, size_t bytes, Stream) {
        return std::memcpy(to, reinterpret_cast<void *>(from), bytes), 0;
    };
    api.MemcpyDtoDAsync = [](DevicePointer to, DevicePointer from, size_t bytes, Stream stream) {
        fake.stream = stream;
        return std::memcpy(reinterpret_cast<void *>(to), reinterpret_cast<void *>(from), bytes), 0;
    };
    api.StreamSynchronize = [](Stream stream) {
        fake.stream = stream;
        return fake.wait;
    };
    api.LaunchKernel = [](Function, unsigned grid, unsigned, unsigned, unsigned block, unsigned, unsigned, unsigned,
                          Stream, void **parameters, void **) {
        fake.grid = grid;
        CHECK(fake.contexts == 1 && block % 32 == 0);
        for (uint32_t i = 0; i < *static_cast<unsigned *>(parameters[1]); ++i)
            (*static_cast<const AddOne *>(parameters[0]))(i);
        return fake.launch;
    };
    return api;
}

}  // namespace

TR_TEST(drivers_that_cannot_be_used_are_named) {
    fake = {};
    const cuda::Api api = fake_api();
    cuda::check_version(api), cuda::start(api);
    CHECK(cuda::driver_version(api) == "12.2");
    const cuda::Card card = cuda::card(api, 0);
    CHECK(card.name == "Test Card" && card.capability == 90 && card.multiprocessors == 2);
    fake.version = 11080;
    CHECK_THROWS(cuda::check_version(api), std::runtime_error,
                 "made for CUDA 11.8, expected at least 12.0; install driver 525 or newer");
    fake.version = 13000, fake.cards = 0;
    CHECK_THROWS(cuda::start(api), std::runtime_error, "finds no card; see what nvidia-smi");
    fake.cards = 1, fake.init = cuda::NoDevice;
    CHECK_THROWS(cuda::start(api), std::runtime_error, "finds no card");
    fake.init = 999;
    CHECK_THROWS(cuda::start(api), std::runtime_error,
                 "CUDA reported an error while starting the NVIDIA driver: an error of the test (CUDA_ERROR_TESTED)");
}

TR_TEST(cards_are_driven) {
    const std::unique_ptr<cuda::Nvrtc> nvrtc = find_nvrtc();
    if (!nvrtc) return;
    fake = {};
    const cuda::Api api = fake_api();
    const TemporaryFolder folder;
    const cuda::KernelCompiler compiler(nvrtc.get(), sources(), KernelCache(folder.path));
    {
        const auto device = cuda::make_launcher(api, compiler, 0);
        const std::vector<float> numbers(5000, 1.f);
        std::vector<float> found(5000);
        DeviceArray<float> array;
        array.upload(*device, numbers.data(), numbers.size());
        device->run(AddOne{array.get()}, 5000);
        CHECK(fake.grid == 0);  // it is compiled first
        device->synchronize();
        CHECK(fake.grid == 32);  // 16 blocks a multiprocessor, although 40 would be as many as there are items
        device->run(AddOne{array.get()}, 100);
        CHECK(fake.grid == 1);
        array.download(found.data(), found.size());
        CHECK(found.front() == 3 && found.back() == 2);
        std::vector<float> tensor(5000);  // of this driver's memory, as good as any
        const auto stream = reinterpret_cast<uintptr_t>(&tensor);
        device->use_stream(stream), fake.stream = nullptr;
        device->copy(tensor.data(), array.get(), 5000 * sizeof(float));
        CHECK(tensor == found && device->reaches_tensors());
        CHECK(fake.stream == reinterpret_cast<cuda::Stream>(stream));
        device->use_stream(0);  // who changes streams waits for the one before, if need be
        CHECK(fake.stream == reinterpret_cast<cuda::Stream>(stream));
        device->synchronize();
        CHECK(fake.stream == nullptr);
        device->use_stream(stream), device->use_stream(0);
        CHECK(fake.stream == nullptr);
        CHECK_THROWS(device->allocate(2000000), std::bad_alloc, "");
        fake.wait = 700;
        CHECK_THROWS(device->synchronize(), std::runtime_error, "while running tr::testing::AddOne: an error of the");
        fake.launch = 701;
        CHECK_THROWS(device->run(AddOne{array.get()}, 1), std::runtime_error, "while launching tr::testing::AddOne");
    }
    CHECK(fake.contexts == 0 && fake.allocations == 0);
    CHECK(fake.calls ==
          "retain load:\x7f"
          "ELF\x2\x1\x1\x33\a unload let go ");
    CHECK(folder.files().size() == 1);
}

TR_TEST(what_was_launched_waits_for_its_kernel_in_order) {
    const std::unique_ptr<cuda::Nvrtc> nvrtc = find_nvrtc();
    fake = {};
    const cuda::Api api = fake_api();
    const TemporaryFolder folder;
    const std::vector<float> numbers(10, 1.f), others(10, 5.f);
    std::vector<float> found(10);
    {
        const cuda::KernelCompiler compiler(nullptr, sources(), KernelCache(folder.path));
        const auto device = cuda::make_launcher(api, compiler, 0);
        DeviceArray<float> array;
        array.upload(*device, numbers.data(), 10);
        for (int time = 0; time < 2; ++time) {  // each launch tells anew that there is no compiler
            device->run(AddOne{array.get()}, 10), device->run(AddOne{array.get()}, 10);
            CHECK_THROWS(array.download(found.data(), 10), std::runtime_error, "there is no NVRTC to compile");
            array.download(found.data(), 10);
            CHECK(found == numbers);
        }
    }
    if (!nvrtc) return;
    const cuda::KernelCompiler compiler(nvrtc.get(), sources(), KernelCache(folder.path));
    const auto device = cuda::make_launcher(api, compiler, 0);
    DeviceArray<float> array;
    array.upload(*device, numbers.data(), 10);
    device->run(AddOne{array.get()}, 10), device->run(AddOne{array.get()}, 5);
    CHECK(fake.grid == 0);
    std::vector<float> copied(10);
    device->copy(copied.data(), array.get(), 10 * sizeof(float));  // behind the launches
    CHECK(fake.grid == 1 && copied[4] == 3 && copied[5] == 2);
    device->run(AddOne{array.get()}, 10);
    array.upload(*device, others.data(), 10);
    array.download(found.data(), 10);
    CHECK(found == others);
}

TR_TEST(memory_of_cards_may_be_anothers) {
    fake = {};
    const cuda::Api api = fake_api();
    const TemporaryFolder folder;
    const cuda::KernelCompiler compiler(nullptr, sources(), KernelCache(folder.path));
    static int taken;
    taken = 0;
    cuda::CardMemory memory;
    memory.serve = [](cuda::CardMemory::Request *request) {
        if (request->bytes == 1002) return;  // an error
        CHECK(request->ordinal == 0 && (request->memory || request->stream == &taken));
        request->served = 1;
        if (request->memory)
            --taken, std::free(request->memory);
        else if (request->bytes <= 1000)
            ++taken, request->memory = std::malloc(request->bytes);
    };
    const auto device = cuda::make_launcher(api, compiler, 0, memory);
    device->use_stream(reinterpret_cast<uintptr_t>(&taken));
    {
        const std::vector<float> numbers(10, 2.f);
        std::vector<float> found(10);
        DeviceArray<float> array;
        array.upload(*device, numbers.data(), 10);
        array.download(found.data(), 10);
        CHECK(taken == 1 && fake.allocations == 0 && found == numbers);
        CHECK_THROWS(device->allocate(1001), std::bad_alloc, "");
        CHECK_THROWS(device->allocate(1002), std::runtime_error, "from PyTorch was interrupted");
        fake.stream = nullptr;
        device->use_stream(0);  // memory may have been in use on the stream that it was taken for
        CHECK(fake.stream == reinterpret_cast<cuda::Stream>(&taken));
    }
    CHECK(taken == 0);
}

TR_TEST(drivers_that_lack_memory_for_a_launch_are_given_some) {
    const std::unique_ptr<cuda::Nvrtc> nvrtc = find_nvrtc();
    if (!nvrtc) return;
    fake = {};
    const cuda::Api api = fake_api();
    const TemporaryFolder folder;
    const cuda::KernelCompiler compiler(nvrtc.get(), sources(), KernelCache(folder.path));
    static bool some;
    cuda::CardMemory memory;
    memory.serve = [](cuda::CardMemory::Request *request) {
        request->served = 1;
        if (request->memory)
            std::free(request->memory);
        else if (request->bytes != 0)
            request->memory = std::malloc(request->bytes);
        else if (some)
            fake.launch = 0;
    };
    const auto device = cuda::make_launcher(api, compiler, 0, memory);
    DeviceArray<float> array(*device, 10);
    some = true, fake.launch = cuda::OutOfMemory;
    device->run(AddOne{array.get()}, 10), device->synchronize();
    CHECK(fake.launch == 0);
    some = false, fake.launch = cuda::OutOfMemory;
    CHECK_THROWS(device->run(AddOne{array.get()}, 10), std::bad_alloc, "");
    fake.launch = 0;
}

TR_TEST(kernels_that_know_a_scene_are_compiled_for_each) {
    SceneFacts plain, curved;
    plain.shape_flags = HasNormals, curved.shape_flags = HasNormals | IsSphere;
    CHECK(plain.options(Knowledge::Nothing, -1).empty());
    const auto has = [](const std::vector<std::string> &options, const char *option) {
        return std::find(options.begin(), options.end(), option) != options.end();
    };
    plain.emitters = 5;
    CHECK(has(plain.options(Knowledge::Scene, -1), "-DTR_EMITTER_KINDS=5u"));
    CHECK(has(plain.options(Knowledge::Shapes, -1), "-DTR_EMITTER_KINDS=0u"));
    SceneFacts recorded = plain;
    recorded.records = recorded.motion = true;
    CHECK(plain.options(Knowledge::Scene, -1) == recorded.options(Knowledge::Scene, -1));
    for (const Knowledge shades : {Knowledge::Paths, Knowledge::Bsdf, Knowledge::Derivative})
        CHECK(plain.options(shades, 0) != recorded.options(shades, 0));
    CHECK(has(plain.options(Knowledge::Bsdf, 0), "-DTR_ONE_BSDF=Diffuse"));
    CHECK(has(plain.options(Knowledge::Bsdf, 0), "-DTR_BSDF_SOURCE=\"core/bsdf/diffuse.cpp\""));
    const std::unique_ptr<cuda::Nvrtc> nvrtc = find_nvrtc();
    if (!nvrtc) return;
    const TemporaryFolder folder;
    const cuda::KernelCompiler compiler(nvrtc.get(), sources(), KernelCache(folder.path));
    const Kernel &kernel = kernel_of<OccludeRays>();
    const std::string of_plain = compiler.for_card(kernel, 90, plain.options(kernel.knows, -1)),
                      of_curved = compiler.for_card(kernel, 90, curved.options(kernel.knows, -1));
    CHECK(of_plain.size() < of_curved.size() && folder.files().size() == 2);
}

TR_TEST(kernels_are_compiled_for_cards) {
    const std::unique_ptr<cuda::Nvrtc> nvrtc = find_nvrtc();
    if (!nvrtc) return;
    const TemporaryFolder folder;
    const cuda::KernelCompiler compiler(nvrtc.get(), sources(), KernelCache(folder.path));
    const std::string cubin = compiler.for_card(kernel_of<AddOne>(), 90);
    CHECK(cubin.substr(1, 3) == "ELF" && cubin.find(cuda::KernelCompiler::EntryPoint) != std::string::npos);
    CHECK(compiler.for_card(kernel_of<AddOne>(), 90) == cubin && folder.files().size() == 1);
    CHECK(compiler.for_card(kernel_of<AddOne>(), 80) != cubin && folder.files().size() == 2);
    const TemporaryFolder empty;
    const cuda::KernelCompiler none(nullptr, sources(), KernelCache(empty.path), {KernelCache(folder.path)});
    CHECK(none.for_card(kernel_of<AddOne>(), 90) == cubin && empty.files().empty());
    CHECK_THROWS(none.for_card(kernel_of<AddOne>(), 75), std::runtime_error, "no NVRTC to compile tr::testing::AddOne");
    // ... nor do cards that came after PTX
    const std::string ptx = compiler.code(kernel_of<AddOne>(), "compute_75");
    CHECK(ptx.find(".target sm_75") != std::string::npos && ptx.find("tr_kernel") != std::string::npos);
    CHECK(none.for_card(kernel_of<AddOne>(), 75) == ptx && none.for_card(kernel_of<AddOne>(), 120) == ptx);
    CHECK(none.for_card(kernel_of<AddOne>(), 90) == cubin);
    CHECK_THROWS(none.for_card(kernel_of<AddOne>(), 70), std::runtime_error, "for sm_70");
    for (const Kernel &kernel : {kernel_of<IntersectRays>(), kernel_of<OccludeRays>()})
        CHECK(compiler.for_card(kernel, 75).substr(1, 3) == "ELF");
    Kernel other = kernel_of<AddOne>();
    other.size = 12;
    CHECK_THROWS(compiler.for_card(other, 90), std::runtime_error, "a functor is not what it is on the host");
    CHECK_THROWS(cuda::Nvrtc("/nowhere/libnvrtc.so"), std::runtime_error, "NVRTC at /nowhere/libnvrtc.so cannot be");
    CHECK_THROWS(cuda::Nvrtc("libc.so.6"), std::runtime_error, "has no function nvrtcVersion");
}

}  // namespace tr::testing
