// The local frame of a vertex, and the adjoint of its normal when directions are taken to it and from it: when the
// normal moves by dn, the frame turns with it, ds = -(s.dn) n, dt = -(t.dn) n. How it turns about n besides, by dphi,
// ds = dphi t, dt = -dphi s, matters where the model follows the tangent: as s = a / |a|, a = u - (n.u) n, u being
// dp/du, dphi = t.ds = t.(du - (n.u) dn) / |a|.
#pragma once

#include "../shape/partials.h"
#include "vertex.h"

namespace tr {

// Its z is that of the model, which may be mirrored.
template <class F>
TR_INLINE Frame<F> model_frame(const SceneOf<F> &scene, const VertexRecord<F> &v) {
    Frame<F> frame = vertex_frame(scene, v);
    frame.n = frame.n * v.mirror;
    return frame;
}

template <class F>
struct VertexFrame {
    Frame<F> frame;
    bool oriented;
    Vec3<F> n_bar{F(0), F(0), F(0)};
    F phi_bar{0};

    TR_INLINE VertexFrame(const SceneOf<F> &scene, const VertexRecord<F> &v, bool oriented_)
        : frame(model_frame(scene, v)), oriented(oriented_ && scene.follows_tangent) {}
    // the adjoint of a world direction from that of its local coordinates
    TR_INLINE Vec3<F> into(const Vec3<F> &local, const Vec3<F> &local_bar) {
        n_bar = n_bar + frame.to_world(local) * local_bar.z - frame.s * (local_bar.x * local.z) -
                frame.t * (local_bar.y * local.z);
        if (oriented) phi_bar = phi_bar + (local_bar.x * local.y - local_bar.y * local.x);
        return frame.to_world(local_bar);
    }
    // the adjoint of local coordinates from that of the world direction they give
    TR_INLINE Vec3<F> out_of(const Vec3<F> &local, const Vec3<F> &world_bar) {
        const Vec3<F> local_bar = frame.to_local(world_bar);
        const F along = local_bar.z;
        n_bar = n_bar + world_bar * local.z - frame.s * (local.x * along) - frame.t * (local.y * along);
        if (oriented) phi_bar = phi_bar + (local.x * local_bar.y - local.y * local_bar.x);
        return local_bar;
    }
    // What the surface gets of all that.
    TR_INLINE void hand_to(HitAdjoint<F> &hit, const SceneOf<F> &scene, const VertexRecord<F> &v,
                           const MaskOf<F> &active) const {
        hit.n = hit.n + n_bar * v.mirror;
        if (!oriented) return;
        TangentPart<F> part(v.normal, surface_tangent(scene, v.at, active));
        Vec3<F> u_bar = frame.t * (phi_bar * part.inverse);
        hit.tangent = hit.tangent + u_bar;
        hit.n = hit.n - u_bar * part.up;
    }
};

}  // namespace tr
