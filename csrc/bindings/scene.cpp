#include "scene.h"

#include <pybind11/stl.h>

#include <algorithm>
#include <mutex>

#include "config.h"
#include "core/sensor/camera.h"
#include "cpu/aov.h"
#include "cpu/render.h"
#include "cpu/zeros.h"
#include "host/dependence.h"
#include "host/normals.h"
#include "host/scene_data.h"
#include "phase_probe.h"
#include "probes.h"

namespace py = pybind11;

namespace tr {

namespace {

using Addresses = std::vector<uintptr_t>;
using Arrays = std::map<std::string, uintptr_t>;

class SceneBase {
public:
    virtual ~SceneBase() = default;
    virtual void build(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &shapes,
                       const std::vector<IndexArray> &arrays, SceneBase *previous) = 0;
    virtual std::map<std::string, uint64_t> counters() = 0;
    // image, alpha and variance; the last two may be 0
    virtual RenderStats render(const Config &, const Addresses &params, const std::vector<uint8_t> &dirty,
                               const std::array<uintptr_t, 3> &out) = 0;
    virtual RenderStats reverse(const Config &, const Addresses &params, const std::vector<uint8_t> &dirty,
                                uintptr_t adjoint, const Addresses &gradients) = 0;
    virtual RenderStats forward(const Config &, const Addresses &params, const std::vector<uint8_t> &dirty,
                                const Addresses &tangents, uintptr_t image) = 0;
    // outputs besides radiance, by name; shape_id, prim_id and material_id are int32
    virtual RenderStats aov(const Config &, const Addresses &params, const std::vector<uint8_t> &dirty,
                            const Arrays &out) = 0;
    virtual RenderStats aov_reverse(const Config &, const Addresses &params, const std::vector<uint8_t> &dirty,
                                    const Arrays &adjoints, const Addresses &gradients) = 0;
    virtual RenderStats aov_forward(const Config &, const Addresses &params, const std::vector<uint8_t> &dirty,
                                    const Addresses &tangents, const Arrays &out) = 0;
    virtual void intersect(size_t n, const std::array<uintptr_t, 3> &rays, const std::map<std::string, uintptr_t> &out,
                           const Addresses &params, const std::vector<uint8_t> &dirty) = 0;
    virtual void occluded(size_t n, const std::array<uintptr_t, 3> &rays, uintptr_t out, const Addresses &params,
                          const std::vector<uint8_t> &dirty) = 0;
    // see probes.h; arrays by name
    virtual void probe(const std::string &what, int index, size_t n, const Arrays &arrays, const Addresses &params,
                       const std::vector<uint8_t> &dirty) = 0;
    virtual std::array<double, 6> bounds() = 0;
    virtual std::vector<double> emitter_probabilities() = 0;  // of the last call
    // The record that keeps the rays of the next renderings; null: none any more.
    virtual void record_rays(std::shared_ptr<RayRecord> record) = 0;
    virtual RayRecord::Replay replay_rays(const RayRecord &, RayKind, int width, bool coherent, int threads,
                                          int rounds) = 0;
};

template <class S, int C>
class SceneOf final : public SceneBase {
public:
    void build(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &shapes,
               const std::vector<IndexArray> &arrays, SceneBase *previous) override {
        auto *other = dynamic_cast<SceneOf *>(previous);
        if (!other || other == this) {
            std::lock_guard<std::mutex> lock(mutex_);
            return data_.build(objects, shapes, arrays, C);
        }
        std::scoped_lock lock(mutex_, other->mutex_);
        data_.build(objects, shapes, arrays, C, &other->data_);
    }

    std::map<std::string, uint64_t> counters() override {
        std::lock_guard<std::mutex> lock(mutex_);
        auto c = data_.counters();
        return {{"tree_builds", c.accel.builds},
                {"mesh_refits", c.accel.refits},
                {"mesh_rebuilds", c.accel.rebuilds},
                {"meshes", c.meshes},
                {"quadrics", c.quadrics},
                {"height_fields", c.height_fields},
                {"environments", c.environments}};
    }

    RenderStats render(const Config &c, const Addresses &params, const std::vector<uint8_t> &dirty,
                       const std::array<uintptr_t, 3> &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        auto at = [&](size_t i) { return reinterpret_cast<S *>(out[i]); };
        RenderCall<S> primal = call(c);
        if (c.light) return trace_light<S, C>(primal, c.packets, at(0));
        if (c.hits) primal.keep_hits = c.hits->add_pass();
        return render_primal<S, C>(primal, c.packets, {at(0), at(1), at(2)});
    }

    RenderStats reverse(const Config &c, const Addresses &params, const std::vector<uint8_t> &dirty, uintptr_t adjoint,
                        const Addresses &gradients) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        DerivativeCall<S> d = reverse_call(c, gradients);
        d.adjoint = reinterpret_cast<const S *>(adjoint);
        d.adaptive = c.adaptive;
        RenderCall<S> reverse = call(c);
        if (c.hits) reverse.kept_hits = c.hits->pass(c.hits_pass);
        RenderStats stats =
            c.light ? trace_light_reverse<S, C>(reverse, c.packets, d) : render_reverse<S, C>(reverse, c.packets, d);
        add_gradients(d, gradients);
        return stats;
    }

    RenderStats forward(const Config &c, const Addresses &params, const std::vector<uint8_t> &dirty,
                        const Addresses &tangents, uintptr_t image) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        Tangents storage;
        DerivativeCall<S> d = forward_call(c, tangents, storage);
        S *to = reinterpret_cast<S *>(image);
        if (c.light) return trace_light_forward<S, C>(call(c), c.packets, d, to);
        return render_forward<S, C>(call(c), c.packets, d, to);
    }

    RenderStats aov(const Config &c, const Addresses &params, const std::vector<uint8_t> &dirty,
                    const Arrays &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        return render_aov<S, C>(call(c), c.packets, outputs(c, out));
    }

    RenderStats aov_reverse(const Config &c, const Addresses &params, const std::vector<uint8_t> &dirty,
                            const Arrays &adjoints, const Addresses &gradients) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        DerivativeCall<S> d = reverse_call(c, gradients);
        RenderStats stats = reverse_aov<S, C>(call(c), c.packets, outputs(c, adjoints), d);
        add_gradients(d, gradients);
        return stats;
    }

    RenderStats aov_forward(const Config &c, const Addresses &params, const std::vector<uint8_t> &dirty,
                            const Addresses &tangents, const Arrays &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        Tangents storage;
        DerivativeCall<S> d = forward_call(c, tangents, storage);
        return forward_aov<S, C>(call(c), c.packets, outputs(c, out), d);
    }

    void intersect(size_t n, const std::array<uintptr_t, 3> &in, const std::map<std::string, uintptr_t> &out,
                   const Addresses &params, const std::vector<uint8_t> &dirty) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        Rays rays(n, in);
        std::vector<uint32_t> shape(n), primitive(n);
        std::vector<float> t(n), b1(n), b2(n);
        data_.accel().intersect(rays.batch(), {shape.data(), primitive.data(), t.data(), b1.data(), b2.data()}, n,
                                false);
        auto column = [&](const char *name) { return reinterpret_cast<S *>(out.at(name)); };
        S *to_t = column("t"), *to_p = column("position"), *to_n = column("normal"), *to_s = column("shading_normal");
        S *to_uv = column("uv"), *to_b1 = column("b1"), *to_b2 = column("b2");
        int32_t *to_shape = reinterpret_cast<int32_t *>(out.at("shape_id")),
                *to_prim = reinterpret_cast<int32_t *>(out.at("prim_id"));
        const S *o = reinterpret_cast<const S *>(in[0]), *d = reinterpret_cast<const S *>(in[1]);
        for (size_t i = 0; i < n; ++i) {
            bool hit = shape[i] != Accel::Miss;
            Vec3<S> p{S(INFINITY), S(INFINITY), S(INFINITY)}, ng{0, 0, 0}, ns{0, 0, 0};
            Vec2<S> uv{0, 0};
            S distance = S(INFINITY), w1 = 0, w2 = 0;
            if (hit) {
                Ray<S> ray{{o[3 * i], o[3 * i + 1], o[3 * i + 2]}, {d[3 * i], d[3 * i + 1], d[3 * i + 2]}};
                SurfacePoint<S> at{shape[i], primitive[i], S(b1[i]), S(b2[i])};
                Interaction<S> si = make_interaction<S>(data_.view(), ray, at, S(t[i]), true);
                p = si.p, ng = si.ng, ns = si.frame.n, distance = si.t, w1 = si.at.b1, w2 = si.at.b2;
                uv = texture_coordinates<S>(data_.view(), si.at, true);
            }
            to_t[i] = distance, to_b1[i] = w1, to_b2[i] = w2;
            to_p[3 * i] = p.x, to_p[3 * i + 1] = p.y, to_p[3 * i + 2] = p.z;
            to_n[3 * i] = ng.x, to_n[3 * i + 1] = ng.y, to_n[3 * i + 2] = ng.z;
            to_s[3 * i] = ns.x, to_s[3 * i + 1] = ns.y, to_s[3 * i + 2] = ns.z;
            to_uv[2 * i] = uv.x, to_uv[2 * i + 1] = uv.y;
            to_shape[i] = hit ? int32_t(shape[i]) : -1;
            to_prim[i] = hit ? int32_t(primitive[i]) : -1;
        }
    }

    void occluded(size_t n, const std::array<uintptr_t, 3> &in, uintptr_t out, const Addresses &params,
                  const std::vector<uint8_t> &dirty) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        Rays rays(n, in);
        data_.accel().occluded(rays.batch(), reinterpret_cast<uint8_t *>(out), n);
    }

    void probe(const std::string &what, int index, size_t n, const Arrays &arrays, const Addresses &params,
               const std::vector<uint8_t> &dirty) override {
        std::lock_guard<std::mutex> lock(mutex_);
        data_.update(pointers(params), dirty);
        const SceneView<S> &scene = data_.view();
        auto at = [&](const char *name) { return reinterpret_cast<S *>(arrays.at(name)); };
        if (what.rfind("bsdf", 0) == 0 && (index < 0 || index >= scene.n_bsdfs))
            throw std::invalid_argument("bsdf: expected a number below " + std::to_string(scene.n_bsdfs));
        if (what.rfind("emitter_sample", 0) == 0 && scene.n_emitters == 0)
            throw std::invalid_argument("the scene has no emitters");
        if (what.rfind("phase", 0) == 0) {
#if TR_HAS_PACKETS
            if constexpr (std::is_same_v<S, float>)
                if (arrays.count("packet")) return probe_phases<FloatPacket>(what, index, n, arrays);
#endif
            return probe_phases<S>(what, index, n, arrays);
        }
        if (what == "bsdf")
            probe_bsdf<S, C>(scene, index, n, at("wi"), at("wo"), at("uv"), at("value"), at("pdf"));
        else if (what == "bsdf_sample")
            probe_bsdf_sample<S, C>(scene, index, n, at("wi"), at("uv"), at("u"), at("wo"), at("weight"), at("pdf"),
                                    at("eta"), reinterpret_cast<uint8_t *>(arrays.at("delta")));
        else if (what == "emitter_sample")
            probe_emitter_sample<S, C>(scene, n, at("p"), at("u"), at("d"), at("distance"), at("pdf"), at("radiance"));
        else if (what == "emitter_pdf")
            probe_emitter_pdf<S, C>(scene, data_.accel(), n, at("p"), at("d"), at("pdf"), at("radiance"));
        else
            throw std::invalid_argument("probe: unknown: " + what);
    }

    std::array<double, 6> bounds() override {
        std::lock_guard<std::mutex> lock(mutex_);
        S box[6];
        data_.bounds(box);
        std::array<double, 6> r;
        std::copy_n(box, 6, r.begin());
        return r;
    }

    std::vector<double> emitter_probabilities() override {
        std::lock_guard<std::mutex> lock(mutex_);
        const S *pmf = data_.view().emitter_pmf;
        return {pmf, pmf ? pmf + data_.view().n_emitters : pmf};
    }

    void record_rays(std::shared_ptr<RayRecord> record) override {
        std::lock_guard<std::mutex> lock(mutex_);
        ray_record_ = std::move(record);
    }

    RayRecord::Replay replay_rays(const RayRecord &record, RayKind kind, int width, bool coherent, int threads,
                                  int rounds) override {
        std::lock_guard<std::mutex> lock(mutex_);
        return record.replay(data_.accel(), kind, width, coherent, threads, rounds);
    }

private:
    SceneData<S> data_;
    std::mutex mutex_;
    std::shared_ptr<RayRecord> ray_record_;

    // Rays (n, 3) as columns in single precision.
    struct Rays {
        std::vector<float> columns[7];
        Rays(size_t n, const std::array<uintptr_t, 3> &in) {
            const S *o = reinterpret_cast<const S *>(in[0]), *d = reinterpret_cast<const S *>(in[1]),
                    *tmax = reinterpret_cast<const S *>(in[2]);
            for (auto &c : columns) c.resize(n);
            for (size_t i = 0; i < n; ++i) {
                for (size_t k = 0; k < 3; ++k)
                    columns[k][i] = float(o[3 * i + k]), columns[3 + k][i] = float(d[3 * i + k]);
                columns[6][i] = float(tmax[i]);
            }
        }
        RayBatch batch() const {
            return {{columns[0].data(), columns[1].data(), columns[2].data()},
                    {columns[3].data(), columns[4].data(), columns[5].data()},
                    columns[6].data()};
        }
    };

    // See phase_probe.h; gradients and tangents go by the number of their slot.
    template <class F>
    void probe_phases(const std::string &what, int index, size_t n, const Arrays &arrays) {
        const SceneView<S> &scene = data_.view();
        size_t n_phases = data_.layout().records.at("phase").size();
        if (index < 0 || size_t(index) >= n_phases)
            throw std::invalid_argument("phase: expected a number below " + std::to_string(n_phases));
        auto at = [&](const char *name) { return reinterpret_cast<S *>(arrays.at(name)); };
        if (what == "phase") return probe_phase<F>(scene, index, n, at("p"), at("d"), at("wo"), at("value"));
        if (what == "phase_sample") return probe_phase_sample<F>(scene, index, n, at("p"), at("d"), at("u"), at("wo"));
        Addresses slots(data_.n_params(), 0);
        for (size_t i = 0; i < slots.size(); ++i)
            if (auto found = arrays.find(std::to_string(i)); found != arrays.end()) slots[i] = found->second;
        if (what == "phase_reverse") {
            DerivativeCall<S> d{};
            d.sums.constants.assign(data_.n_constants(), 0.0);
            std::vector<S *> gradients = tensors(slots);
            probe_phase_reverse<F, C>(scene, index, n, at("p"), at("d"), at("wo"), at("g"), d.sums.constants.data(),
                                      gradients.data());
            return add_gradients(d, slots);
        }
        Tangents tangent;
        data_.fill_values(pointers(slots), tangent.arrays.constants, tangent.tensors);
        probe_phase_forward<F, C>(scene, index, n, at("p"), at("d"), at("wo"), at("g"),
                                  {tangent.arrays.constants.data(), tangent.tensors.data()}, at("derivative"));
    }

    static std::vector<const S *> pointers(const Addresses &addresses) {
        std::vector<const S *> r;
        for (uintptr_t a : addresses) r.push_back(reinterpret_cast<const S *>(a));
        return r;
    }

    RenderCall<S> call(const Config &c) {
        size_t sensors = data_.layout().records.at("sensor").size();
        if (c.path.sensor >= sensors)
            throw std::invalid_argument("sensor: expected a number below " + std::to_string(sensors) + ", got " +
                                        std::to_string(c.path.sensor));
        const Record &sensor = data_.layout().records.at("sensor")[c.path.sensor];
        const bool meter = sensor.kind == IrradianceMeterKind;
        if (!c.light && meter) throw std::invalid_argument("sensor: an irradiancemeter is measured by light tracing");
        if (c.light && !meter && !is_pinhole(sensor))
            throw std::invalid_argument("sensor: light paths are connected to pinholes without distortion alone");
        data_.choose_emitters(c.by_power);
        RenderCall<S> call{};
        call.scene = &data_.view();
        call.accel = &data_.accel();
        call.config = c.path;
        call.filter = c.filter;
        call.film_height = c.height, call.film_width = c.width;
        call.crop = c.crop;
        call.samples = c.window;
        if (c.pixels) call.pixels = &*c.pixels;
        call.spp = c.spp, call.sample_offset = c.sample_offset;
        call.threads = c.threads;
        call.ray_record = ray_record_.get();
        call.interrupted = Interruption();
        return call;
    }

    static AovOutput<S> outputs(const Config &c, const Arrays &given) {
        AovOutput<S> out;
        for (const auto &[name, address] : given) {
            int kind = 0;
            while (kind < AovCount && name != aov_names[kind].name) ++kind;
            if (kind < AovCount)
                out.data[size_t(kind)] = reinterpret_cast<S *>(address);
            else if (name == "shape_id")
                out.shape = reinterpret_cast<int32_t *>(address);
            else if (name == "prim_id")
                out.primitive = reinterpret_cast<int32_t *>(address);
            else if (name == "material_id")
                out.material = reinterpret_cast<int32_t *>(address);
            else
                throw std::invalid_argument("outputs: unknown: " + name);
        }
        out.seeds = c.seeds;
        out.zero_at_misses = c.zero_at_misses;
        for (size_t i = 0; i < out.attributes.size() && i < c.attributes.size(); ++i)
            out.attributes[i] = c.attributes[i];
        return out;
    }

    // Gradients of large tensors are added to where they lie, the others by add_gradients.
    DerivativeCall<S> reverse_call(const Config &c, const Addresses &gradients) {
        DerivativeCall<S> d = derivative(c, gradients);
        d.gradients = tensors(gradients);
        for (const MeshSource &mesh : data_.layout().meshes)  // these have tables of their own
            for (int slot : {mesh.vertices, mesh.normals, mesh.texcoords})
                if (slot >= 0) d.gradients[size_t(slot)] = nullptr;
        return d;
    }

    void add_gradients(DerivativeCall<S> &d, const Addresses &gradients) {
        if (d.sums.constants.empty()) return;
        if (d.wanted.geometry) data_.spread_geometry(d.sums, tensors(gradients));
        for (const ConstantEntry &e : data_.constant_entries()) {
            S *to = reinterpret_cast<S *>(gradients[size_t(e.slot)]);
            if (!to) continue;
            for (int i = 0; i < e.stored; ++i) to[e.count == 1 ? 0 : i] += S(d.sums.constants[size_t(e.offset + i)]);
        }
    }

    std::vector<S *> tensors(const Addresses &addresses) const {
        std::vector<S *> r(addresses.size(), nullptr);
        for (const ParameterUse &use : data_.layout().tensors)
            r[size_t(use.slot)] = reinterpret_cast<S *>(addresses[size_t(use.slot)]);
        return r;
    }

    // Tangents in the layouts that the core reads them in.
    struct Tangents {
        GeometryArrays<S> arrays;
        std::vector<TensorView<S>> tensors;
    };
    DerivativeCall<S> forward_call(const Config &c, const Addresses &tangents, Tangents &storage) {
        DerivativeCall<S> d = derivative(c, tangents);
        GeometryArrays<S> &arrays = storage.arrays;
        data_.fill_values(pointers(tangents), arrays.constants, storage.tensors);
        if (d.wanted.geometry) data_.fill_geometry(pointers(tangents), d.geometry_sizes, arrays);
        auto table = [](const std::vector<S> &v) { return v.empty() ? nullptr : v.data(); };
        d.tangent = {arrays.constants.data(), storage.tensors.data()};
        d.geometry_tangent = {table(arrays.positions), table(arrays.normals), table(arrays.texcoords), d.matrices,
                              d.shape_wanted.data()};
        return d;
    }

    DerivativeCall<S> derivative(const Config &c, const Addresses &addresses) {
        const SceneLayout &layout = data_.layout();
        DerivativeCall<S> d;
        d.sizes = layout.slot_sizes;
        std::vector<bool> wanted;
        for (uintptr_t a : addresses) wanted.push_back(a != 0);
        Dependence depends(layout, wanted);
        size_t sensor = c.path.sensor;
        d.wanted = {false, false, !c.path.volumetric && depends.point_position(), false, false, {}};
        for (size_t i = 0; i < layout.media.size() && c.path.volumetric; ++i) {
            MediumWanted medium = depends.medium(i);
            d.wanted.medium.extinction |= medium.extinction;
            d.wanted.medium.albedo |= medium.albedo;
            d.wanted.medium.emission |= medium.emission;
            d.wanted.medium.phase |= medium.phase;
        }
        if (sensor < layout.records.at("sensor").size() && !c.path.volumetric) {
            d.wanted.geometry = depends.motion(sensor) || (c.light && d.wanted.light_position);
            d.wanted.camera = depends.camera(sensor);
        }
        for (size_t i = 0; i < layout.records.at("bsdf").size(); ++i) {
            d.bsdf_wanted.push_back(depends.values("bsdf", i));
            d.wanted.bsdf |= d.bsdf_wanted.back() != 0;
        }
        d.wanted.lookups = depends.bsdfs_vary();
        for (size_t i = 0; i < layout.records.at("emitter").size(); ++i)
            d.wanted.emitter |= depends.values("emitter", i);
        for (size_t i = 0; i < layout.shapes.size(); ++i) d.shape_wanted.push_back(depends.shape(i));
        d.geometry_sizes = depends.geometry_sizes();
        d.matrices = uint32_t(data_.n_constants());
        d.n_constants = data_.n_constants() + 12 * layout.shapes.size();
        return d;
    }
};

std::unique_ptr<SceneBase> make_scene(const std::string &color, const std::string &dtype) {
    if (color == "rgb" && dtype == "float32") return std::make_unique<SceneOf<float, 3>>();
    if (color == "rgb" && dtype == "float64") return std::make_unique<SceneOf<double, 3>>();
    if (color == "mono" && dtype == "float32") return std::make_unique<SceneOf<float, 1>>();
    if (color == "mono" && dtype == "float64") return std::make_unique<SceneOf<double, 1>>();
    throw std::invalid_argument("Scene: expected color mono or rgb and dtype float32 or float64, got " + color +
                                " and " + dtype);
}

SceneObjects read_objects(const py::dict &given) {
    SceneObjects objects;
    for (const auto &[category, list] : given) {
        auto &to = objects[category.cast<std::string>()];
        for (const py::handle &h : list) {
            py::tuple entry = py::reinterpret_borrow<py::object>(h);
            SceneObject object{entry[0].cast<std::string>(), entry[1].cast<std::vector<int64_t>>(), ""};
            if (entry.size() > 2) object.path = entry[2].cast<std::string>();
            to.push_back(std::move(object));
        }
    }
    return objects;
}

std::vector<uint8_t> read_dirty(const std::vector<bool> &dirty) { return {dirty.begin(), dirty.end()}; }

constexpr std::pair<const char *, RayKind> ray_kinds[] = {{"camera", RayKind::Camera},
                                                          {"bounce", RayKind::Bounce},
                                                          {"camera shadow", RayKind::CameraShadow},
                                                          {"bounce shadow", RayKind::BounceShadow}};

using Release = py::call_guard<py::gil_scoped_release>;

}  // namespace

void declare_scene(py::module_ &m) {
    m.def(
        "vertex_normals",
        [](const std::string &dtype, uintptr_t positions, size_t n_vertices, uintptr_t faces, size_t n_faces,
           uintptr_t normals) {
            auto run = [&](auto zero) {
                using S = decltype(zero);
                vertex_normals(reinterpret_cast<const S *>(positions), n_vertices,
                               reinterpret_cast<const int32_t *>(faces), n_faces, reinterpret_cast<S *>(normals));
            };
            dtype == "float64" ? run(0.0) : run(0.f);
        },
        Release());
    m.def(
        "use_large_pages",
        [](uintptr_t memory, size_t bytes) { use_large_pages(reinterpret_cast<void *>(memory), bytes); }, Release());
    // the modules of other instruction sets have one, too
    py::class_<RayRecord, std::shared_ptr<RayRecord>>(m, "RayRecord", py::module_local())
        .def(py::init<size_t>(), py::arg("limit"))
        .def("counts", [](const RayRecord &self) {
            py::dict all;
            for (auto [name, kind] : ray_kinds) {
                RayRecord::Counts counts = self.counts(kind);
                py::dict d;
                d["rays"] = counts.rays;
                d["hits"] = counts.hits;
                d["left_out"] = counts.left_out;
                all[name] = d;
            }
            return all;
        });
    // As a buffer, of one byte, it lives as long as a tensor that is made of it.
    py::class_<HitStore>(m, "HitStore", py::buffer_protocol(), py::module_local())
        .def(py::init<int64_t>(), py::arg("limit"))
        .def_property_readonly("bytes", &HitStore::bytes)
        .def_static("bytes_in_use", [] { return StoredHits::in_use().load(); })
        .def_buffer([](HitStore &store) { return py::buffer_info(&store.handle, 1); });
    py::class_<SceneBase>(m, "Scene")
        .def(py::init(&make_scene), py::arg("color"), py::arg("dtype"))
        .def(
            "build",
            [](SceneBase &self, const py::dict &objects, const std::vector<std::vector<int64_t>> &shapes,
               const std::vector<std::pair<uintptr_t, int64_t>> &indices, SceneBase *previous) {
                SceneObjects read = read_objects(objects);
                std::vector<IndexArray> arrays;
                for (auto [address, rows] : indices)
                    arrays.push_back({reinterpret_cast<const int32_t *>(address), rows});
                py::gil_scoped_release release;
                self.build(read, shapes, arrays, previous);
            },
            py::arg("objects"), py::arg("shapes"), py::arg("indices"), py::arg("previous") = nullptr)
        .def("counters", &SceneBase::counters, Release())
        .def("render",
             [](SceneBase &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                const std::map<std::string, uintptr_t> &out) {
                 Config c = read_config(config);
                 RenderStats stats;
                 {
                     py::gil_scoped_release release;
                     auto at = [&](const char *name) { return out.count(name) ? out.at(name) : 0; };
                     stats = self.render(c, params, read_dirty(dirty), {out.at("image"), at("alpha"), at("variance")});
                 }
                 return to_dict(stats);
             })
        .def("render_vjp",
             [](SceneBase &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                uintptr_t adjoint, const Addresses &gradients) {
                 Config c = read_config(config);
                 RenderStats stats;
                 {
                     py::gil_scoped_release release;
                     stats = self.reverse(c, params, read_dirty(dirty), adjoint, gradients);
                 }
                 return to_dict(stats);
             })
        .def("render_jvp",
             [](SceneBase &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                const Addresses &tangents, uintptr_t image) {
                 Config c = read_config(config);
                 RenderStats stats;
                 {
                     py::gil_scoped_release release;
                     stats = self.forward(c, params, read_dirty(dirty), tangents, image);
                 }
                 return to_dict(stats);
             })
        .def("render_aov",
             [](SceneBase &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                const Arrays &out) {
                 Config c = read_config(config);
                 RenderStats stats;
                 {
                     py::gil_scoped_release release;
                     stats = self.aov(c, params, read_dirty(dirty), out);
                 }
                 return to_dict(stats);
             })
        .def("aov_vjp",
             [](SceneBase &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                const Arrays &adjoints, const Addresses &gradients) {
                 Config c = read_config(config);
                 RenderStats stats;
                 {
                     py::gil_scoped_release release;
                     stats = self.aov_reverse(c, params, read_dirty(dirty), adjoints, gradients);
                 }
                 return to_dict(stats);
             })
        .def("aov_jvp",
             [](SceneBase &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                const Addresses &tangents, const Arrays &out) {
                 Config c = read_config(config);
                 RenderStats stats;
                 {
                     py::gil_scoped_release release;
                     stats = self.aov_forward(c, params, read_dirty(dirty), tangents, out);
                 }
                 return to_dict(stats);
             })
        .def(
            "ray_intersect",
            [](SceneBase &self, size_t n, uintptr_t o, uintptr_t d, uintptr_t tmax,
               const std::map<std::string, uintptr_t> &out, const Addresses &params,
               const std::vector<bool> &dirty) { self.intersect(n, {o, d, tmax}, out, params, read_dirty(dirty)); },
            Release())
        .def(
            "ray_occluded",
            [](SceneBase &self, size_t n, uintptr_t o, uintptr_t d, uintptr_t tmax, uintptr_t out,
               const Addresses &params,
               const std::vector<bool> &dirty) { self.occluded(n, {o, d, tmax}, out, params, read_dirty(dirty)); },
            Release())
        .def(
            "probe",
            [](SceneBase &self, const std::string &what, int index, size_t n, const Arrays &arrays,
               const Addresses &params,
               const std::vector<bool> &dirty) { self.probe(what, index, n, arrays, params, read_dirty(dirty)); },
            Release())
        .def("record_rays", &SceneBase::record_rays, py::arg("record").none(true), Release())
        .def(
            "replay_rays",
            [](SceneBase &self, const RayRecord &record, const std::string &kind, int width, bool coherent, int threads,
               int rounds) {
                const auto *found = std::find_if(std::begin(ray_kinds), std::end(ray_kinds),
                                                 [&](const auto &known) { return kind == known.first; });
                if (found == std::end(ray_kinds))
                    throw std::invalid_argument("kind: expected camera, bounce, camera shadow or bounce shadow, got " +
                                                kind);
                RayRecord::Replay replay = [&, which = found->second] {
                    py::gil_scoped_release release;
                    return self.replay_rays(record, which, width, coherent, threads, rounds);
                }();
                py::dict d;
                d["seconds"] = replay.seconds;
                d["hits"] = replay.hits;
                return d;
            },
            py::arg("record"), py::arg("kind"), py::arg("width"), py::arg("coherent"), py::arg("threads"),
            py::arg("rounds"))
        .def("bounding_box", &SceneBase::bounds, Release())
        .def("emitter_probabilities", &SceneBase::emitter_probabilities, Release());
}

}  // namespace tr
