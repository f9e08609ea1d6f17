// A medium that light bends in, while rendering.
#pragma once

#include "../scene.h"
#include "../shape/surface.h"
#include "bend_light.h"
#include "medium.h"

namespace tr {

template <class S>
struct BendMedium {
    static constexpr int BlockBits = 2;  // blocks of 4 voxels along a side
    BendField<S> field;
    S constant;  // of Phi, which the field's values do not have
    bool quadratic;
    int32_t slot;  // of the values among the scene's tensors
    S to_world[12], to_voxels[12];
    S step;  // of the parameter t, see bend.h
    S ext_ior;
    int32_t ext_ior_offset, to_world_offset;  // in the block of small parameters
    BendLight<S> light;
    bool varies;  // what light loses depends on more than the length of its way
    S reach;      // steps that are longer in any coordinate ask for surfaces everywhere
    int32_t max_steps;
    // Where surfaces may be that are not further away than a step: a bit a block, and how many blocks there are.
    const uint32_t *blocks;
    int32_t n_blocks[3];
};

// At rest at a point of the world.
template <class F, class S>
TR_INLINE BendState<F> state_at(const BendMedium<S> &medium, const Vec3<F> &p) {
    BendState<F> s;
    start_bent(s, transform_point(medium.to_voxels, p), {F(0), F(0), F(0)}, position_bits<F>(medium.field));
    return s;
}

template <class F, class S>
TR_INLINE MaskOf<F> surface_near(const BendMedium<S> &medium, const BendState<F> &s, int bits,
                                 const MaskOf<F> &active) {
    using U = UIntOf<F>;
    const int32_t *n = medium.n_blocks;
    auto block = [&](int k) { return U(IntOf<F>(s.q[k] >> (bits + BendMedium<S>::BlockBits))); };
    const U index = (block(2) * uint32_t(n[1]) + block(1)) * uint32_t(n[0]) + block(0);
    const U word = gather<U>(medium.blocks, index >> 5, mask<U>(active));
    return active && mask<F>(((word >> (index & 31u)) & 1u) != 0u);
}

// The medium inside of shapes, -1 where there is none.
template <class F>
TR_INLINE IntOf<F> inner_medium(const SceneOf<F> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    IntOf<F> side[1];
    gather_few_rows<F>(&scene.shapes->interior, at.shape * 16u, active, side);
    return side[0];
}

template <class F>
TR_INLINE MaskOf<F> bends(const SceneOf<F> &scene, const IntOf<F> &medium, const MaskOf<F> &active) {
    MaskOf<F> r(false);
    for (int32_t m = 0; m < scene.n_media; ++m)
        if (scene.media[m].flags & Bends) r = r || (active && mask<F>(medium == m));
    return r;
}

// Of these media those that emit.
template <class F>
TR_INLINE MaskOf<F> emits(const SceneOf<F> &scene, const IntOf<F> &medium, const MaskOf<F> &active) {
    MaskOf<F> r(false);
    for (int32_t m = 0; m < scene.n_media; ++m)
        if ((scene.media[m].flags & Bends) && scene.media[m].emission >= 0) r = r || (active && mask<F>(medium == m));
    return r;
}

// Calls visit(medium, lanes) for the media that bend.
template <class F, class Visit>
TR_INLINE void for_each_bend(const SceneOf<F> &scene, const IntOf<F> &medium, const MaskOf<F> &active, Visit &&visit) {
    for (int32_t m = 0; m < scene.n_media; ++m) {
        if (!(scene.media[m].flags & Bends)) continue;
        const MaskOf<F> lanes = active && mask<F>(medium == m);
        if (any(lanes)) visit(scene.bends[m], lanes);
    }
}

// What an optical depth leaves of light.
template <class F>
TR_INLINE Spectrum<F> transmittance(const Spectrum<F> &depth) {
    Spectrum<F> r;
    for (int c = 0; c < SpectrumSize; ++c) r[c] = exp(-depth[c]);
    return r;
}

// The index of refraction at points, and the gradient of Phi there, in voxels.
template <class F>
struct LocalIndex {
    F n;
    Vec3<F> slope;
};
template <class F>
TR_LARGE LocalIndex<F> local_index(const BendMedium<ScalarOf<F>> &medium, const Vec3<F> &p, const MaskOf<F> &active);

// Of surface points the index on the inner side of boundaries of such media over that outside: what refracts there.
template <class F>
TR_LARGE F boundary_eta(const SceneOf<F> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active);

}  // namespace tr
