// Where derivatives go. Reverse and forward mode are the same sweep with another sink: the reverse sink adds
// g * d(look-up)/d(parameter) to the parameter's gradient, the forward sink adds g * (look-up of the tangent) to the
// derivative of the pixel. Look-ups are linear in the parameters, so both walk the same footprints.
//
// Two kinds of adjoints come in: a colour, channel by channel, for what multiplies radiance; and a number, the sum over
// channels, for what moves points and directions. Numbers in forward mode need a sweep a channel, see `channel`.
#pragma once

#include "../emitter/emitter.h"

namespace tr {

// Derivatives of the vertex arrays of SceneView, in its order; null without meshes that have one. The matrices of
// curved shapes (12 numbers a shape) follow the block of small parameters, at `matrices`.
template <class T>
struct GeometryTables {
    T *positions = nullptr, *normals = nullptr, *texcoords = nullptr;
    uint32_t matrices = 0;
    const int32_t *wanted = nullptr;  // by shape
};

// The derivative of a volume's value at p with respect to its data; g is its adjoint.
template <class F, int C, class S, class Sink>
TR_INLINE void sweep_volume(const SceneView<S> &scene, int32_t volume, const Vec3<F> &p, const Color<F, C> &g,
                            const MaskOf<F> &active, Sink &sink) {
    const Record &record = scene.volumes[volume];
    if (record.kind == int32_t(VolumeKind::Constant)) {
        sink.color(scene, IntOf<F>(record.field[ConstantVolume::Value]), g, active);
        return;
    }
    int32_t slot = record.field[GridVolume::Data];
    sink.footprint(scene, slot, GridVolume::footprint(scene.values.tensors[slot], record, to_volume(scene, volume, p)),
                   g, active);
}

// A gradient of the radiance of one path with respect to one look-up, per channel.
template <class F, int C>
class ReverseSink {
    using S = ScalarOf<F>;

public:
    double *constants;  // gradient of the block of small parameters
    S *const *tensors;  // gradient of a large tensor by slot, null where it is not wanted
    GeometryTables<double> geometry;
    uint32_t non_finite = 0;

    TR_INLINE void begin() {}

    template <class Point>
    TR_INLINE void texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const Color<F, C> &g,
                           const MaskOf<F> &active) {
        auto usable = finite(g, active);
        if (!any(usable)) return;
        Scatter scatter{*this, scene, g};
        visit_texture<F>(scene, id, at, usable, scatter);
    }
    TR_INLINE void color(const SceneView<S> &, const IntOf<F> &offset, const Color<F, C> &g, const MaskOf<F> &active) {
        auto usable = finite(g, active);
        if constexpr (Lanes<F>::Width > 1) {
            if (!any(usable)) return;
            int32_t first = first_lane(offset, usable);
            if (!any(usable && mask<F>(offset != first))) {  // adding lane by lane would wait for every addition
                for (int c = 0; c < C; ++c) constants[first + c] += double(lane_sum(select(usable, g[c], F(0))));
                return;
            }
        }
        for (int i = 0; i < Lanes<F>::Width; ++i)
            if (lane_is_set(usable, i))
                for (int c = 0; c < C; ++c) constants[lane(offset, i) + c] += double(lane(g[c], i));
    }
    // of a texture's luminance, which all channels depend on
    template <class Point>
    TR_INLINE void scalar_texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const Color<F, C> &g,
                                  const MaskOf<F> &active) {
        texture(scene, id, at, luminance_adjoint(g), active);
    }
    // of a texture whose channels are the components of a vector, in scenes without colours too: by component
    template <class Point>
    TR_INLINE void vector_texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const Color<F, 3> &g,
                                  const MaskOf<F> &active) {
        if constexpr (C == 3) {
            texture(scene, id, at, g, active);
        } else {
            VectorScatter scatter{*this, scene, g};
            visit_texture<F>(scene, id, at, active, scatter);
        }
    }
    // a parameter that is one number for all channels
    TR_INLINE void number(const SceneView<S> &, const IntOf<F> &offset, const Color<F, C> &g, const MaskOf<F> &active) {
        F sum = g[0];
        for (int c = 1; c < C; ++c) sum = sum + g[c];
        scalar(offset, sum, active);
    }
    template <int N, int D>
    TR_INLINE void footprint(const SceneView<S> &scene, int32_t slot, const Footprint<F, N> &at, const Color<F, D> &g,
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
                for (int c = 0; c < D; ++c) texel[channels == 1 ? 0 : c] += w * lane(g[c], i);
            }
        }
    }
    // of the luminance of a footprint whose weights are multiplied by its adjoint
    template <int N>
    TR_INLINE void luminance_footprint(const SceneView<S> &scene, int32_t slot, const Footprint<F, N> &at,
                                       const MaskOf<F> &active) {
        Color<F, C> one = uniform_color<C>(F(0));
        one[0] = F(1);
        footprint(scene, slot, at, luminance_adjoint(one), active);
    }
    // of the sum of weight(i) times number i of a tensor of one channel, the same for all lanes
    template <class Weight>
    TR_INLINE void weighted_sum(const SceneView<S> &, int32_t slot, int32_t n, const Weight &weight,
                                const Color<F, C> &g, const MaskOf<F> &active) {
        S *gradient = tensors[slot];
        if (!gradient) return;
        auto usable = finite(g, active);
        S total(0);
        for (int c = 0; c < C; ++c) total += lane_sum(select(usable, g[c], F(0)));
        for (int32_t i = 0; i < n; ++i) gradient[i] += total * weight(i);
    }
    // of numbers in a tensor of one channel; the weights are multiplied by their adjoint already
    template <int N>
    TR_INLINE void taps(int32_t slot, const Footprint<F, N> &at, const MaskOf<F> &active) {
        S *gradient = tensors[slot];
        if (!gradient) return;
        Color<F, 1> sum{{F(0)}};
        for (int k = 0; k < N; ++k) sum[0] = sum[0] + abs(at.weight[k]);
        auto usable = active && is_finite(sum);
        non_finite += uint32_t(count(active) - count(usable));
        constexpr int W = Lanes<F>::Width;
        alignas(64) uint32_t texel[N][W];
        alignas(64) S weight[N][W];
        for (int k = 0; k < N; ++k) {
            store(&texel[k][0], at.texel[k]);
            store(&weight[k][0], at.weight[k]);
        }
        for (int i = 0; i < W; ++i) {
            if (!lane_is_set(usable, i)) continue;
            for (int k = 0; k < N; ++k) gradient[texel[k][i]] += weight[k][i];
        }
    }
    // of a number in the block of small parameters
    TR_INLINE void scalar(const IntOf<F> &offset, const F &g, const MaskOf<F> &active) {
        add(constants, UIntOf<F>(offset), g, active);
    }
    // of a number in one of the tables of `geometry`
    TR_INLINE void vertex(double *GeometryTables<double>::*table, const UIntOf<F> &index, const F &g,
                          const MaskOf<F> &active) {
        if (geometry.*table) add(geometry.*table, index, g, active);
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
    TR_INLINE void add(double *to, const UIntOf<F> &index, const F &g, const MaskOf<F> &active) {
        Color<F, 1> one{{g}};
        auto usable = active && is_finite(one);
        non_finite += uint32_t(count(active) - count(usable));
        for (int i = 0; i < Lanes<F>::Width; ++i)
            if (lane_is_set(usable, i)) to[lane(index, i)] += double(lane(g, i));
    }
    template <int D>
    TR_INLINE MaskOf<F> finite(const Color<F, D> &g, const MaskOf<F> &active) {
        auto usable = active && is_finite(g);
        non_finite += uint32_t(count(active) - count(usable));
        return usable;
    }

    struct Scatter {
        ReverseSink &sink;
        const SceneView<S> &scene;
        const Color<F, C> &g;
        TR_INLINE void constant(const IntOf<F> &offset, const MaskOf<F> &lanes) { sink.color(scene, offset, g, lanes); }
        TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &,
                              const MaskOf<F> &lanes) {
            sink.footprint(scene, record.field[Bitmap::Data], at, g, lanes);
        }
        TR_INLINE void attribute(const Record &record, const AttributeInfo &info, const Footprint<F, 3> &at,
                                 const MaskOf<F> &lanes) {
            F scale(scene.values.constants[record.field[MeshAttribute::Scale]]);
            sink.footprint(scene, info.tensor, at, g * scale, lanes);
        }
        TR_NOINLINE void volume(int32_t index, const Vec3<F> &p, const MaskOf<F> &lanes) {
            sweep_volume(scene, index, p, g, lanes, sink);
        }
    };
    struct VectorScatter {  // bitmaps alone have three channels in a scene without colours
        ReverseSink &sink;
        const SceneView<S> &scene;
        const Color<F, 3> &g;
        TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}
        TR_INLINE void attribute(const Record &, const AttributeInfo &, const Footprint<F, 3> &, const MaskOf<F> &) {}
        TR_INLINE void volume(int32_t, const Vec3<F> &, const MaskOf<F> &) {}
        TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &,
                              const MaskOf<F> &lanes) {
            sink.footprint(scene, record.field[Bitmap::Data], at, g, lanes);
        }
    };
};

template <class F, int C>
class ForwardSink {
    using S = ScalarOf<F>;

public:
    Values<S> tangent;
    GeometryTables<const S> geometry;
    int channel = 0;         // to which numbers belong
    Color<F, C> derivative;  // of the radiance of the paths in the lanes, since begin()
    uint32_t non_finite = 0;

    TR_INLINE void begin() { derivative = uniform_color<C>(F(0)); }

    template <class Point>
    TR_INLINE void texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const Color<F, C> &g,
                           const MaskOf<F> &active) {
        add(g * eval_texture<C>(scene, tangent, id, at, active), active);
    }
    template <class Point>
    TR_INLINE void scalar_texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const Color<F, C> &g,
                                  const MaskOf<F> &active) {
        add(g * luminance(eval_texture<C>(scene, tangent, id, at, active)), active);
    }
    template <class Point>
    TR_INLINE void vector_texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const Color<F, 3> &g,
                                  const MaskOf<F> &active) {
        Color<F, 3> product = g * eval_texture<3>(scene, tangent, id, at, active);
        add(product[0] + product[1] + product[2], active);
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
    template <int N>
    TR_INLINE void luminance_footprint(const SceneView<S> &, int32_t slot, const Footprint<F, N> &at,
                                       const MaskOf<F> &active) {
        if (tangent.tensors[slot].data) add(luminance(gather_footprint<C>(tangent.tensors[slot], at, active)), active);
    }
    template <class Weight>
    TR_INLINE void weighted_sum(const SceneView<S> &, int32_t slot, int32_t n, const Weight &weight,
                                const Color<F, C> &g, const MaskOf<F> &active) {
        const S *data = tangent.tensors[slot].data;
        if (!data) return;
        S sum(0);
        for (int32_t i = 0; i < n; ++i) sum += weight(i) * data[i];
        add(g * F(sum), active);
    }
    template <int N>
    TR_INLINE void taps(int32_t slot, const Footprint<F, N> &at, const MaskOf<F> &active) {
        const S *data = tangent.tensors[slot].data;
        if (!data) return;
        F sum(0);
        for (int k = 0; k < N; ++k) sum = fmadd(at.weight[k], gather<F>(data, at.texel[k], active), sum);
        add(sum, active);
    }
    TR_INLINE void scalar(const IntOf<F> &offset, const F &g, const MaskOf<F> &active) {
        add(g * gather<F>(tangent.constants, UIntOf<F>(offset), active), active);
    }
    TR_INLINE void vertex(const S *GeometryTables<const S>::*table, const UIntOf<F> &index, const F &g,
                          const MaskOf<F> &active) {
        if (geometry.*table) add(g * gather<F>(geometry.*table, index, active), active);
    }

private:
    TR_INLINE void add(const Color<F, C> &d, const MaskOf<F> &active) {
        auto usable = active && is_finite(d);
        non_finite += uint32_t(count(active) - count(usable));
        derivative = select(usable, derivative + d, derivative);
    }
    TR_INLINE void add(const F &d, const MaskOf<F> &active) {
        Color<F, C> one = uniform_color<C>(F(0));
        for (int c = 0; c < C; ++c)
            if (c == channel) one[c] = d;
        add(one, active);
    }
};

}  // namespace tr
