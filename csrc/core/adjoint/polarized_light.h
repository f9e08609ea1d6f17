// Lights that are polarised: the shares Q, U and V of their intensity, which their field `stokes` has, are those on an
// axis that is theirs: dp/du of shapes that emit, else the x axis of their frame, or of the world. What of it lies
// across the ray counts.
#pragma once

#include "../emitter/emitter.h"
#include "../shape/partials.h"
#include "gradient_sink.h"
#include "stokes.h"

namespace tr {

template <class F>
struct PolarizedLight {
    Vec3<F> shares{F(0), F(0), F(0)};  // Q, U, V over I
    Vec3<F> axis{F(0), F(0), F(0)};    // 0 of what is unpolarised

    TR_INLINE PolarizedLight(const SceneOf<F> &scene, const EmitterPoint<F> &point, const MaskOf<F> &active) {
        if (scene.polarized_lights && any(active)) load(scene, point, active);
    }

    // What of this radiance leaves.
    TR_INLINE Stokes<F> of(const Spectrum<F> &radiance) const {
        return {{radiance, radiance * shares.x, radiance * shares.y, radiance * shares.z}, axis};
    }

    // The number that the row of what leaves along k makes with it, for a radiance of 1.
    TR_INLINE Spectrum<F> contracted(const Stokes<F> &row, const Vec3<F> &k) const {
        const Stokes<F> here = turned_row(row, axis, k);
        return here.at[0] + here.at[1] * shares.x + here.at[2] * shares.y + here.at[3] * shares.z;
    }

    // The derivative of that number for this radiance, by shares and axis. Adds to the adjoint of k; returns that of
    // dp/du of shapes.
    TR_NOINLINE Vec3<F> sweep(const SceneOf<F> &scene, const EmitterPoint<F> &point, const Vec3<F> &k,
                              const Stokes<F> &row, const Spectrum<F> &radiance, const GradientNeeds &needs,
                              const MaskOf<F> &active, Vec3<F> &k_bar, GradientSink<F> &sink) const {
        const Stokes<F> here = turned_row(row, axis, k);
        // the column turns against its axis
        const F angle_bar = -component_sum(by_angle(here, of(radiance)));
        const Vec3<F> m = axis - k * dot(axis, k);
        const F length2 = squared_norm(m);
        auto some = mask<F>(length2 > F(1e-12));
        const Vec3<F> m_bar = cross(k, m) * select(some, angle_bar / select(some, length2, F(1)), F(0));
        k_bar = k_bar - m_bar * dot(axis, k);
        Vec3<F> tangent_bar{F(0), F(0), F(0)};
        const IntOf<F> kind = emitter_kind<F>(scene, point.emitter, active);
        for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
            if (emitter.stokes < 0) return;
            if (needs.emitter) {
                const IntOf<F> offset = emitter_field<F>(scene, emitter.stokes, point.emitter, lanes);
                for (int i = 0; i < 3; ++i) sink.number(offset + i, here.at[i + 1] * radiance, lanes);
            }
            if (!needs.geometry) return;
            if (emitter.is(IsOnShape)) tangent_bar = select(lanes, m_bar, tangent_bar);
            if (emitter.to_world < 0) return;
            const IntOf<F> offset = emitter_field<F>(scene, emitter.to_world, point.emitter, lanes);
            sink.scalar(offset, m_bar.x, lanes), sink.scalar(offset + 4, m_bar.y, lanes);
            sink.scalar(offset + 8, m_bar.z, lanes);
        });
        return tangent_bar;
    }

private:
    TR_NOINLINE void load(const SceneOf<F> &scene, const EmitterPoint<F> &point, const MaskOf<F> &active) {
        const IntOf<F> kind = emitter_kind<F>(scene, point.emitter, active);
        for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
            if (emitter.stokes < 0) return;
            const auto numbers = [&](int field, int stride) {
                const UIntOf<F> offset(emitter_field<F>(scene, field, point.emitter, lanes));
                const auto *from = scene.values.constants;
                return Vec3<F>{gather<F>(from, offset, lanes), gather<F>(from, offset + uint32_t(stride), lanes),
                               gather<F>(from, offset + uint32_t(2 * stride), lanes)};
            };
            shares = select(lanes, numbers(emitter.stokes, 1), shares);
            Vec3<F> along{F(1), F(0), F(0)};
            if (emitter.is(IsOnShape))
                along = surface_tangent(scene, point.at, lanes);
            else if (emitter.to_world >= 0)
                along = numbers(emitter.to_world, 4);
            axis = select(lanes, along, axis);
        });
    }
};

}  // namespace tr
