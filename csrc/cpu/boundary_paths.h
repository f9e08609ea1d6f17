// The paths of samples of outlines, and the vertices of them from which light is looked up, one a sample.
//
// Whatever belongs to one sample has the same wavelengths (share_wavelengths). What polarised light does before it
// reaches the chosen vertex of a path is there as rows, one a part, see boundary_tile.h.
#pragma once

#include <cmath>

#include "boundary_columns.h"
#include "core/boundary/anchors.h"
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

    const RenderCall<S> path_call_;
    const BoundaryView<S> view_;
    const OutlineSamples<S> samples_{scene_, path_call_.config, view_};
    PathTile<F> paths_;
    AnchorColumns<S> anchors_;
    TowardsColumns<S> towards_;               // by slot, from these
    RowColumns<S> leaving_[4], arriving_[4];  // at chosen vertices, for what leaves these, and for what arrives from d

public:
    static constexpr size_t Capacity = 1024;

    BoundaryPaths(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : call_(call),
          boundary_(boundary),
          scene_(*call.scene),
          path_call_(outline_path_call(call, boundary.part)),
          view_(view_of(call, boundary)),
          paths_(path_call_, Capacity, &derivative) {
        anchor_arena_.allocate(Capacity + 2 * W, anchors_), towards_arena_.allocate(Capacity + 2 * W, towards_);
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
        for (uint32_t k = 0; k < n; ++k) {
            const OutlineSample sample(boundary_.first + first + k);
            slots.pixel[k] = sample.low, slots.sample[k] = sample.high;
            const int64_t *cell = samples_.cell(sample);
            slots.column[k] = uint32_t(int32_t(cell[0])), slots.row[k] = uint32_t(int32_t(cell[1]));
        }
        std::fill_n(anchors_.level.at, n, NoVertex);
    }
    // Their paths from the camera.
    void trace_paths(uint32_t n, const Stop &stop) {
        paths_.start(n, false);
        const auto &slots = paths_.slots;
        for (uint32_t k = 0; k < n; ++k) {  // a place that was rounded up is in another pixel
            slots.film_x[k] = within_pixel(slots.film_x[k], slots.column[k]);
            slots.film_y[k] = within_pixel(slots.film_y[k], slots.row[k]);
        }
        paths_.run(true, stop, 0, false, boundary_.glued);
    }
    OutlineSample sample_of(uint32_t slot) const { return {paths_.slots.pixel[slot], paths_.slots.sample[slot]}; }
    RandomBits4<S> bits(uint32_t slot, uint32_t block) const { return samples_.bits(sample_of(slot), block); }
    S number(uint32_t slot, int which) const { return samples_.number(sample_of(slot), which); }

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
        std::vector<double> before(n, 0);
        total.assign(n, 0);
        auto each = [&](auto &&visit) {
            for_smooth(paths_, [&](uint32_t l, const KindRange &range) {
                const TapeColumns<S> &columns = tape[int(l)].columns;
                const auto &v = columns.vertex;
                for (uint32_t e = range.begin; e < range.begin + range.count; ++e) {
                    const double weight =
                        vertex_weight(v, e, call_.values, factor(columns.arrival.p.get(e), v.slot[e]));
                    if (weight > 0) visit(v.slot[e], l, e, weight);
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
            tr::find_lobes<F>(scene_, waves_of(slot, active), kind, columns, i, slot, active, anchors_);
        });
    }
    void find_normals() {
        for_chosen([&](const TapeColumns<S> &columns, int, uint32_t i, const U &slot, const M &active) {
            tr::find_normals<F>(scene_, columns, i, slot, active, anchors_);
        });
    }
    // f and pdf from d; of polarised light also the rows for what arrives from there.
    void scatter_chosen() {
        for_chosen([&](const TapeColumns<S> &columns, int kind, uint32_t i, const U &slot, const M &active) {
            const Wavelengths<F> waves = waves_of(slot, active);
            const GradientNeeds &needs = paths_.wavefront.needs();
            tr::scatter_chosen<F>(scene_, waves, kind, columns, i, slot, active, needs, towards_);
            Gathered<F> from(slot, active);
            const Vec3<F> d = from(towards_.d);
            for (int part = 0; polarized() && part < 4; ++part) {
                const RowColumns<S> &of = leaving_[part];
                const Stokes<F> leaving{{from(of.i), from(of.q), from(of.u), from(of.v)}, from(of.axis)};
                put(arriving_[part], slot, row_towards<F>(scene_, waves, kind, columns, i, d, leaving, needs, active),
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
    TapeVertex<S, Tape<S>> vertex(uint32_t slot) {
        return {paths_.wavefront.tape, anchors_.level[slot], anchors_.entry[slot]};
    }

    // ------------------------------------------------------------------------------------------------- the camera
    // Where the camera sees what a slot stands for, `place`; that is kept of a lens, too, if it was not drawn.
    void keep_place(const SlotColumns<S> &slots, uint32_t slot, const CameraSample<S> &place) {
        slots.film_x[slot] = place.x, slots.film_y[slot] = place.y;
        if (slots.lens.x) slots.lens.x[slot] = place.lens_x, slots.lens.y[slot] = place.lens_y;
    }
    // Of slots whose places are kept, see there.
    void keep_lens(SlotColumns<S> &slots) {
        if (!samples_.is_distant()) return;
        lens_arena_.allocate(Capacity + 2 * W, lens_);
        slots.lens = lens_.lens;
        for (uint32_t k = 0; k < Capacity + 2 * W; ++k) lens_.lens.x[k] = lens_.lens.y[k] = 0;
    }
    static void put(const RowColumns<S> &to, const U &slot, const Stokes<F> &row, const M &active) {
        const SpectrumColumn<S> columns[] = {to.i, to.q, to.u, to.v};
        for (int k = 0; k < 4; ++k)
            for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(columns[k][c], slot, row.at[k][c], active);
        scatter_vector<F>(to.axis, slot, row.axis, active);
    }

private:
    Arena anchor_arena_, towards_arena_, row_arena_, lens_arena_;
    LensColumns<S> lens_;
};

}  // namespace tr
