// Vertices of paths, one a sample, from which outlines, or the edges of shadows, are looked at.
#pragma once

#include "../adjoint/revisit.h"
#include "outline_tree.h"

namespace tr {

// By slot: the vertex that was chosen, how it scatters, and the adjoint of its place.
// clang-format off
#define TR_ANCHOR_COLUMNS(X) \
    X(Index, level) X(Index, entry) X(Vector, n) X(Vector, axis) X(Vector, ng) X(Number, k) X(Number, share) \
    X(Vector, p_bar)
// A direction from such a vertex, f and the density there.
#define TR_TOWARDS_COLUMNS(X) X(Vector, d) X(Spectrum, f) X(Number, pdf)
// clang-format on
template <class S>
struct AnchorColumns {
    TR_COLUMNS(TR_ANCHOR_COLUMNS)
};
template <class S>
struct TowardsColumns {
    TR_COLUMNS(TR_TOWARDS_COLUMNS)
};

constexpr uint32_t NoVertex = 0xFFFFFFFFu;

template <class F, class S>
TR_INLINE void scatter_vector(const VectorColumn<S> &column, const UIntOf<F> &slot, const Vec3<F> &v,
                              const MaskOf<F> &active) {
    scatter_lanes<F>(column.x, slot, v.x, active), scatter_lanes<F>(column.y, slot, v.y, active);
    scatter_lanes<F>(column.z, slot, v.z, active);
}

// What vertex e of a level brings to the film, but for `factor`; 0 where that is nobody's guess.
template <class S>
TR_HD double vertex_weight(const VertexColumns<S> &v, uint32_t e, int values, double factor) {
    double weight = 0;
    for (int c = 0; c < values; ++c) weight += std::fabs(double(v.beta[c][e]));
    weight *= factor;
    return weight > 0 && weight - weight == 0 ? weight : 0;
}

// Of chosen vertices in entries i on of a level.
template <class F, class S = ScalarOf<F>>
TR_HD void find_lobes(const SceneView<S> &scene, const Wavelengths<F> &waves, int kind, const TapeColumns<S> &columns,
                      uint32_t i, const UIntOf<F> &slot, const MaskOf<F> &active, const AnchorColumns<S> &to) {
    const ScatteringLobe<F> lobe = scattering_lobe<F>(scene, waves, kind, columns, i, active);
    scatter_vector<F>(to.n, slot, lobe.n, active), scatter_vector<F>(to.axis, slot, lobe.axis, active);
    scatter_lanes<F>(to.k.at, slot, lobe.k, active), scatter_lanes<F>(to.share.at, slot, lobe.share, active);
}
template <class F, class S = ScalarOf<F>>
TR_HD void find_normals(const SceneView<S> &scene, const TapeColumns<S> &columns, uint32_t i, const UIntOf<F> &slot,
                        const MaskOf<F> &active, const AnchorColumns<S> &to) {
    scatter_vector<F>(to.ng, slot, geometric_normal<F>(scene, columns, i, active), active);
}
// f and the density, into entries `at`, of the directions there.
template <class F, class S = ScalarOf<F>>
TR_HD void scatter_chosen(const SceneView<S> &scene, const Wavelengths<F> &waves, int kind,
                          const TapeColumns<S> &columns, uint32_t i, const UIntOf<F> &at, const MaskOf<F> &active,
                          const GradientNeeds &needs, const TowardsColumns<S> &to) {
    const Vec3<F> d = Gathered<F>(at, active)(to.d);
    const BsdfValue<F> value = scatter_towards<F>(scene, waves, kind, columns, i, d, needs, active);
    for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(to.f[c], at, value.f[c], active);
    scatter_lanes<F>(to.pdf.at, at, value.pdf, active);
}

// A chosen vertex on a tape: `levels` are indexed, and have `columns` and `parent_level`.
template <class S, class Levels>
struct TapeVertex {
    Levels &levels;
    uint32_t level, entry;

    TR_HD const TapeColumns<S> &columns() const { return levels[int(level)].columns; }
    TR_HD Vec3<S> place() const { return columns().arrival.p.get(entry); }
    TR_HD SurfacePoint<S> point() const { return columns().vertex.at.get(entry); }
    // Whether it moves: with its shape, or because one before it does.
    TR_HD bool moves(const uint8_t *by_shape) const {
        uint32_t e = entry;
        for (int l = int(level); l >= 0; l = levels[l].parent_level) {
            const auto &vertex = levels[l].columns.vertex;
            if (by_shape[vertex.at.shape[e]]) return true;
            e = vertex.parent[e];
        }
        return false;
    }
    // Where it looks for outlines from. `still`: see OutlineSamples.
    TR_HD OutlineAnchor anchor(const AnchorColumns<S> &at, uint32_t slot, float still) const {
        const auto single = [](const Vec3<S> &v) { return Vec3<float>{float(v.x), float(v.y), float(v.z)}; };
        OutlineAnchor a{};
        a.p = single(place()), a.n = single(at.n.get(slot)), a.axis = single(at.axis.get(slot));
        // on the side that it is seen from, which that of an interpolated normal may not be
        const Vec3<S> ng = at.ng.get(slot), arriving = columns().arrival.d.get(entry);
        a.ng = single(dot(ng, arriving) > 0 ? -ng : ng);
        a.k = float(at.k[slot]), a.share = float(at.share[slot]);
        a.parallel = false, a.own = int32_t(point().shape), a.still = still;
        return a;
    }
};

// How many outlines each of n vertices looks past, in proportion to their totals, which are not above 8 times their
// mean; `inverse` is divided by the means of these numbers. u is a number in [0, 1).
TR_HD inline void share_out(const double *totals, uint32_t n, double u, double *inverse, uint32_t *copies) {
    double sum = 0, count = 0;
    for (uint32_t k = 0; k < n; ++k) {
        copies[k] = 0;
        if (totals[k] > 0) sum += totals[k], ++count;
    }
    if (!(count > 0) || !(sum - sum == 0)) return;
    const double most = 8 * sum / count, number = std::min(double(n), 2 * count);
    sum = 0;
    for (uint32_t k = 0; k < n; ++k) sum += std::min(totals[k], most);
    double upto = 0;
    for (uint32_t k = 0; k < n; ++k) {
        const double mean = number * std::min(totals[k], most) / sum, from = std::floor(upto + u);
        upto += mean;
        copies[k] = uint32_t(std::floor(upto + u) - from);
        if (mean > 0) inverse[k] /= mean;
    }
}

}  // namespace tr
