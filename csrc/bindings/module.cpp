// The Python module: what this build is, its models, and the scene. Tensors come as addresses; Python has checked
// shape, type, device and contiguity. What includes pybind11 is a header of this file alone: it takes a compiler
// seconds wherever it is included.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>

#include "accel/embree_library.h"
#include "declare_bsdf_functions.h"
#include "declare_scene.h"
#include "declare_upsampling.h"
#include "host/models.h"
#include "samplers.h"

namespace py = pybind11;

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
py::object number(double x) { return std::isfinite(x) ? py::object(py::float_(x)) : py::object(py::none()); }

// None where any number is one.
py::object choices(Choices names) {
    if (!names) return py::none();
    py::list r;
    for (; *names; ++names) r.append(*names);
    return py::tuple(r);
}

// Those of ModelFlags that Python asks for.
py::tuple flag_names(uint32_t flags) {
    py::list r;
    constexpr std::pair<uint32_t, const char *> names[] = {{Transmits, "transmits"},
                                                           {WrapsBsdfs, "wraps_bsdfs"},
                                                           {PerturbsNormals, "perturbs_normals"},
                                                           {FollowsTangent, "follows_tangent"},
                                                           {HasDeltaLobes, "has_delta_lobes"},
                                                           {HasSmoothLobes, "has_smooth_lobes"}};
    for (const auto &[flag, name] : names)
        if (flags & flag) r.append(name);
    return py::tuple(r);
}

py::list models() {
    py::list all;
    for (const ModelEntry &entry : all_models()) {
        const Model &model = *entry.model;
        py::list fields;
        for (int i = 0; i < model.n_fields; ++i) {
            const Field &f = model.fields[i];
            py::dict d;
            d["name"] = f.name;
            d["kind"] = kind_name(f.kind);
            d["scalar"] = f.kind == Kind::Scalar;
            d["default"] = number(f.fallback);
            d["min"] = number(f.minimum);
            d["max"] = number(f.maximum);
            d["derivative"] = *f.derivative ? f.derivative : "none";
            d["doc"] = f.doc;
            d["choices"] = choices(f.choices);
            d["optional"] = (f.traits & Optional) != 0;
            d["traits"] = flag_names(f.traits);
            fields.append(d);
        }
        py::dict d;
        d["category"] = model.category;
        d["type"] = model.type;
        d["doc"] = model.doc;
        d["fields"] = fields;
        d["flags"] = flag_names(model.flags);
        d["class_name"] = model.class_name ? py::object(py::str(model.class_name)) : py::object(py::none());
        all.append(d);
    }
    return all;
}

py::list variants() {
    py::list all;
    for (const char *color : {"mono", "rgb", "spectral"}) {
        for (const char *dtype : {"float32", "float64"}) {
            if (TR_HAS_PACKETS && std::string(dtype) == "float64") continue;
            py::dict d;
            d["color"] = color;
            d["dtype"] = dtype;
            all.append(d);
        }
    }
    return all;
}

// Asked of the baseline module, which every processor can run.
py::dict cpu_supports() {
    py::dict d;
#if defined(__x86_64__)
    __builtin_cpu_init();
    bool v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    bool avx2 = v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
    d["v2"] = v2;
    d["avx2"] = avx2;
    d["avx512"] = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                  __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                  __builtin_cpu_supports("avx512vl");
#else
    d["v2"] = d["avx2"] = d["avx512"] = false;
#endif
    return d;
}

py::dict info() {
    py::dict d;
    d["isa"] = TR_ISA_NAME;
    d["packet_width"] = TR_PACKET_WIDTH;
    d["compiler"] = __VERSION__;
    return d;
}

}  // namespace

}  // namespace tr

PYBIND11_MODULE(TR_MODULE_NAME, m) {
    using namespace tr;
    m.def("info", &info);
    m.def("cpu_supports", &cpu_supports);
    m.def("variants", &variants);
    m.def("models", &models);
    m.def("load_embree", [](const std::string &path) {
        EmbreeInfo found = [&] {
            py::gil_scoped_release release;
            return load_embree(path);
        }();
        py::dict d;
        d["version"] = found.version;
        d["path"] = found.path;
        return d;
    });
    m.def("philox", [](uint64_t seed, uint32_t sensor, uint32_t pixel, uint32_t sample, uint32_t block) {
        Random4<double> r = random4<double>(seed, sensor, pixel, sample, block);
        return std::array<double, 4>{r.u[0], r.u[1], r.u[2], r.u[3]};
    });
    // Numbers (n, 4), float64, of n samples of some pixels (both uint32), in a precision of this module.
    m.def("draw", [](const std::string &sampler, int64_t first, int64_t count, uint64_t seed, uint32_t sensor,
                     uint32_t block, int wanted, [[maybe_unused]] const std::string &arithmetic, size_t n,
                     uintptr_t pixels, uintptr_t samples, uintptr_t out) {
        PathConfig config{};
        config.seed = seed, config.sensor = sensor;
        config.sampler = make_sampler(sampler_kind(sampler), first, count);
        auto draw = &draw_numbers<PacketOf<float>>;
#if !TR_HAS_PACKETS
        if (arithmetic == "float64") draw = &draw_numbers<double>;
#endif
        draw(config, block, wanted, n, reinterpret_cast<const uint32_t *>(pixels),
             reinterpret_cast<const uint32_t *>(samples), reinterpret_cast<double *>(out));
    });
    declare_scene(m);
    declare_bsdf_functions(m);
    declare_upsampling(m);
}
