#include "medium_motion.h"

namespace tr {

template <class F>
TR_LARGE PartSweep<F>::PartSweep(const SceneOf<F> &scene, const MediumInfo &medium, const Vec3<F> &o, const Vec3<F> &d,
                                 const MediumPart<F> &part, const M &active)
    : scene_(scene), medium_(medium), o_(o), d_(d), active_(active), at_{part.from, part.to}, t_{part.t0, part.t1} {
    const Vec3<F> zero{F(0), F(0), F(0)};
    end_[0] = end_[1] = rigid_ = face_[0] = face_[1] = zero;
    for (int k = 0; k < 2; ++k) {
        on_surface_[k] = active && !mask<F>(at_[k].shape == UIntOf<F>(NoHit));
        on_face_[k] = M(false);
    }
    if (medium.flags & IsGrid) {
        // distances at which the line enters and leaves the cube, and through which faces
        const S *to_local = scene.volume_to_local + 12 * medium.extinction;
        Vec3<F> from = transform_point(to_local, o), along = transform_vector(to_local, d);
        const F *origin[3] = {&from.x, &from.y, &from.z}, *speed[3] = {&along.x, &along.y, &along.z};
        for (int k = 0; k < 3; ++k) {
            auto flat = mask<F>(abs(*speed[k]) < F(S(1e-18)));
            F inverse = F(1) / select(flat, F(1), *speed[k]);
            F a = -*origin[k] * inverse, b = (F(1) - *origin[k]) * inverse;
            Vec3<F> normal = transform_normal(to_local, Vec3<F>{F(S(k == 0)), F(S(k == 1)), F(S(k == 2))});
            // a boundary at the same place counts as the end
            F slack = F(S(1e-5)) * max(abs(a), abs(b));
            const F entered = min(a, b), left = max(a, b);
            auto enters = active && !flat && mask<F>(entered > t_[0] + slack);
            auto leaves = active && !flat && mask<F>(left < t_[1] - slack);
            t_[0] = select(enters, entered, t_[0]), t_[1] = select(leaves, left, t_[1]);
            face_[0] = select(enters, normal, face_[0]), face_[1] = select(leaves, normal, face_[1]);
            on_face_[0] = on_face_[0] || enters, on_face_[1] = on_face_[1] || leaves;
        }
        for (int k = 0; k < 2; ++k) on_surface_[k] = on_surface_[k] && !on_face_[k];
    }
    F length = t_[1] - t_[0];
    ended_ = active && mask<F>(length < F(S(1e30))) && mask<F>(length > F(0));
    inverse_length_ = F(1) / select(ended_, length, F(1));
}

template <class F>
TR_LARGE void PartSweep<F>::add_lookup(int32_t volume, const F &t, const Spectrum<F> &g, const F &stretch,
                                       const M &active, GradientSink<F> &sink) {
    add(t, sweep_volume_place(scene_, volume, o_ + d_ * t, g, active, sink), select(active, stretch, F(0)));
}

template <class F>
TR_LARGE void PartSweep<F>::hand_to(LineAdjoint<F> &line, GradientSink<F> &sink) const {
    const Vec3<F> zero{F(0), F(0), F(0)};
    line.d = select(active_, line.d + rigid_, line.d);
    for (int k = 0; k < 2; ++k) {
        const Vec3<F> &g = end_[k];
        RayAdjoint<F> r{g, g * t_[k]};  // a place on the line that moves with it
        if (any(on_surface_[k])) {
            Arrival<F> in{on_surface_[k], d_, t_[k], d_ * t_[k], zero, F(0)};
            HitAdjoint<F> hit;
            hit.p = g;
            RayAdjoint<F> slid = sweep_surface(scene_, at_[k], o_ + d_ * t_[k], in, hit, on_surface_[k], sink);
            r.o = select(on_surface_[k], slid.o, r.o), r.d = select(on_surface_[k], slid.d, r.d);
        }
        if (any(on_face_[k])) {
            F cosine = dot(face_[k], d_);
            Vec3<F> with_face = face_[k] * (dot(g, d_) / select(on_face_[k], cosine, F(1)));
            r.o = select(on_face_[k], g - with_face, r.o);
            r.d = select(on_face_[k], (g - with_face) * t_[k], r.d);
            sweep_volume_matrix(scene_.volumes[medium_.extinction],
                                to_volume(scene_, medium_.extinction, o_ + d_ * t_[k]), with_face, on_face_[k], sink);
        }
        auto open = active_ && !on_surface_[k] && !on_face_[k];
        if (k == 1) {
            line.end = select(open, line.end + g, line.end);
            r.o = select(open, zero, r.o), r.d = select(open, zero, r.d);
        }
        line.o = select(active_, line.o + r.o, line.o);
        line.d = select(active_, line.d + r.d, line.d);
    }
}

#define TR_INSTANTIATE(F, S) template class PartSweep<F>;
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
