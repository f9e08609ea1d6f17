// The derivative of what lies along a line through a medium, where the line or the medium's boundaries move.
//
// The line runs from its origin o along d; the medium is on the part of it between t0 and t1. Points of that part are
// parametrised by their share s of it, which rests: x(s) = (1 - s) x(t0) + s x(t1). What is integrated over the part is
// then a function of s in an interval that rests, too, and of the motion of both ends: fields are looked up elsewhere,
// and lengths, with them optical depths, are stretched by the rate of log (t1 - t0). Nothing is left at the ends where
// the medium begins and stops, so that the derivative has no term of its own there.
//
// Ends slide along the line with the surfaces that bound the medium, or with the faces of a grid beyond which there is
// nothing. A part without an end moves with its beginning as if it were rigid.
#pragma once

#include "../medium/medium.h"
#include "../state/queues.h"
#include "surface.h"

namespace tr {

// Where a part begins and ends, as distances from the line's origin; no point, `shape` being NoHit: it begins on
// the line, whose place t0 moves with it, and ends with the line, which is endless if t1 is infinite.
template <class F>
struct MediumPart {
    SurfacePoint<F> from, to;
    F t0, t1;
};

// The parts of a packet of lines in one medium. Adjoints of points are added up, then handed on.
template <class F>
class PartSweep {
    using S = ScalarOf<F>;
    using M = MaskOf<F>;

public:
    TR_LARGE PartSweep(const SceneOf<F> &scene, const MediumInfo &medium, const Vec3<F> &o, const Vec3<F> &d,
                       const MediumPart<F> &part, const M &active);

    // A point t from the origin, whose place has the adjoint p_bar; `stretch` is that of the logarithm of the part's
    // length.
    TR_INLINE void add(const F &t, const Vec3<F> &p_bar, const F &stretch) {
        F share = select(ended_, max(F(0), min(F(1), (t - t_[0]) * inverse_length_)), F(0));
        Vec3<F> along = d_ * select(ended_, stretch * inverse_length_, F(0));
        end_[0] = end_[0] + p_bar * (F(1) - share) - along;
        end_[1] = end_[1] + p_bar * share + along;
        rigid_ = rigid_ + p_bar * select(ended_, F(0), t - t_[0]);
    }
    // A look-up of a field of the medium there, `g` being the adjoint of its value and `stretch` as above.
    TR_LARGE void add_lookup(int32_t volume, const F &t, const Spectrum<F> &g, const F &stretch, const M &active,
                             GradientSink<F> &sink);

    TR_LARGE void hand_to(LineAdjoint<F> &line, GradientSink<F> &sink) const;

private:
    const SceneOf<F> &scene_;
    const MediumInfo &medium_;
    Vec3<F> o_, d_;
    M active_, ended_;
    M on_face_[2], on_surface_[2];
    SurfacePoint<F> at_[2];
    Vec3<F> face_[2];  // normals of the grid's faces
    F t_[2], inverse_length_;
    Vec3<F> end_[2], rigid_;
};

}  // namespace tr
