// What samples of outlines have in common, whichever way they are found: vertices of paths from which light is looked
// up, rays beside outlines, radiance along rays, and the sums that a moving outline adds to.
//
// A sample's rate n.(dB - ...) has a weight for each channel of the film and, of polarised light, for each component of
// the Stokes vector (a `part`). In reverse mode the film's adjoint makes one number of them; forward mode has a sweep a
// channel and part (see GradientSink). Whatever belongs to one sample has the same wavelengths (share_wavelengths).
// What polarised light does before it reaches the chosen vertex of a path is there as rows, one a part.
//
// Of `glued` samples, which are for light paths, both ends S and E of a segment past an outline move with their
// surfaces, wherever they are; then no more than what the outline uncovers counts, its rate being n.(dB - (1 - tau) dS
// - tau dE), tau = |B - S| / |E - S|: see docs/theory/light_tracing.md.
#pragma once

#include <cmath>

#include "boundary_columns.h"
#include "core/adjoint/revisit.h"
#include "path_tile.h"

namespace tr {

template <class F>
class BoundaryTile {
protected:
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    using V = Vec3<S>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

    const RenderCall<S> &call_;
    const BoundaryCall<S> &boundary_;
    const SceneView<S> &scene_;
    const Outlines<S> outlines_;

    // Paths look for no lights: what they are for is their vertices.
    static RenderCall<S> without_lights(const RenderCall<S> &call, BoundaryPart part) {
        RenderCall<S> r = call;
        r.config.emitter_samples = 0, r.config.bsdf_samples = 1;
        r.config.sampler = {};
        // the last vertex of paths to lights is one that lights have found
        if (part == BoundaryPart::Shadows && r.config.max_depth > 0) --r.config.max_depth;
        r.ray_record = nullptr;
        return r;
    }
    const RenderCall<S> path_call_;
    PathTile<F> paths_, light_;
    AnchorColumns<S> anchors_;
    GluedColumns<S> glued_;
    RowColumns<S> leaving_[4], arriving_[4];  // at chosen vertices, for what leaves these, and for what arrives from d

public:
    static constexpr size_t Capacity = 1024;

    BoundaryTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : call_(call),
          boundary_(boundary),
          scene_(*call.scene),
          outlines_(*call.scene, *boundary.outlines),
          path_call_(without_lights(call, boundary.part)),
          paths_(path_call_, Capacity, &derivative),
          light_(call, 2 * Capacity, nullptr) {
        arena_.allocate(Capacity + 2 * W, anchors_);
        if (polarized())
            row_arena_.allocate(Capacity + 2 * W, leaving_[0], leaving_[1], leaving_[2], leaving_[3], arriving_[0],
                                arriving_[1], arriving_[2], arriving_[3]);
        glued_arena_.allocate(2 * Capacity + 2 * W, glued_);
    }

    RenderStats take_stats() {
        RenderStats stats = paths_.take_stats();
        stats.add(light_.take_stats());
        return stats;
    }

protected:
    bool polarized() const { return call_.config.stokes; }
    int parts() const { return polarized() ? 4 : 1; }
    // The slots with a component of the Stokes vector in the place of radiance.
    static SlotColumns<S> of_part(SlotColumns<S> slots, int part) {
        const SpectrumColumn<S> columns[] = {slots.radiance, slots.q, slots.u, slots.v};
        slots.radiance = columns[part];
        return slots;
    }
    Wavelengths<F> waves_of(const U &slot, const M &active) const {
        Gathered<F> from(slot, active);
        return wavelengths_of<F>(call_.config, from(paths_.slots.pixel), from(paths_.slots.sample));
    }
    // What a spectrum at a sample's wavelengths adds to the film.
    Spectrum<S> to_channels(uint32_t slot, const Spectrum<S> &x) const {
        return SampleColors<S>(call_.config, paths_.slots.pixel[slot], paths_.slots.sample[slot]).channels(x);
    }

    // ------------------------------------------------------------------------------------------- vertices of paths
    // Which samples the slots are: `first` .. `first` + n of the call.
    void identify(uint64_t first, uint32_t n) {
        auto &slots = paths_.slots;
        const double each = double(boundary_.n_cells) / boundary_.samples;  // cells that a sample stands for
        for (uint32_t k = 0; k < n; ++k) {
            const uint64_t sample = boundary_.first + first + k;
            slots.pixel[k] = uint32_t(sample), slots.sample[k] = uint32_t(sample >> 32);
            const double u = double(uniform_of<S>(bits(k, PlaceBlock).bits[1]));
            const double at = (double(sample % uint64_t(boundary_.samples)) + u) * each;
            const int64_t *cell = boundary_.cells + 2 * std::min(size_t(at), boundary_.n_cells - 1);
            slots.column[k] = uint32_t(int32_t(cell[0])), slots.row[k] = uint32_t(int32_t(cell[1]));
        }
        std::fill_n(anchors_.level.at, n, NoVertex);
    }
    // Their paths from the camera.
    template <class Stop>
    void trace_paths(uint32_t n, Stop &&stop) {
        paths_.start(n, false);
        const auto &slots = paths_.slots;
        for (uint32_t k = 0; k < n; ++k) {  // a place that was rounded up is in another pixel
            slots.film_x[k] = std::min(slots.film_x[k], std::nextafter(S(int32_t(slots.column[k]) + 1), S(-INFINITY)));
            slots.film_y[k] = std::min(slots.film_y[k], std::nextafter(S(int32_t(slots.row[k]) + 1), S(-INFINITY)));
        }
        paths_.run(true, stop, 0, false, boundary_.glued);
    }
    // Random numbers of a sample that paths do not use: two for choices (0, 1), and a seed.
    static constexpr uint32_t OutlineBlock = 0x60000000u, PlaceBlock = OutlineBlock + 1;
    RandomBits4<S> bits(uint32_t slot, uint32_t block = OutlineBlock) const {
        return random_bits4<S>(call_.config.seed, call_.config.sensor, paths_.slots.pixel[slot],
                               paths_.slots.sample[slot], UIntOf<S>(block));
    }
    S number(uint32_t slot, int which) const { return uniform_of<S>(bits(slot).bits[which]); }
    uint64_t tree_seed(uint32_t slot, uint32_t copy = 0) const {
        const RandomBits4<S> r = bits(slot);
        return (uint64_t(r.bits[2]) << 32 | r.bits[3]) + copy * 0xD1B54A32D192ED03ull;
    }

    // Calls visit(level, range) for the vertices that scatter smoothly.
    template <class Visit>
    void for_smooth(PathTile<F> &tile, Visit &&visit) {
        Tape<S> &tape = tile.wavefront.tape;
        for (int l = 0; l < tape.size(); ++l) {
            if (!tape[l].scatters) continue;
            for (const KindRange &range : tape[l].ranges)
                if (range.kind < MissKind && bsdf_kernels<F>(range.kind).is(HasSmoothLobes)) visit(uint32_t(l), range);
        }
    }

    // One vertex of each path, in proportion to its throughput; `inverse` becomes one over the probability, `total`
    // what all of its vertices have.
    void choose_vertices(uint32_t n, const std::vector<double> &u, std::vector<double> &inverse,
                         std::vector<double> &total) {
        Tape<S> &tape = paths_.wavefront.tape;
        const size_t values = size_t(call_.values);
        std::vector<double> before(n, 0);
        total.assign(n, 0);
        auto each = [&](auto &&visit) {
            for_smooth(paths_, [&](uint32_t l, const KindRange &range) {
                const auto &v = tape[int(l)].columns.vertex;
                for (uint32_t e = range.begin; e < range.begin + range.count; ++e) {
                    double weight = 0;
                    for (size_t c = 0; c < values; ++c) weight += std::fabs(double(v.beta[int(c)][e]));
                    if (weight > 0 && std::isfinite(weight)) visit(v.slot[e], l, e, weight);
                }
            });
        };
        each([&](uint32_t slot, uint32_t, uint32_t, double weight) { total[slot] += weight; });
        each([&](uint32_t slot, uint32_t l, uint32_t e, double weight) {
            const double at = u[slot] * total[slot];
            if (at >= before[slot] && at < before[slot] + weight)
                anchors_.level[slot] = l, anchors_.entry[slot] = e, inverse[slot] = total[slot] / weight;
            before[slot] += weight;
        });
    }

    // Calls visit(columns, kind, i, slot, active) for packets of chosen vertices.
    template <class Visit>
    void for_chosen(Visit &&visit) {
        for_smooth(paths_, [&](uint32_t l, const KindRange &range) { for_chosen_of(l, range, visit); });
    }
    template <class Visit>
    void for_chosen_of(uint32_t l, const KindRange &range, Visit &&visit) {
        const auto &columns = paths_.wavefront.tape[int(l)].columns;
        for (uint32_t i = range.begin; i < range.begin + range.count; i += W) {
            M there = mask<F>(lane_index<F>() < U(range.begin + range.count - i));
            U slot = select(mask<U>(there), load_uint<F>(columns.vertex.slot.at + i), U(0u));
            Gathered<F> from(slot, there);
            M active = there && mask<F>(from(anchors_.level) == U(l)) &&
                       mask<F>(from(anchors_.entry) == U(i) + lane_index<F>());
            if (any(active)) visit(columns, range.kind, i, slot, active);
        }
    }
    void find_lobes() {
        for_chosen([&](const TapeColumns<S> &columns, int kind, uint32_t i, const U &slot, const M &active) {
            ScatteringLobe<F> lobe = scattering_lobe<F>(scene_, waves_of(slot, active), kind, columns, i, active);
            put(anchors_.n, slot, lobe.n, active), put(anchors_.axis, slot, lobe.axis, active);
            scatter_lanes<F>(anchors_.k.at, slot, lobe.k, active);
            scatter_lanes<F>(anchors_.share.at, slot, lobe.share, active);
        });
    }
    void find_normals() {
        for_chosen([&](const TapeColumns<S> &columns, int, uint32_t i, const U &slot, const M &active) {
            put(anchors_.ng, slot, geometric_normal<F>(scene_, columns, i, active), active);
        });
    }
    // f and pdf from d; of polarised light also the rows for what arrives from there.
    void scatter_chosen() {
        for_chosen([&](const TapeColumns<S> &columns, int kind, uint32_t i, const U &slot, const M &active) {
            Gathered<F> from(slot, active);
            Vec3<F> d = from(anchors_.d);
            const Wavelengths<F> waves = waves_of(slot, active);
            BsdfValue<F> value =
                scatter_towards<F>(scene_, waves, kind, columns, i, d, paths_.wavefront.needs(), active);
            for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(anchors_.f[c], slot, value.f[c], active);
            scatter_lanes<F>(anchors_.pdf.at, slot, value.pdf, active);
            for (int part = 0; polarized() && part < 4; ++part) {
                const RowColumns<S> &of = leaving_[part];
                const Stokes<F> leaving{{from(of.i), from(of.q), from(of.u), from(of.v)}, from(of.axis)};
                put(arriving_[part], slot, row_towards<F>(scene_, waves, kind, columns, i, d, value.f, leaving, active),
                    active);
            }
        });
    }
    // The rows of paths, and those for what leaves their chosen vertices.
    void find_rows(uint32_t n) {
        if (!polarized()) return;
        const auto &slots = paths_.slots;
        const SpectrumColumn<S> adjoints[] = {slots.delta, slots.delta_q, slots.delta_u, slots.delta_v};
        const SweepContext<F> c = paths_.sweep_context(slots, false);
        Tape<S> &tape = paths_.wavefront.tape;
        for (int part = 0; part < 4; ++part) {
            for (int k = 0; k < 4; ++k)
                for (int j = 0; j < SpectrumSize; ++j) std::fill_n(adjoints[k][j], n, S(k == part ? 1 : 0));
            paths_.hand_rows(slots);
            for_smooth(paths_, [&](uint32_t l, const KindRange &range) {
                const TapeLevel<S> &level = tape[int(l)];
                const TapeColumns<S> *parents = level.parent_level >= 0 ? &tape[level.parent_level].columns : nullptr;
                for_chosen_of(
                    l, range, [&](const TapeColumns<S> &columns, int kind, uint32_t i, const U &slot, const M &active) {
                        put(leaving_[part], slot, leaving_row<F>(c, columns, parents, kind, i, active), active);
                    });
            });
        }
    }
    StokesRows<S> rows_towards(uint32_t slot) const {
        return {arriving_[0].get(slot), arriving_[1].get(slot), arriving_[2].get(slot), arriving_[3].get(slot)};
    }
    // The film's axis for what travels along k.
    V axis_on_film(const V &k) const { return film_axis<S>(scene_, call_.config.sensor, k); }
    // What a column along k that is on this axis adds to each part of the film.
    static void contract_rows(const StokesRows<S> &rows, const Stokes<S> &column, const V &k, Spectrum<S> (&sums)[4]) {
        for (size_t part = 0; part < 4; ++part) {
            const Stokes<S> turned = turned_column(column, rows[part].axis, k);
            sums[part] = uniform_spectrum(S(0));
            for (int j = 0; j < 4; ++j) sums[part] = sums[part] + rows[part].at[j] * turned.at[j];
        }
    }
    // Whether a chosen vertex is reached by the first of the wavelengths alone.
    bool is_single(uint32_t slot) {
        if (!call_.config.spectral.positions) return false;
        Tape<S> &tape = paths_.wavefront.tape;
        uint32_t e = anchors_.entry[slot];
        for (int l = int(anchors_.level[slot]), before = tape[l].parent_level; before >= 0;
             l = before, before = tape[l].parent_level) {
            e = tape[l].columns.vertex.parent[e];
            if (!(tape[before].columns.outgoing.lobe[e] == RefractsFirst)) continue;
            for (const KindRange &range : tape[before].ranges)
                if (e >= range.begin && e < range.begin + range.count && range.kind < MissKind &&
                    bsdf_kernels<F>(range.kind).turned_by >= 0)
                    return true;
        }
        return false;
    }
    TapeLevel<S> &level_of(uint32_t slot) { return paths_.wavefront.tape[int(anchors_.level[slot])]; }
    V place_of(uint32_t slot) { return level_of(slot).columns.arrival.p.get(anchors_.entry[slot]); }
    static Vec3<float> single(const V &v) { return {float(v.x), float(v.y), float(v.z)}; }
    // The weight of outlines that rest, as what moves or rests sees them: they count to the latter where light of what
    // moves ends there.
    static float still(bool moves) { return moves ? 1.f : 0.05f; }
    // Whether a vertex moves: with its shape, or because one before it does.
    bool vertex_moves(uint32_t slot) {
        Tape<S> &tape = paths_.wavefront.tape;
        uint32_t e = anchors_.entry[slot];
        for (int l = int(anchors_.level[slot]); l >= 0; l = tape[l].parent_level) {
            if (boundary_.moves[tape[l].columns.vertex.at.shape[e]]) return true;
            e = tape[l].columns.vertex.parent[e];
        }
        return false;
    }
    OutlineAnchor anchor(uint32_t slot, const V &p, uint32_t shape) {
        OutlineAnchor a{};
        a.p = single(p), a.n = single(anchors_.n.get(slot)), a.axis = single(anchors_.axis.get(slot));
        a.k = float(anchors_.k[slot]), a.share = float(anchors_.share[slot]);
        a.parallel = false, a.own = int32_t(shape), a.still = still(vertex_moves(slot));
        return a;
    }

    // ------------------------------------------------------------------------------------------------- the camera
    CameraSample<S> lens_of(uint32_t slot) const {
        CameraSample<S> sample{S(0), S(0)};
        const auto &slots = paths_.slots;
        if (uses_lens(sensor()))
            sample.choose_lens(draw4<S>(path_call_.config, slots.pixel[slot], slots.sample[slot], 0, 4));
        return sample;
    }
    const Record &sensor() const { return scene_.sensors[call_.config.sensor]; }

    // Area perpendicular to a camera ray along d, at that distance from where it comes from, of what a pixel sees.
    S pixel_area(const CameraSample<S> &place, const V &d, S distance) const {
        const S width = S(call_.film_width), height = S(call_.film_height);
        if (is_pinhole(sensor())) {
            const Perspective::FilmPoint<S, S> film(scene_, sensor(), place.x, place.y, width, height);
            const S cosine = rsqrt(squared_norm(film.direction()));
            return distance * distance * cosine * cosine * cosine * 4 * film.slope * film.rise / (width * height);
        }
        if (sensor().kind == kind_of_model<Distant>(Sensors{})) {
            const S radius = DistantBase<S>(scene_, sensor()).radius;
            return S(Pi) * radius * radius;
        }
        const S step = S(0.05);
        auto end = [&](S x, S y) {
            CameraSample<S> moved = place;
            moved.x += x, moved.y += y;
            const CameraRay<S> ray = camera_ray<S>(scene_, sensor(), moved, width, height);
            return ray.center + ray.ray.d * distance;
        };
        const V x = (end(step, 0) - end(-step, 0)) * (1 / (2 * step)),
                y = (end(0, step) - end(0, -step)) * (1 / (2 * step));
        return std::fabs(dot(cross(x, y), d));
    }

    // ---------------------------------------------------------------------------------------------- rays and light
    struct OutlineRay {
        V o, d;
        SurfacePoint<S> at{NoHit, 0, 0, 0};  // what it meets, once that is known
        S t = S(INFINITY);
        V met_from{};  // where it was when it met that, beyond emitters that it has passed
    };
    // From a point (of a surface with this normal) past b, beside it on the side of the unit vector `across`.
    static OutlineRay beside(const V &origin, const V &ng, const V &b, const V &across, S room, S reach, S rim) {
        const S distance = length(b - origin);
        const S side = std::max(std::min(distance * S(0x1p-17), room / 8), least_side(b, distance, reach));
        const V at = b + across * (side + rim), o = offset_origin(origin, ng, unit(at - origin));
        return {o, unit(at - o)};
    }
    // How far beside b rays can be told apart that begin at a distance, and pass triangles that reach so far: they are
    // traced in single precision, and Embree's robust test takes what is up to 12 * 2^-24 of a triangle's extent beside
    // it, as was measured.
    static S least_side(const V &b, S distance, S reach) {
        return S(0x1p-24) * (8 * (max_abs(b) + distance) + 24 * reach);
    }
    static S length(const V &v) { return std::sqrt(dot(v, v)); }
    static V unit(const V &v) { return v * (1 / std::max(length(v), S(1e-30))); }

    // Nothing is before an outline's point, r away, on the free side (a sphere is met before its contour on the other);
    // beside creases rays have to meet the crease's own faces. t: what rays on the side of -n and of n meet.
    static bool is_open(S front, S r, const S (&t)[2], S tolerance) {
        for (int side = 0; side < 2; ++side) {
            const bool free = side == 0 ? front >= 0 : front <= 0;
            if (free && t[side] < r * (1 - tolerance)) return false;
            if (front == 0 && !(std::fabs(t[side] - r) < S(5e-3) * r)) return false;
        }
        return true;
    }

    // The share of what a point gets from another, at a distance, that samples from lights find.
    double apart(double distance) const {
        const double square = distance * distance;
        return square / (square + boundary_.near * boundary_.near);
    }

    // Rays of these lengths, at most 2 Capacity, where queries find them.
    template <class Length>
    PathQueue<S> &fill(const std::vector<OutlineRay> &rays, Length &&length) {
        PathQueue<S> &queue = light_.wavefront.queues[0];
        for (size_t k = 0; k < rays.size(); ++k)
            queue.o.set(k, rays[k].o), queue.d.set(k, rays[k].d), queue.length[k] = length(k);
        return queue;
    }
    void trace(PathQueue<S> &queue, size_t n) {
        queries().intersect(rays_of(queue), n, false);
        light_.wavefront.stats.closest_rays += n;
    }
    void intersect(std::vector<OutlineRay> &rays) {
        trace(fill(rays, [](size_t) { return S(INFINITY); }), rays.size());
        keep_hits(rays);
    }
    void keep_hits(std::vector<OutlineRay> &rays) {
        const HitColumns<S> &hits = queries().hits;
        for (size_t i = 0; i < rays.size(); ++i) {
            rays[i].at = {hits.at.shape[i], hits.at.primitive[i], hits.at.b1[i], hits.at.b2[i]};
            rays[i].t = rays[i].at.shape == NoHit ? S(INFINITY) : hits.t[i];
        }
    }
    RayQueries<S> &queries() { return light_.wavefront.queries; }

    // Radiance, at the wavelengths of their samples, along rays behind `depth` vertices, into the slots of `light_`, of
    // polarised light on axes that are the film's; `traced`: their hits are known; pdf: with which density their
    // directions are sampled beside lights, 0 where they alone find the light; `seen`: see PathQueue.
    template <class Stop>
    void look_up(const std::vector<OutlineRay> &rays, const std::vector<S> &lengths, const std::vector<S> &pdf,
                 const std::vector<uint32_t> &key, const std::vector<uint32_t> &seen, int depth, bool traced,
                 Stop &&stop) {
        const uint32_t n = uint32_t(rays.size());
        light_.begin(n);
        auto &slots = light_.slots;
        PathQueue<S> &queue = light_.wavefront.queues[0];
        for (uint32_t k = 0; k < n; ++k) {
            slots.pixel[k] = key[k], slots.sample[k] = 0, slots.row[k] = slots.column[k] = 0;
            slots.alpha[k] = 0;
            for (int c = 0; c < SpectrumSize; ++c)
                slots.radiance[c][k] = 0, queue.beta[c][k] = 1, queue.survival[c][k] = 1;
            for (int c = 0; polarized() && c < SpectrumSize; ++c) slots.q[c][k] = slots.u[c][k] = slots.v[c][k] = 0;
            queue.o.set(k, rays[k].o), queue.d.set(k, rays[k].d), queue.from.set(k, rays[k].o);
            queue.length[k] = lengths[k], queue.pdf[k] = pdf[k], queue.eta[k] = 1;
            queue.slot[k] = k, queue.parent[k] = 0, queue.seen[k] = seen[k];
        }
        queue.n = n;
        const HitColumns<S> &hits = queries().hits;
        for (uint32_t k = 0; k < n && traced; ++k) {
            const SurfacePoint<S> &at = rays[k].at;
            hits.at.shape[k] = at.shape, hits.at.primitive[k] = at.primitive;
            hits.at.b1[k] = at.b1, hits.at.b2[k] = at.b2, hits.t[k] = rays[k].t;
        }
        light_.run(polarized(), stop, depth, traced, boundary_.glued && depth == 0);
        if (polarized()) light_.sweep_columns();
    }

    // ------------------------------------------------------------------------------------------------------- sums
    // What a place on the film gets of the adjoint.
    void collect(S x, S y, double *to) const {
        boundary_.film->collect(boundary_.filter, int(std::floor(y)), int(std::floor(x)), double(y), double(x), to);
    }
    // Whether a pixel that is wanted may get something of it. (Beyond the part of the film that has samples nothing is
    // seen.)
    bool near_film(S x, S y) const {
        const S reach = S(boundary_.filter.reach());
        const Rect &there = call_.samples;
        if (!(x >= S(there.x0) && x < S(there.x1) && y >= S(there.y0) && y < S(there.y1))) return false;
        return x >= S(call_.crop.x0) - reach && x < S(call_.crop.x1) + reach && y >= S(call_.crop.y0) - reach &&
               y < S(call_.crop.y1) + reach;
    }
    // The number that the film's adjoint of a place makes of jumps, by part.
    template <class Jump>
    S contracted(S x, S y, Jump &&jump) const {
        bool some = false;
        for (int part = 0; part < parts(); ++part)
            for (int c = 0; c < call_.values; ++c) some |= jump(part)[c] != 0;
        if (!some) return 0;
        double adjoint[MostBoundaryChannels], sum = 0;
        collect(x, y, adjoint);
        for (int part = 0; part < parts(); ++part)
            for (int c = 0; c < call_.values; ++c) sum += adjoint[part * call_.values + c] * double(jump(part)[c]);
        return S(sum);
    }
    // Forward mode: calls add(part, channel, slots) for all of them, the slots' radiance being what it adds to.
    template <class Add>
    void for_parts(uint32_t n, const SlotColumns<S> &slots, GradientSink<F> &sink, Add &&add) const {
        for (int part = 0; part < parts(); ++part) {
            const SlotColumns<S> to = of_part(slots, part);
            for (int c = 0; c < SpectrumSize; ++c) std::fill_n(to.radiance[c], n, S(0));
            for (int c = 0; c < call_.values; ++c) {
                sink.component = c;
                add(part, c, to);
            }
        }
    }
    // ... what the sample of a slot adds to the film.
    void write_value(uint64_t row, const SlotColumns<S> &slots, uint32_t slot) const {
        double *place = boundary_.place + 2 * row, *value = boundary_.value + size_t(boundary_.channels) * row;
        place[0] = double(slots.film_x[slot]), place[1] = double(slots.film_y[slot]);
        for (int part = 0; part < parts(); ++part)
            for (int c = 0; c < call_.values; ++c) *value++ = double(of_part(slots, part).radiance[c][slot]);
    }

    void add_to_outline(int32_t element, S s, const V &p, const V &p_bar, PointSink<F> &sink) {
        outlines_.spread(
            element, s, p,
            [&](uint32_t shape, uint32_t index, S share) {
                if (sink.wants(shape)) sink.vertex(index, p_bar * share);
            },
            [&](uint32_t shape, const V &local) {
                if (sink.wants(shape)) sink.matrix(shape, local, p_bar);
            });
    }
    void add_glued(uint32_t slot, const SurfacePoint<S> &at, const V &p, const V &p_bar) {
        const uint32_t k = glued_.n++;
        glued_.slot[k] = slot;
        glued_.at.shape[k] = at.shape, glued_.at.primitive[k] = at.primitive;
        glued_.at.b1[k] = at.b1, glued_.at.b2[k] = at.b2;
        glued_.p.set(k, p), glued_.p_bar.set(k, p_bar);
    }
    // Hands on the adjoints of points that are glued to lights or, of glued samples, to surfaces; derivatives go to
    // these slots.
    void sweep_glued(GradientSink<F> &sink, const SlotColumns<S> &slots) {
        for (uint32_t i = 0; i < glued_.n; i += W) {
            Entries<F> from(i);
            M there = mask<F>(lane_index<F>() < U(glued_.n - i));
            SurfacePoint<F> at = from(glued_.at);
            at.shape = select(mask<U>(there), at.shape, U(0u));
            M active = sink.wants_shape(at.shape, there);
            sink.begin();
            if (any(active)) sweep_position(scene_, at, from(glued_.p), from(glued_.p_bar), active, sink);
            if (sink.forward) add_to_entries<F>(slots.radiance, from(glued_.slot), sink.derivative, active);
        }
        glued_.n = 0;
    }
    // ... those of the chosen vertices of paths.
    void sweep_paths(GradientSink<F> &sink, const SlotColumns<S> &slots) {
        auto nothing = [](const U &, const Vec3<F> &, const M &) {};
        sweep_places(paths_, slots, sink, true, nothing, [&](int level, uint32_t i, const U &slot, const M &there) {
            Gathered<F> from(slot, there);
            M chosen = there && mask<F>(from(anchors_.level) == U(uint32_t(level))) &&
                       mask<F>(from(anchors_.entry) == U(i) + lane_index<F>());
            return select(chosen, from(anchors_.p_bar), Vec3<F>{F(0), F(0), F(0)});
        });
    }
    // From the last level of the tape to the first; own(level, i, slot, there): the adjoint of a vertex's place.
    // Derivatives go to `slots`, adjoints of where rays began that are not the camera's to begin(slot, o_bar, active).
    template <class Begin, class Own>
    void sweep_places(PathTile<F> &tile, const SlotColumns<S> &slots, GradientSink<F> &sink, bool from_camera,
                      Begin &&begin, Own &&own) {
        Tape<S> &tape = tile.wavefront.tape;
        SweepContext<F> c{scene_,
                          path_call_.config,
                          slots,
                          tile.wavefront.needs(),
                          S(call_.film_width),
                          S(call_.film_height),
                          nullptr,
                          false,
                          from_camera};
        for (int l = tape.size() - 1; l >= 0; --l) {
            TapeLevel<S> &level = tape[l];
            const TapeColumns<S> *parents = level.parent_level >= 0 ? &tape[level.parent_level].columns : nullptr;
            for (const KindRange &range : level.ranges) {
                if (range.kind >= MissKind) continue;
                for (uint32_t i = range.begin; i < range.begin + range.count; i += W) {
                    M there = mask<F>(lane_index<F>() < U(range.begin + range.count - i));
                    U slot = select(mask<U>(there), load_uint<F>(level.columns.vertex.slot.at + i), U(0u));
                    Vec3<F> p_bar = own(l, i, slot, there);
                    Entries<F> from(i);
                    const auto &next = level.columns.next;
                    M active =
                        there &&
                        mask<F>(max_abs(p_bar) + max_abs(from(next.ray_o_bar)) + max_abs(from(next.ray_d_bar)) > F(0));
                    if (!any(active)) continue;
                    Vec3<F> o_bar =
                        sweep_place(c, level.columns, parents, range.kind, level.scatters, i, p_bar, active, sink);
                    if (!parents && !from_camera) begin(slot, o_bar, active);
                }
            }
        }
        // the next sweep finds none of this
        for (int l = 0; l < tape.size(); ++l)
            for (const KindRange &range : tape[l].ranges)
                for (S *p : {tape[l].columns.next.ray_o_bar.x, tape[l].columns.next.ray_o_bar.y,
                             tape[l].columns.next.ray_o_bar.z, tape[l].columns.next.ray_d_bar.x,
                             tape[l].columns.next.ray_d_bar.y, tape[l].columns.next.ray_d_bar.z})
                    std::fill_n(p + range.begin, range.count, S(0));
    }

    static void put(const VectorColumn<S> &column, const U &slot, const Vec3<F> &v, const M &active) {
        scatter_lanes<F>(column.x, slot, v.x, active), scatter_lanes<F>(column.y, slot, v.y, active);
        scatter_lanes<F>(column.z, slot, v.z, active);
    }

    static void put(const RowColumns<S> &to, const U &slot, const Stokes<F> &row, const M &active) {
        const SpectrumColumn<S> columns[] = {to.i, to.q, to.u, to.v};
        for (int k = 0; k < 4; ++k)
            for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(columns[k][c], slot, row.at[k][c], active);
        put(to.axis, slot, row.axis, active);
    }

private:
    Arena arena_, glued_arena_, row_arena_;
};

}  // namespace tr
