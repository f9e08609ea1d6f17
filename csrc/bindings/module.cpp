// What Python calls, as a C interface: what this build is, its models, and the scene. Tensors come as addresses; Python
// has checked shape, type, device and contiguity.
#include <array>
#include <cmath>
#include <new>

#include "accel/embree_library.h"
#include "declare_bsdf_functions.h"
#include "declare_scene.h"
#include "declare_upsampling.h"
#include "device/cards.h"
#include "device/cuda_launcher.h"
#include "device/driver.h"
#include "device/launcher.h"
#include "device/nvrtc.h"
#include "functions.h"
#include "host/models.h"
#include "host/team.h"
#include "samplers.h"

namespace tr {

namespace {

const char *kind_name(Kind kind) {
    switch (kind) {
        case Kind::Texture:
        case Kind::Scalar:
            return "texture";
        case Kind::Spectrum:
            return "spectrum";
        case Kind::Float:
            return "float";
        case Kind::Point:
            return "point";
        case Kind::Vector:
            return "vector";
        case Kind::Transform:
            return "transform";
        case Kind::Transform2:
            return "transform2";
        case Kind::Tensor:
            return "tensor";
        case Kind::Indices:
            return "indices";
        case Kind::Int:
            return "int";
        case Kind::Bsdf:
            return "bsdf";
        case Kind::Emitter:
            return "emitter";
        case Kind::Volume:
            return "volume";
        case Kind::Phase:
            return "phase";
        case Kind::Medium:
            return "medium";
        case Kind::Shape:
            return "shape";
    }
    return "";
}

// None where there is no such number.
Value number(double x) { return std::isfinite(x) ? Value(x) : Value(); }

// None where any number is one.
Value choices(Choices names) {
    if (!names) return {};
    Value::List all;
    for (; *names; ++names) all.emplace_back(*names);
    return all;
}

// Those of ModelFlags that Python asks for.
Value flag_names(uint32_t flags) {
    Value::List all;
    constexpr std::pair<uint32_t, const char *> names[] = {{Transmits, "transmits"},
                                                           {WrapsBsdfs, "wraps_bsdfs"},
                                                           {PerturbsNormals, "perturbs_normals"},
                                                           {FollowsTangent, "follows_tangent"},
                                                           {HasDeltaLobes, "has_delta_lobes"},
                                                           {HasSmoothLobes, "has_smooth_lobes"}};
    for (const auto &[flag, name] : names)
        if (flags & flag) all.emplace_back(name);
    return all;
}

Value models() {
    Value::List all;
    for (const ModelEntry &entry : all_models()) {
        const Model &model = *entry.model;
        Value::List fields;
        for (int i = 0; i < model.n_fields; ++i) {
            const Field &f = model.fields[i];
            fields.emplace_back(Value::Dict{{"name", f.name},
                                            {"kind", kind_name(f.kind)},
                                            {"scalar", f.kind == Kind::Scalar},
                                            {"default", number(f.fallback)},
                                            {"min", number(f.minimum)},
                                            {"max", number(f.maximum)},
                                            {"derivative", *f.derivative ? f.derivative : "none"},
                                            {"doc", f.doc},
                                            {"choices", choices(f.choices)},
                                            {"optional", (f.traits & Optional) != 0},
                                            {"traits", flag_names(f.traits)}});
        }
        all.emplace_back(Value::Dict{{"category", model.category},
                                     {"type", model.type},
                                     {"doc", model.doc},
                                     {"fields", fields},
                                     {"flags", flag_names(model.flags)},
                                     {"class_name", model.class_name ? Value(model.class_name) : Value()}});
    }
    return all;
}

Value variants() {
    Value::List all;
    for (const char *color : {"mono", "rgb", "spectral"}) {
        for (const char *dtype : {"float32", "float64"}) {
            if (TR_HAS_PACKETS && std::string(dtype) == "float64") continue;
            all.emplace_back(Value::Dict{{"color", color}, {"dtype", dtype}});
        }
    }
    return all;
}

// Asked of the baseline module, which every processor can run.
Value cpu_supports() {
#if defined(__x86_64__)
    __builtin_cpu_init();
    bool v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    bool avx2 = v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
    bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                  __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                  __builtin_cpu_supports("avx512vl");
#else
    constexpr bool v2 = false, avx2 = false, avx512 = false;
#endif
    return Value::Dict{{"v2", v2}, {"avx2", avx2}, {"avx512", avx512}};
}

Value info() { return Value::Dict{{"isa", TR_ISA_NAME}, {"packet_width", TR_PACKET_WIDTH}, {"compiler", __VERSION__}}; }

// Numbers (n, 4), float64, of n samples of some pixels (both uint32), in a precision of this module.
void draw(const std::string &sampler, int64_t first, int64_t count, uint64_t seed, uint32_t sensor, uint32_t block,
          int wanted, [[maybe_unused]] const std::string &arithmetic, size_t n, uintptr_t pixels, uintptr_t samples,
          uintptr_t out) {
    PathConfig config{};
    config.seed = seed, config.sensor = sensor;
    config.sampler = make_sampler(sampler_kind(sampler), first, count);
    auto draw = &draw_numbers<PacketOf<float>>;
#if !TR_HAS_PACKETS
    if (arithmetic == "float64") draw = &draw_numbers<double>;
#endif
    draw(config, block, wanted, n, reinterpret_cast<const uint32_t *>(pixels),
         reinterpret_cast<const uint32_t *>(samples), reinterpret_cast<double *>(out));
}

Functions all_functions() {
    Functions f;
    f.add("info", &info);
    f.add("cpu_supports", &cpu_supports);
    f.add("variants", &variants);
    f.add("models", &models);
    f.add("echo", [](const Value &value) { return value; });  // for tests
    f.add("load_embree", [](const std::string &path) {
        EmbreeInfo found = load_embree(path);
        return Value(Value::Dict{{"version", found.version}, {"path", found.path}});
    });
    // addresses, see host/team.h; 0: threads of our own
    f.add("use_openmp", [](uintptr_t parallel, uintptr_t number, uintptr_t size) {
        use_openmp({reinterpret_cast<decltype(OpenMp::parallel)>(parallel),
                    reinterpret_cast<decltype(OpenMp::number)>(number),
                    reinterpret_cast<decltype(OpenMp::size)>(size)});
    });
    // versions of CUDA, "12.2"
    f.add("cuda_driver", [] { return cuda::driver_version(cuda::find_driver()); });
    f.add("nvrtc", [](const std::string &path) { return cuda::Nvrtc(path).version(); });
#if !TR_HAS_PACKETS
    f.add("use_cuda_compiler", &cuda::use_compiler);
    f.add("use_cuda_memory", [](uintptr_t serve) {  // the address of a function
        cuda::CardMemory from;
        from.serve = reinterpret_cast<decltype(from.serve)>(serve);
        cuda::use_memory(from);
    });
    f.add("cuda_kernel_times", [] {
        std::map<std::string, std::array<double, 2>> r;  // launches, seconds
        for (const auto &[name, time] : cuda::take_kernel_times()) r[name] = {double(time.launches), time.seconds};
        return r;
    });
#endif
    f.add("philox", [](uint64_t seed, uint32_t sensor, uint32_t pixel, uint32_t sample, uint32_t block) {
        Random4<double> r = random4<double>(seed, sensor, pixel, sample, block);
        return std::array<double, 4>{r.u[0], r.u[1], r.u[2], r.u[3]};
    });
    f.add("draw", &draw);
    declare_scene(f);
    declare_bsdf_functions(f);
    declare_upsampling(f);
    return f;
}

// How a call ended; torchrender/native.py has the same list.
enum Outcome { Returned, InterruptedByPython, IsTypeError, IsValueError, IsIndexError, IsMemoryError, IsRuntimeError };

// The result or, of a call that failed, what is wrong.
std::pair<Outcome, Value> outcome(const char *name, const char *arguments, size_t size, Progress progress) {
    static const Functions functions = all_functions();
    try {
        return {Returned, functions.call(name, progress, Value::from_bytes(arguments, size).list())};
    } catch (const Interrupted &) {
        return {InterruptedByPython, Value()};
    } catch (const TypeError &error) {
        return {IsTypeError, name + std::string(": ") + error.what()};
    } catch (const std::out_of_range &error) {
        return {IsIndexError, error.what()};
    } catch (const std::logic_error &error) {
        return {IsValueError, error.what()};
    } catch (const DeviceMemoryError &error) {
        return {IsMemoryError, error.what()};
    } catch (const std::bad_alloc &) {
        return {IsMemoryError, "not enough memory"};
    } catch (const std::exception &error) {
        return {IsRuntimeError, error.what()};
    }
}

}  // namespace

}  // namespace tr

#define TR_EXPORTED extern "C" __attribute__((visibility("default")))

// Calls a function with a list of arguments (value.h), and gives the address and the size of the result, which is to be
// given to tr_free.
TR_EXPORTED int tr_call(const char *name, const char *arguments, size_t size, tr::Progress progress, void **reply,
                        const char **result, size_t *result_size) {
    auto [how, value] = tr::outcome(name, arguments, size, progress);
    auto *bytes = new std::string(value.to_bytes());
    *reply = bytes, *result = bytes->data(), *result_size = bytes->size();
    return how;
}

TR_EXPORTED void tr_free(void *reply) { delete static_cast<std::string *>(reply); }

// Python lets an object go.
TR_EXPORTED void tr_release(void *object) { delete static_cast<tr::Handle *>(object); }
