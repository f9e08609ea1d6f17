// Where derivatives go. Reverse and forward mode are the same sweep with another sink: the reverse sink adds
// g * d(look-up)/d(parameter) to the parameter's gradient, the forward sink adds g * (look-up of the tangent) to the
// derivative of the pixel. Look-ups are linear in the parameters, so both walk the same footprints.
#pragma once

#include "../emitter/emitter.h"

namespace tr {

// A gradient of the radiance of one path with respect to one look-up, per channel.
template <class F, int C>
class ReverseSink {
    using S = ScalarOf<F>;

public:
    double *constants;  // gradient of the block of small parameters
    S *const *tensors;  // gradient of a large tensor by slot, null where it is not wanted
    uint32_t non_finite = 0;

    TR_INLINE void begin() {}

    TR_INLINE void texture(const SceneView<S> &scene, const IntOf<F> &id, const SurfacePoint<F> &at,
                           const Color<F, C> &g, const MaskOf<F> &active) {
        auto usable = finite(g, active);
        if (!any(usable)) return;
        Scatter scatter{*this, scene, g};
        visit_texture<F>(scene, id, at, usable, scatter);
    }
    TR_INLINE void color(const SceneView<S> &, const IntOf<F> &offset, const Color<F, C> &g, const MaskOf<F> &active) {
        auto usable = finite(g, active);
        for (int i = 0; i < Lanes<F>::Width; ++i)
            if (lane_is_set(usable, i))
                for (int c = 0; c < C; ++c) constants[lane(offset, i) + c] += double(lane(g[c], i));
    }
    // a parameter that is one number for all channels; `component` of a vector
    TR_INLINE void number(const SceneView<S> &, const IntOf<F> &offset, const Color<F, C> &g, const MaskOf<F> &active) {
        auto usable = finite(g, active);
        F sum = g[0];
        for (int c = 1; c < C; ++c) sum = sum + g[c];
        for (int i = 0; i < Lanes<F>::Width; ++i)
            if (lane_is_set(usable, i)) constants[lane(offset, i)] += double(lane(sum, i));
    }
    template <int N>
    TR_INLINE void footprint(const SceneView<S> &scene, int32_t slot, const Footprint<F, N> &at, const Color<F, C> &g,
                             const MaskOf<F> &active) {
        S *gradient = tensors[slot];
        if (!gradient) return;
        auto usable = finite(g, active);
        int channels = scene.values.tensors[slot].shape[2];
        for (int i = 0; i < Lanes<F>::Width; ++i) {
            if (!lane_is_set(usable, i)) continue;
            for (int k = 0; k < N; ++k) {
                S w = lane(at.weight[k], i);
                S *texel = gradient + size_t(lane(at.texel[k], i)) * size_t(channels);
                for (int c = 0; c < C; ++c) texel[channels == 1 ? 0 : c] += w * lane(g[c], i);
            }
        }
    }

private:
    template <class M>
    TR_INLINE static bool lane_is_set(const M &m, int i) {
        if constexpr (std::is_same_v<M, bool>) return m;
#if TR_HAS_PACKETS
        else
            return m.entry(i);
#endif
    }
    TR_INLINE MaskOf<F> finite(const Color<F, C> &g, const MaskOf<F> &active) {
        auto usable = active && is_finite(g);
        non_finite += uint32_t(count(active) - count(usable));
        return usable;
    }

    struct Scatter {
        ReverseSink &sink;
        const SceneView<S> &scene;
        const Color<F, C> &g;
        TR_INLINE void constant(const IntOf<F> &offset, const MaskOf<F> &lanes) { sink.color(scene, offset, g, lanes); }
        template <int N>
        TR_INLINE void footprint(int32_t slot, const Footprint<F, N> &at, const MaskOf<F> &lanes) {
            sink.footprint(scene, slot, at, g, lanes);
        }
    };
};

template <class F, int C>
class ForwardSink {
    using S = ScalarOf<F>;

public:
    Values<S> tangent;
    Color<F, C> derivative;  // of the radiance of the paths in the lanes, since begin()
    uint32_t non_finite = 0;

    TR_INLINE void begin() { derivative = uniform_color<C>(F(0)); }

    TR_INLINE void texture(const SceneView<S> &scene, const IntOf<F> &id, const SurfacePoint<F> &at,
                           const Color<F, C> &g, const MaskOf<F> &active) {
        add(g * eval_texture<C>(scene, tangent, id, at, active), active);
    }
    TR_INLINE void color(const SceneView<S> &, const IntOf<F> &offset, const Color<F, C> &g, const MaskOf<F> &active) {
        add(g * constant_color<C, F>(tangent, offset, active), active);
    }
    TR_INLINE void number(const SceneView<S> &, const IntOf<F> &offset, const Color<F, C> &g, const MaskOf<F> &active) {
        add(g * gather<F>(tangent.constants, UIntOf<F>(offset), active), active);
    }
    template <int N>
    TR_INLINE void footprint(const SceneView<S> &, int32_t slot, const Footprint<F, N> &at, const Color<F, C> &g,
                             const MaskOf<F> &active) {
        if (tangent.tensors[slot].data) add(g * gather_footprint<C>(tangent.tensors[slot], at, active), active);
    }

private:
    TR_INLINE void add(const Color<F, C> &d, const MaskOf<F> &active) {
        auto usable = active && is_finite(d);
        non_finite += uint32_t(count(active) - count(usable));
        derivative = select(usable, derivative + d, derivative);
    }
};

}  // namespace tr
