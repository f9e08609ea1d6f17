#include "native_scene.h"

#include <mutex>

#include "bend.h"
#include "core/sensor/camera.h"
#include "cpu/aovs.h"
#include "cpu/packet_rows.h"
#include "cpu/render_response.h"
#include "device/cards.h"
#include "device/scene_rays.h"
#include "device/tree_walk.h"
#if !TR_HAS_PACKETS
#include "cpu/device_paths.h"
#endif
#include "probes.h"

namespace tr {

namespace {

// Rays (n, 3) as columns in single precision.
struct RayBuffer {
    std::vector<float> columns[7];

    template <class S>
    RayBuffer(size_t n, const S *o, const S *d, const S *length) {
        for (auto &c : columns) c.resize(n);
        for (size_t i = 0; i < n; ++i) {
            for (size_t k = 0; k < 3; ++k) columns[k][i] = float(o[3 * i + k]), columns[3 + k][i] = float(d[3 * i + k]);
            columns[6][i] = float(length[i]);
        }
    }
    RayBatch batch() const {
        return {{columns[0].data(), columns[1].data(), columns[2].data()},
                {columns[3].data(), columns[4].data(), columns[5].data()},
                columns[6].data()};
    }
};

template <class S>
class NativeSceneOf final : public NativeScene {
public:
    // `channels` of colours: 1 or 3; `spectral`: which are spectra while rendering
    NativeSceneOf(int channels, bool spectral) : channels_(channels), spectral_(spectral) {}

    void build(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &shapes,
               const std::vector<IndexArray> &arrays, NativeScene *previous) override {
        auto *other = dynamic_cast<NativeSceneOf *>(previous);
        if (!other || other == this) {
            std::lock_guard<std::mutex> lock(mutex_);
            return data_.build(objects, shapes, arrays, channels_, nullptr, spectral_);
        }
        std::scoped_lock lock(mutex_, other->mutex_);
        data_.build(objects, shapes, arrays, channels_, &other->data_, spectral_);
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
                {"sdf_grids", c.sdf_grids},
                {"environments", c.environments}};
    }

    RenderStats render(const Config &c, const ParameterValues &values, const Arrays &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *rays = updated(c, values);
        auto at = [&](const char *name) { return reinterpret_cast<S *>(out.count(name) ? out.at(name) : 0); };
        RenderCall<S> primal = call(c);
        if (c.light) {
            if (!rays) return trace_light<S>(primal, at("image"), c.sums);
            return there(*rays, [&](auto &paths, const auto &tree) {
                return paths.light(primal, data_, tree, at("image"), c.sums);
            });
        }
        if (c.hits) primal.keep_hits = c.hits->add_pass();
        const RenderOutput<S> to{{at("image"), at("alpha"), at("variance"), at("second_moment")}, c.sums};
        if (!rays) return render_primal<S>(primal, to);
        return there(*rays, [&](auto &paths, const auto &tree) { return paths.render(primal, data_, tree, to); });
    }

    RenderStats reverse(const Config &c, const ParameterValues &values, const Addresses &adjoints,
                        const std::vector<Addresses> &gradients) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *rays = updated(c, values);
        RenderCall<S> reverse = call(c);
        if (c.hits) reverse.kept_hits = c.hits->pass(c.hits_pass);
        std::vector<DerivativeCall<S>> derivatives;
        std::vector<DerivativeCall<S> *> all;
        for (size_t k = 0; k < adjoints.size(); ++k) {
            DerivativeCall<S> &d = derivatives.emplace_back(reverse_call(data_, c.path, c.light, gradients[k]));
            d.adjoint = reinterpret_cast<const S *>(adjoints[k]);
            d.adaptive = c.adaptive, d.fixed_sums = c.fixed_sums;
        }
        for (DerivativeCall<S> &d : derivatives) all.push_back(&d);
        RenderStats stats;
        if (!rays && !c.light && !c.adaptive && !c.path.stokes)
            stats = render_reverse<S>(reverse, all);
        else
            for (DerivativeCall<S> &d : derivatives) {
                stats.add_call(rays      ? there(*rays,
                                                 [&](auto &paths, const auto &tree) {
                                                return c.light ? paths.reverse_light(reverse, data_, tree, d)
                                                               : paths.reverse(reverse, data_, tree, d);
                                                 })
                               : c.light ? trace_light_reverse<S>(reverse, d)
                                         : render_reverse<S>(reverse, d));
                if (stats.interrupted) break;
            }
        for (size_t k = 0; k < adjoints.size(); ++k) add_gradients(data_, derivatives[k], gradients[k], c.threads);
        return stats;
    }

    RenderStats forward(const Config &c, const ParameterValues &values, const Addresses &tangents,
                        uintptr_t image) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *rays = updated(c, values);
        const ForwardCall<S> d(data_, c.path, c.light, tangents);
        S *to = reinterpret_cast<S *>(image);
        if (rays)
            return there(*rays, [&](auto &paths, const auto &tree) {
                return c.light ? paths.forward_light(call(c), data_, tree, d.call, to)
                               : paths.forward(call(c), data_, tree, d.call, to);
            });
        return c.light ? trace_light_forward<S>(call(c), d.call, to) : render_forward<S>(call(c), d.call, to);
    }

    RenderStats weights(const Config &c, const ParameterValues &values, const Arrays &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        update(values);
        auto at = [&](const char *name) { return reinterpret_cast<double *>(out.count(name) ? out.at(name) : 0); };
        return pixel_weights<S>(call(c), outputs(c, {}), {at("samples"), at("hits")});
    }

    RenderStats response_reverse(const Config &c, const ParameterValues &values, uintptr_t adjoint,
                                 uintptr_t gradient) override {
        std::lock_guard<std::mutex> lock(mutex_);
        update(values);
        const auto *from = reinterpret_cast<const S *>(adjoint);
        auto *to = reinterpret_cast<double *>(gradient);
        return c.light ? trace_light_responses<S>(call(c), from, to) : tr::response_reverse<S>(call(c), from, to);
    }

    RenderStats aov(const Config &c, const ParameterValues &values, const Arrays &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *rays = updated(c, values);
        const AovOutput<S> to = outputs(c, out);
        if (!rays) return render_aov<S>(call(c), to);
        return there(*rays, [&](auto &paths, const auto &tree) { return paths.outputs(call(c), data_, tree, to); });
    }

    RenderStats aov_reverse(const Config &c, const ParameterValues &values, const Arrays &adjoints,
                            const Addresses &gradients) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *rays = updated(c, values);
        DerivativeCall<S> d = reverse_call(data_, c.path, c.light, gradients);
        d.fixed_sums = c.fixed_sums;
        const AovOutput<S> from = outputs(c, adjoints);
        RenderStats stats =
            rays ? there(*rays, [&](auto &paths,
                                    const auto &tree) { return paths.reverse_outputs(call(c), data_, tree, from, d); })
                 : reverse_aov<S>(call(c), from, d);
        add_gradients(data_, d, gradients, c.threads);
        return stats;
    }

    RenderStats aov_forward(const Config &c, const ParameterValues &values, const Addresses &tangents,
                            const Arrays &out) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *rays = updated(c, values);
        const ForwardCall<S> d(data_, c.path, c.light, tangents);
        const AovOutput<S> to = outputs(c, out);
        if (!rays) return forward_aov<S>(call(c), to, d.call);
        return there(*rays, [&](auto &paths, const auto &tree) {
            return paths.forward_outputs(call(c), data_, tree, to, d.call);
        });
    }

    bool find_outlines(const Config &c, const ParameterValues &values, uintptr_t moves,
                       SceneOutlines &outlines) override {
        std::lock_guard<std::mutex> lock(mutex_);
        update(values, c.on_device);
        outlines.shadows.reset();
        return tr::find_outlines<S>(call(c), reinterpret_cast<const uint8_t *>(moves), c.glued,
                                    data_.geometry_version(), outlines.set, outlines.pieces);
    }

    std::vector<RenderStats> boundary(const std::vector<Config> &configs, const ParameterValues &values,
                                      const std::vector<BoundaryRequest> &requests, SceneOutlines &outlines,
                                      const Addresses &slots, bool forward) override {
        std::lock_guard<std::mutex> lock(mutex_);
        if (configs.empty()) return {};
        const Config &c = configs[0];
        SceneRays *rays = updated(c, values, false);  // find_outlines has looked
        std::vector<RenderCall<S>> calls;
        std::vector<BoundaryCall<S>> boundaries;
        std::vector<AovLayout> layouts;  // to which the calls refer
        layouts.reserve(requests.size());
        for (size_t i = 0; i < requests.size(); ++i) {
            calls.push_back(call(configs[i]));
            share_wavelengths(calls.back());
            boundaries.push_back(boundary_call(configs[i], requests[i], outlines, calls[i], layouts));
        }
        auto look_for_shadows = [&](DerivativeCall<S> &d) {
            for (size_t i = 0; i < calls.size(); ++i) {
                const BoundaryPart part = boundaries[i].part;
                if (part != BoundaryPart::Shadows && part != BoundaryPart::Pilot) continue;
                auto look = [&](const BoundaryCall<S> &b) {
                    if (!rays) return void(boundary_forward<S>(calls[i], b, d));
                    there(*rays, [&](auto &paths, const auto &tree) {
                        return paths.boundary().look(calls[i], b, data_, tree, d);
                    });
                };
                if (!outlines.shadows) outlines.shadows = find_shadows<S>(calls[i], boundaries[i], look);
                boundaries[i].shadows = &*outlines.shadows;
            }
        };
        if (forward) {
            ForwardCall<S> d(data_, c.path, c.light, slots);
            look_for_shadows(d.call);
            std::vector<RenderStats> stats;
            for (size_t i = 0; i < calls.size(); ++i) {
                stats.push_back(rays ? there(*rays,
                                             [&](auto &paths, const auto &tree) {
                                                 return paths.boundary().forward(calls[i], boundaries[i], data_, tree,
                                                                                 d.call);
                                             })
                                     : boundary_forward<S>(calls[i], boundaries[i], d.call));
                if (stats.back().interrupted) break;
            }
            return stats;
        }
        DerivativeCall<S> d = reverse_call(data_, c.path, c.light, slots);
        d.fixed_sums = c.fixed_sums;
        look_for_shadows(d);
        std::vector<RenderStats> stats =
            rays ? there<std::vector<RenderStats>>(*rays,
                                                   [&](auto &paths, const auto &tree) {
                                                       return paths.boundary().reverse(calls, boundaries, data_, tree,
                                                                                       d);
                                                   })
                 : boundary_reverse<S>(calls, boundaries, d);
        add_gradients(data_, d, slots, calls[0].threads);
        return stats;
    }

    void intersect(size_t n, const std::array<uintptr_t, 3> &rays, const Arrays &out, const std::string &device,
                   const ParameterValues &values) override {
        using F = PacketOf<S>;
        using U = UIntOf<F>;
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *other = updated(device, values);
        const S *o = reinterpret_cast<const S *>(rays[0]), *d = reinterpret_cast<const S *>(rays[1]);
        RayBuffer buffer(n, o, d, reinterpret_cast<const S *>(rays[2]));
        std::vector<uint32_t> shape(n), primitive(n);
        std::vector<float> found[3];
        for (auto &column : found) column.resize(n);
        const HitBatch hits{shape.data(), primitive.data(), found[0].data(), found[1].data(), found[2].data()};
        other ? other->intersect(buffer.batch(), hits, n) : data_.accel().intersect(buffer.batch(), hits, n, false);
        std::vector<S> hit[3];
        for (int k = 0; k < 3; ++k) hit[k].assign(found[k].begin(), found[k].end());
        auto to = [&](const char *name) { return reinterpret_cast<S *>(out.at(name)); };
        auto to_index = [&](const char *name) { return reinterpret_cast<int32_t *>(out.at(name)); };
        const SceneView<S> &scene = data_.view();
        for_rows<F>(n, [&](const PacketRows<F> &rows) {
            const U shapes = rows.index(shape.data()), primitives = rows.index(primitive.data());
            auto is_hit = rows.active && !mask<F>(shapes == U(Accel::Miss));
            const F far = F(S(INFINITY));
            Interaction<F> si{};
            Vec2<F> uv{F(0), F(0)};
            if (any(is_hit)) {
                SurfacePoint<F> at{select(mask<U>(is_hit), shapes, U(0u)), select(mask<U>(is_hit), primitives, U(0u)),
                                   rows.number(hit[1].data()), rows.number(hit[2].data())};
                si = make_interaction(scene, Ray<F>{rows.vector(o), rows.vector(d)}, at, rows.number(hit[0].data()),
                                      is_hit);
                uv = texture_coordinates<F>(scene, static_cast<const SurfacePoint<F> &>(si.at), is_hit);
            }
            auto number = [&](const char *name, const F &x, const F &none) {
                rows.put(to(name), select(is_hit, x, none));
            };
            auto vector = [&](const char *name, const Vec3<F> &v, const F &none) {
                rows.put(to(name), select(is_hit, v, Vec3<F>{none, none, none}));
            };
            number("t", si.t, far), number("b1", si.at.b1, F(0)), number("b2", si.at.b2, F(0));
            vector("position", si.p, far), vector("normal", si.ng, F(0)), vector("shading_normal", si.frame.n, F(0));
            rows.put(to("uv"), Vec2<F>{select(is_hit, uv.x, F(0)), select(is_hit, uv.y, F(0))});
            rows.put_integers(to_index("shape_id"), select(mask<U>(is_hit), shapes, U(0xFFFFFFFFu)));
            rows.put_integers(to_index("prim_id"), select(mask<U>(is_hit), primitives, U(0xFFFFFFFFu)));
        });
    }

    void occluded(size_t n, const std::array<uintptr_t, 3> &rays, uintptr_t out, const std::string &device,
                  const ParameterValues &values) override {
        std::lock_guard<std::mutex> lock(mutex_);
        SceneRays *other = updated(device, values);
        auto at = [&](size_t k) { return reinterpret_cast<const S *>(rays[k]); };
        RayBuffer buffer(n, at(0), at(1), at(2));
        auto *hit = reinterpret_cast<uint8_t *>(out);
        other ? other->occluded(buffer.batch(), hit, n) : data_.accel().occluded(buffer.batch(), hit, n);
    }

    void probe(const std::string &what, int index, size_t n, const Arrays &arrays,
               const ParameterValues &values) override {
        std::lock_guard<std::mutex> lock(mutex_);
        update(values);
        const SceneView<S> &scene = data_.view();
        const Probe<S> probe{scene, data_.accel(), channels_, arrays};
        auto check = [&](const char *category, size_t count) {
            if (index < 0 || size_t(index) >= count)
                throw std::invalid_argument(std::string(category) + ": expected a number below " +
                                            std::to_string(count));
        };
        if (what.rfind("bsdf", 0) == 0) check("bsdf", size_t(scene.n_bsdfs));
        if (what.rfind("phase", 0) == 0) check("phase", data_.layout().records.at("phase").size());
        if (what == "emitter_sample" && scene.n_emitters == 0) throw std::invalid_argument("the scene has no emitters");
        if (what == "bsdf") return probe.bsdf(index, n);
        if (what == "bsdf_sample") return probe.bsdf_sample(index, n);
        if (what == "emitter_sample") return probe.emitter_sample(n);
        if (what == "emitter_pdf") return probe.emitter_pdf(n);
        if (what == "phase") return probe.phase(index, n);
        if (what == "phase_sample") return probe.phase_sample(index, n);
        if (what == "phase_reverse") return phase_reverse(probe, index, n);
        if (what == "phase_forward") return phase_forward(probe, index, n);
        throw std::invalid_argument("probe: unknown: " + what);
    }

    void bend(const BendRequest &request, const ParameterValues &values) override {
        if (request.what != "trace") return tr::bend<S>(nullptr, nullptr, request);
        std::lock_guard<std::mutex> lock(mutex_);
        update(values);
        tr::bend<S>(&data_.view(), &data_.accel(), request);
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
    const int channels_;
    const bool spectral_;
    SceneData<S> data_;
    std::mutex mutex_;
    std::shared_ptr<RayRecord> ray_record_;
    std::map<std::string, std::unique_ptr<SceneRays>> devices_;  // that were asked for
    TreeWalk walk_;

    void update(const ParameterValues &values, const OnDevice &there = {}, bool look = true) {
        data_.update(read_only<S>(values.addresses), values.dirty, look, there.values);
        data_.walk(nullptr);
    }

    static std::unique_ptr<SceneRays> make_rays(const std::string &device) {
        if (device == "emulated" || device == "tree") return std::make_unique<SceneRays>();
#if !TR_HAS_PACKETS
        if (device.compare(0, 5, "cuda:") == 0)
            return std::make_unique<SceneRays>(&cuda::make_card, std::stoi(device.substr(5)));
        if (device.compare(0, 3, "sm_") == 0)
            return std::make_unique<SceneRays>(&cuda::make_compiling, std::stoi(device.substr(3)));
        if (device.compare(0, 8, "compute_") == 0)
            return std::make_unique<SceneRays>(&cuda::make_compiling_ptx, std::stoi(device.substr(8)));
#endif
        throw std::invalid_argument("device: expected cpu, emulated, tree or a card (cuda:0), got " + device);
    }

    // Paths on another device: what f(paths, tree) returns.
    template <class Found = RenderStats, class Do>
    Found there([[maybe_unused]] SceneRays &rays, [[maybe_unused]] Do &&f) {
#if !TR_HAS_PACKETS
        return f(rays.resident<DevicePaths<S>>(), rays.device_tree());
#else
        throw std::invalid_argument("device: images are not rendered in packets");
#endif
    }

    // Rays of another device than the CPU, null for this one, where the scene is what `values` say. On `tree` it is the
    // CPU that walks the tree of devices, for comparisons.
    SceneRays *updated(const std::string &device, const ParameterValues &values, const OnDevice &there = {},
                       uintptr_t stream = 0, bool look = true) {
        if ((device == "cpu" || device == "tree") && (there.image || !there.slots.empty()))
            throw std::invalid_argument("device: the CPU does not reach tensors elsewhere");
        if (device == "cpu") {
            update(values, {}, look);
            return nullptr;
        }
        const std::vector<ShapeInfo> &shapes = data_.layout().shapes;
        for (size_t i = 0; i < shapes.size(); ++i)
            if (const char *missing = SceneRays::missing(shapes[i]))
                throw std::invalid_argument(data_.path("shape", int(i)) +
                                            ": devices have everything but curves so far, got " + missing +
                                            "; with TORCHRENDER_BACKEND=cpu rays meet everything");
        update(values, there, look);
        std::unique_ptr<SceneRays> &rays = devices_[device == "tree" ? "emulated" : device];
        if (!rays) rays = make_rays(device);
        rays->use_stream(stream);
        rays->update(data_.view(), data_.geometry_version());
        if (device != "tree") return rays.get();
        walk_.tree = rays->tree().view();
        data_.walk(&walk_);
        return nullptr;
    }

    SceneRays *updated(const Config &c, const ParameterValues &values, bool look = true) {
        if (c.light && c.on_device.image)
            throw std::invalid_argument("device: images of light paths are in the host's memory");
        return updated(c.device, values, c.on_device, c.stream, look);
    }

    RenderCall<S> call(const Config &c) {
        const std::vector<Record> &sensors = data_.layout().records.at("sensor");
        if (c.path.sensor >= sensors.size())
            throw std::invalid_argument("sensor: expected a number below " + std::to_string(sensors.size()) + ", got " +
                                        std::to_string(c.path.sensor));
        const Record &sensor = sensors[c.path.sensor];
        const bool meter = sensor.kind == IrradianceMeterKind;
        if (!c.light && meter) throw std::invalid_argument("sensor: an irradiancemeter is measured by light tracing");
        if (c.light && !meter && !is_pinhole(sensor))
            throw std::invalid_argument("sensor: light paths are connected to pinholes without distortion alone");
        data_.choose_emitters(c.by_power);
        RenderCall<S> call{};
        call.scene = &data_.view();
        call.accel = &data_.accel();
        if ((c.path.spectral.positions != nullptr) != spectral_)
            throw std::invalid_argument("spectral: wavelengths are given to spectral scenes, and to these alone");
        call.config = c.path;
        call.filter = c.filter;
        call.film_height = c.height, call.film_width = c.width;
        call.crop = c.crop;
        call.samples = c.window;
        if (c.pixels) call.pixels = &*c.pixels;
        call.values = channels_;
        call.spp = c.spp, call.sample_offset = c.sample_offset;
        call.threads = c.threads;
        call.ray_record = ray_record_.get();
        call.interrupted = c.interrupted;
        call.on_device = c.on_device;
        return call;
    }

    static AovOutput<S> outputs(const Config &c, const Arrays &given) {
        AovOutput<S> out;
        for (const auto &[name, address] : given) {
            int kind = 0;
            while (kind < AovCount && name != aov_names[kind].name) ++kind;
            if (kind < AovCount)
                out.data[size_t(kind)] = reinterpret_cast<S *>(address);
            else if (name == "covered")
                out.covered = reinterpret_cast<S *>(address);
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

    BoundaryCall<S> boundary_call(const Config &c, const BoundaryRequest &given, const SceneOutlines &outlines,
                                  const RenderCall<S> &call, std::vector<AovLayout> &layouts) {
        constexpr const char *parts[] = {"silhouettes", "outputs", "reflections", "shadows", "pilot"};
        const auto *part = std::find(std::begin(parts), std::end(parts), given.part);
        if (part == std::end(parts)) throw std::invalid_argument("boundary: unknown: " + given.part);
        auto number = [&](const char *name) { return given.numbers.at(name); };
        auto reals = [&](const char *name) {
            return reinterpret_cast<double *>(given.arrays.count(name) ? given.arrays.at(name) : 0);
        };
        BoundaryCall<S> b{};
        b.part = BoundaryPart(part - parts);
        const AovOutput<S> seen = outputs(c, given.outputs);
        const AovLayout &layout = layouts.emplace_back(layout_of(seen, channels_));
        const bool of_outputs = b.part == BoundaryPart::Outputs;
        b.layout = &layout, b.channels = (of_outputs ? layout.n : call.numbers()) + 1;
        b.filter = of_outputs ? filter_of(seen, call.filter) : call.filter;
        b.outlines = &outlines.set, b.pieces = &outlines.pieces;
        b.moves = reinterpret_cast<const uint8_t *>(given.arrays.at("moves"));
        b.samples = number("samples");
        b.cells = reinterpret_cast<const int64_t *>(given.arrays.at("cells")), b.n_cells = size_t(number("cells"));
        b.first = uint64_t(number("first")), b.count = uint64_t(number("count")), b.total = number("total");
        b.near = number("near"), b.in_view = number("in_view"), b.weighs = number("weighs") != 0;
        b.glued = c.glued;
        b.adjoint = reals("adjoint"), b.place = reals("place"), b.value = reals("value");
        return b;
    }

    // Of a probe's arrays those that go by the number of a slot.
    Addresses slots_of(const Probe<S> &probe) const {
        Addresses slots(data_.n_params(), 0);
        for (size_t i = 0; i < slots.size(); ++i)
            if (auto found = probe.arrays.find(std::to_string(i)); found != probe.arrays.end())
                slots[i] = found->second;
        return slots;
    }

    void phase_reverse(const Probe<S> &probe, int index, size_t n) {
        const Addresses slots = slots_of(probe);
        DerivativeCall<S> d{};
        d.needs = {};
        d.sums.constants.assign(data_.n_constants(), 0.0);
        std::vector<S *> tensors = tensors_of(data_, slots);
        GradientSink<PacketOf<S>> sink;
        sink.constants = d.sums.constants.data(), sink.tensors = tensors.data();
        probe.phase_sweep(index, n, sink);
        add_gradients(data_, d, slots, 1);
    }

    void phase_forward(const Probe<S> &probe, int index, size_t n) {
        const ForwardCall<S> d(data_, PathConfig{}, false, slots_of(probe));
        auto sink = d.call.template forward_sink<PacketOf<S>>();
        probe.phase_sweep(index, n, sink);
    }
};

}  // namespace

std::unique_ptr<NativeScene> make_scene(const std::string &color, const std::string &dtype) {
    if (color != "mono" && color != "rgb" && color != "spectral")
        throw std::invalid_argument("Scene: color: expected mono, rgb or spectral, got " + color);
    const int channels = color == "mono" ? 1 : 3;
    const bool spectral = color == "spectral";
    if (dtype == "float32") return std::make_unique<NativeSceneOf<float>>(channels, spectral);
#if !TR_HAS_PACKETS
    if (dtype == "float64") return std::make_unique<NativeSceneOf<double>>(channels, spectral);
#endif
    throw std::invalid_argument("Scene: dtype: this module does not compute in " + dtype);
}

}  // namespace tr
