// The paths of samples of outlines, and the vertices of them from which light is looked up, one a sample.
//
// Whatever belongs to one sample has the same wavelengths (share_wavelengths). What polarised light does before it
// reaches the chosen vertex of a path is there as rows, one a part, see boundary_tile.h.
#pragma once

#include <cmath>

#include "boundary_columns.h"
#include "core/adjoint/revisit.h"
#include "path_tile.h"

namespace tr {

template <class F>
class BoundaryPaths {
protected:
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    using V = Vec3<S>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

    const RenderCall<S> &call_;
    const BoundaryCall<S> &boundary_;
    const SceneView<S> &scene_;

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
    PathTile<F> paths_;
    AnchorColumns<S> anchors_;
    RowColumns<S> leaving_[4], arriving_[4];  // at chosen vertices, for what leaves these, and for what arrives from d

public:
    static constexpr size_t Capacity = 1024;

    BoundaryPaths(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : call_(call),
          boundary_(boundary),
          scene_(*call.scene),
          path_call_(without_lights(call, boundary.part)),
          paths_(path_call_, Capacity, &derivative) {
        arena_.allocate(Capacity + 2 * W, anchors_);
        if (polarized())
            row_arena_.allocate(Capacity + 2 * W, leaving_[0], leaving_[1], leaving_[2], leaving_[3], arriving_[0],
                                arriving_[1], arriving_[2], arriving_[3]);
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
    void trace_paths(uint32_t n, const Stop &stop) {
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
    uint64_t tree_seed(uint32_t slot) const {
        const RandomBits4<S> r = bits(slot);
        return uint64_t(r.bits[2]) << 32 | r.bits[3];
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

    // One vertex of each path, in proportion to its throughput times factor(its place, slot); `inverse` becomes one
    // over the probability, `total` what all of its vertices have.
    template <class Factor>
    void choose_vertices(uint32_t n, const std::vector<double> &u, std::vector<double> &inverse,
                         std::vector<double> &total, Factor &&factor) {
        Tape<S> &tape = paths_.wavefront.tape;
        const size_t values = size_t(call_.values);
        std::vector<double> before(n, 0);
        total.assign(n, 0);
        auto each = [&](auto &&visit) {
            for_smooth(paths_, [&](uint32_t l, const KindRange &range) {
                const TapeColumns<S> &columns = tape[int(l)].columns;
                const auto &v = columns.vertex;
                for (uint32_t e = range.begin; e < range.begin + range.count; ++e) {
                    double weight = 0;
                    for (size_t c = 0; c < values; ++c) weight += std::fabs(double(v.beta[int(c)][e]));
                    weight *= factor(columns.arrival.p.get(e), v.slot[e]);
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
                put(arriving_[part], slot,
                    row_towards<F>(scene_, waves, kind, columns, i, d, leaving, paths_.wavefront.needs(), active),
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
    SurfacePoint<S> point_of(uint32_t slot) {
        const auto &at = level_of(slot).columns.vertex.at;
        const uint32_t e = anchors_.entry[slot];
        return {at.shape[e], at.primitive[e], at.b1[e], at.b2[e]};
    }
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
    OutlineAnchor anchor(uint32_t slot) {
        OutlineAnchor a{};
        a.p = single(place_of(slot)), a.n = single(anchors_.n.get(slot)), a.axis = single(anchors_.axis.get(slot));
        // on the side that it is seen from, which that of an interpolated normal may not be
        const V ng = anchors_.ng.get(slot), arriving = level_of(slot).columns.arrival.d.get(anchors_.entry[slot]);
        a.ng = single(dot(ng, arriving) > 0 ? -ng : ng);
        a.k = float(anchors_.k[slot]), a.share = float(anchors_.share[slot]);
        a.parallel = false, a.own = int32_t(point_of(slot).shape), a.still = still(vertex_moves(slot));
        return a;
    }

    // ------------------------------------------------------------------------------------------------- the camera
    bool is_distant() const { return sensor().kind == kind_of_model<Distant>(Sensors{}); }
    // Where the camera sees what a slot stands for, `place`; that is kept of a lens, too, if it was not drawn.
    void keep_place(const SlotColumns<S> &slots, uint32_t slot, const CameraSample<S> &place) {
        slots.film_x[slot] = place.x, slots.film_y[slot] = place.y;
        if (slots.lens.x) slots.lens.x[slot] = place.lens_x, slots.lens.y[slot] = place.lens_y;
    }
    // Of slots whose places are kept, see there.
    void keep_lens(SlotColumns<S> &slots) {
        if (!is_distant()) return;
        lens_arena_.allocate(Capacity + 2 * W, lens_);
        slots.lens = lens_.lens;
        for (uint32_t k = 0; k < Capacity + 2 * W; ++k) lens_.lens.x[k] = lens_.lens.y[k] = 0;
    }
    CameraSample<S> lens_of(uint32_t slot) const {
        CameraSample<S> sample{S(0), S(0)};
        const auto &slots = paths_.slots;
        if (slots.lens.x) return {S(0), S(0), slots.lens.x[slot], slots.lens.y[slot]};
        if (uses_lens(sensor()))
            sample.choose_lens(lens_numbers<S>(path_call_.config, slots.pixel[slot], slots.sample[slot]));
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
        if (is_distant()) {
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
    Arena arena_, row_arena_, lens_arena_;
    LensColumns<S> lens_;
};

}  // namespace tr
