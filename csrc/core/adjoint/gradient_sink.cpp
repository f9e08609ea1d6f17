#include "gradient_sink.h"

namespace tr {

// ----------------------------------------------------------------------------------------------------------- shared
template <class F>
TR_INLINE MaskOf<F> GradientSink<F>::count_finite(const M &usable, const M &active) {
    non_finite += uint32_t(count(active) - count(usable));
    return usable;
}

// Where the gradient of a small parameter is, or of those of a packet.
template <class F>
template <class Index>
TR_INLINE Index GradientSink<F>::constant(const Index &offset) const {
    if constexpr (Lanes<F>::Width > 1)
        return offset;
    else
        return offset * copies;
}

// Adds to a gradient.
template <class F>
template <class T>
TR_INLINE void GradientSink<F>::put(T *to, size_t index, T value) const {
    if constexpr (Lanes<F>::Width == 1) {
        if (fixed) {
            FixedSum<S> &sum = reinterpret_cast<FixedSum<S> *>(to)[index];
            return measures ? sum.measure(S(value)) : sum.add(S(value));
        }
    }
    accumulate(&to[index], value);
}

template <class F>
TR_INLINE void GradientSink<F>::add(double *to, const U &index, const F &g, const M &active) {
    auto usable = count_finite(active && is_finite(Spectrum<F, 1>{{g}}), active);
    for (int i = 0; i < Lanes<F>::Width; ++i)
        if (lane_is_set(usable, i)) put(to, lane(index, i), double(lane(g, i)));
}
template <class F>
TR_INLINE void GradientSink<F>::add_derivative(const Spectrum<F> &d, const M &active) {
    auto usable = count_finite(active && is_finite(d), active);
    derivative = select(usable, derivative + d, derivative);
}
template <class F>
TR_INLINE void GradientSink<F>::add_derivative(const F &d, const M &active) {
    Spectrum<F> one = uniform_spectrum(F(0));
    for (int c = 0; c < SpectrumSize; ++c)
        if (c == component) one[c] = d;
    add_derivative(one, active);
}

template <class F>
TR_LARGE void GradientSink<F>::number_tangent(const F &d, const M &active) {
    add_derivative(d, active);
}

// --------------------------------------------------------------------------------------------------------- textures
template <class F>
struct GradientSink<F>::Scatter {
    GradientSink &sink;
    const Scene &scene;
    const Spectrum<F> &g;
    TR_INLINE void constant(const I &offset, const M &lanes) { sink.spectrum(offset, g, lanes); }
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &, const M &lanes) {
        sink.footprint(scene, record.field[Bitmap::Data], at, g, lanes);
    }
    TR_INLINE void attribute(const Record &record, const AttributeInfo &info, const Footprint<F, 3> &at,
                             const M &lanes) {
        F scale(scene.values.constants[record.field[MeshAttribute::Scale]]);
        sink.footprint(scene, info.tensor, at, g * scale, lanes);
    }
    TR_INLINE void volume(int32_t index, const Vec3<F> &p, const M &lanes) { sink.volume(scene, index, p, g, lanes); }
};

template <class F>
template <class Point>
TR_INLINE void GradientSink<F>::any_texture(const Scene &scene, const I &id, const Point &at, const Spectrum<F> &g,
                                            const M &active) {
    if (forward) return add_derivative(g * eval_texture(scene, tangent, waves, id, at, active), active);
    auto usable = count_finite(active && is_finite(g), active);
    if (!any(usable)) return;
    Scatter scatter{*this, scene, g};
    visit_texture<F>(scene, id, at, usable, scatter);
}

template <class F>
TR_NOINLINE void GradientSink<F>::texture(const Scene &scene, const I &id, const TexturedPoint<F> &at,
                                          const Spectrum<F> &g, const M &active) {
    any_texture(scene, id, at, g, active);
}
template <class F>
TR_NOINLINE void GradientSink<F>::texture(const Scene &scene, const I &id, const SurfacePoint<F> &at,
                                          const Spectrum<F> &g, const M &active) {
    any_texture(scene, id, at, g, active);
}

template <class F>
TR_LARGE void GradientSink<F>::scalar_texture(const Scene &scene, const I &id, const TexturedPoint<F> &at,
                                              const Spectrum<F> &g, const M &active) {
    if (!forward) return texture(scene, id, at, luminance_adjoint(g), active);
    add_derivative(g * luminance(eval_texture(scene, tangent, waves, id, at, active)), active);
}

template <class F>
TR_LARGE void GradientSink<F>::daylight_luminance(const Scene &scene, const I &id, const TexturedPoint<F> &at,
                                                  const Spectrum<F> &g, const M &active) {
    if (forward) return add_derivative(g * tr::daylight_luminance(scene, tangent, id, at, active), active);
    const Wavelengths<F> own = waves;
    const Spectrum<F> share = uniform_spectrum(component_sum(g) * F(ScalarOf<F>(1.0 / LuminanceNodes)));
    for (int third = 0; third < LuminanceNodes / SpectrumSize; ++third) {
        waves = luminance_wavelengths<F>(third);
        texture(scene, id, at, share, active);
    }
    waves = own;
}

template <class F>
TR_LARGE void GradientSink<F>::vector_texture(const Scene &scene, const I &id, const TexturedPoint<F> &at,
                                              const Vec3<F> &g, const M &active) {
    Spectrum<F> channels{{g.x, g.y, g.z}};
    if (!forward) return texture(scene, id, at, channels, active);
    add_derivative(component_sum(channels * eval_texture(scene, tangent, waves, id, at, active)), active);
}

// ------------------------------------------------------------------------------------------------- small parameters
template <class F>
TR_NOINLINE void GradientSink<F>::spectrum(const I &offset, const Spectrum<F> &g, const M &active) {
    if (forward) return add_derivative(g * constant_spectrum<F>(tangent, waves, offset, active), active);
    auto usable = count_finite(active && is_finite(g), active);
    if (waves.spectral()) return add_to_tables(offset, g, usable);
    if constexpr (Lanes<F>::Width > 1) {
        if (!any(usable)) return;
        int32_t first = first_lane(offset, usable);
        if (!any(usable && mask<F>(offset != first))) {  // adding lane by lane would wait for every addition
            for (int c = 0; c < SpectrumSize; ++c)
                put(constants, size_t(first + c), double(lane_sum(select(usable, g[c], F(0)))));
            return;
        }
    }
    double *const to = constants;  // not read again after every addition
    for (int i = 0; i < Lanes<F>::Width; ++i)
        if (lane_is_set(usable, i))
            for (int c = 0; c < SpectrumSize; ++c)
                put(to, constant(uint32_t(lane(offset, i)) + uint32_t(c)), double(lane(g[c], i)));
}

template <class F>
TR_NOINLINE void GradientSink<F>::add_to_tables(const I &offset, const Spectrum<F> &g, const M &active) {
    double *const to = constants;
    for (int c = 0; c < SpectrumSize; ++c) {
        const TablePlace<F> place(waves.at[c]);
        const U index = U(offset) + place.index;
        const F upper = g[c] * place.fraction, lower = g[c] - upper;
        for (int i = 0; i < Lanes<F>::Width; ++i) {
            if (!lane_is_set(active, i)) continue;
            put(to, constant(lane(index, i)), double(lane(lower, i)));
            put(to, constant(lane(index, i) + 1), double(lane(upper, i)));
        }
    }
}

template <class F>
TR_NOINLINE void GradientSink<F>::number(const I &offset, const Spectrum<F> &g, const M &active) {
    if (forward) return add_derivative(g * gather<F>(tangent.constants, U(offset), active), active);
    add(constants, constant(U(offset)), component_sum(g), active);
}

template <class F>
TR_NOINLINE void GradientSink<F>::scalar(const I &offset, const F &g, const M &active) {
    if (forward) return add_derivative(g * gather<F>(tangent.constants, U(offset), active), active);
    add(constants, constant(U(offset)), g, active);
}

// ---------------------------------------------------------------------------------------------------------- tensors
template <class F>
TR_NOINLINE void GradientSink<F>::footprint(const Scene &scene, int32_t slot, const Taps<F> &at, const Spectrum<F> &g,
                                            const M &active) {
    if (forward) {
        const TensorView<S> &to = tangent.tensors[slot];
        if (to.data) add_derivative(g * gather_taps(to, waves, at.texel, at.weight, at.n, active), active);
        return;
    }
    S *gradient = tensors[slot];
    if (!gradient) return;
    auto usable = count_finite(active && is_finite(g), active);
    const TensorView<S> &tensor = scene.values.tensors[slot];
    const int channels = tensor.shape[2];
    if (waves.spectral() && channels == SigmoidChannels) return add_sigmoid_texels(tensor, gradient, at, g, usable);
    for (int i = 0; i < Lanes<F>::Width; ++i) {
        if (!lane_is_set(usable, i)) continue;
        for (int k = 0; k < at.n; ++k) {
            S w = lane(at.weight[k], i);
            const size_t texel = size_t(lane(at.texel[k], i)) * size_t(channels);
            for (int c = 0; c < SpectrumSize; ++c)
                put(gradient, texel + size_t(channels == 1 ? 0 : c), w * lane(g[c], i));
        }
    }
}

template <class F>
TR_NOINLINE void GradientSink<F>::add_sigmoid_texels(const TensorView<S> &tensor, S *gradient, const Taps<F> &at,
                                                     const Spectrum<F> &g, const M &active) {
    sweep_sigmoid_texels(tensor.data, waves, at.texel, at.weight, at.n, g, active, [&](int k, const auto &bar) {
        for (int i = 0; i < Lanes<F>::Width; ++i) {
            if (!lane_is_set(active, i)) continue;
            const size_t texel = size_t(lane(at.texel[k], i)) * SigmoidChannels;
            for (int c = 0; c < SigmoidChannels; ++c) put(gradient, texel + size_t(c), lane(bar[c], i));
        }
    });
}

template <class F>
TR_LARGE void GradientSink<F>::luminance_footprint(const Scene &scene, int32_t slot, const Taps<F> &at,
                                                   const M &active) {
    if (!forward) {
        Spectrum<F> one = uniform_spectrum(F(0));
        one[0] = F(1);
        return footprint(scene, slot, at, luminance_adjoint(one), active);
    }
    const TensorView<S> &to = tangent.tensors[slot];
    if (to.data) add_derivative(luminance(gather_taps(to, waves, at.texel, at.weight, at.n, active)), active);
}

template <class F>
TR_LARGE void GradientSink<F>::taps(int32_t slot, const Taps<F> &at, const M &active) {
    if (forward) {
        const S *data = tangent.tensors[slot].data;
        if (!data) return;
        F sum(0);
        for (int k = 0; k < at.n; ++k) sum = fmadd(at.weight[k], gather<F>(data, at.texel[k], active), sum);
        return add_derivative(sum, active);
    }
    S *gradient = tensors[slot];
    if (!gradient) return;
    Spectrum<F, 1> sum{{F(0)}};
    for (int k = 0; k < at.n; ++k) sum[0] = sum[0] + abs(at.weight[k]);
    auto usable = count_finite(active && is_finite(sum), active);
    constexpr int W = Lanes<F>::Width;
    alignas(64) uint32_t texel[Taps<F>::Most][W];
    alignas(64) S weight[Taps<F>::Most][W];
    for (int k = 0; k < at.n; ++k) {
        store(&texel[k][0], at.texel[k]);
        store(&weight[k][0], at.weight[k]);
    }
    for (int i = 0; i < W; ++i) {
        if (!lane_is_set(usable, i)) continue;
        for (int k = 0; k < at.n; ++k) put(gradient, texel[k][i], weight[k][i]);
    }
}

template <class F>
TR_LARGE void GradientSink<F>::trapezoid(int32_t slot, int32_t n, S inner, const Spectrum<F> &g, const M &active) {
    auto weight = [&](int32_t i) { return i == 0 || i == n - 1 ? S(0.5) * inner : inner; };
    if (forward) {
        const S *data = tangent.tensors[slot].data;
        if (!data) return;
        S sum(0);
        for (int32_t i = 0; i < n; ++i) sum += weight(i) * data[i];
        return add_derivative(g * F(sum), active);
    }
    S *gradient = tensors[slot];
    if (!gradient) return;
    auto usable = count_finite(active && is_finite(g), active);
    S total(0);
    for (int c = 0; c < SpectrumSize; ++c) total += lane_sum(select(usable, g[c], F(0)));
    for (int32_t i = 0; i < n; ++i) put(gradient, size_t(i), total * weight(i));
}

template <class F>
TR_NOINLINE void GradientSink<F>::vertex(VertexArray array, const U &index, const F &g, const M &active) {
    if (forward) {
        const S *data = vertex_tangent[int(array)];
        if (data) add_derivative(g * gather<F>(data, index, active), active);
        return;
    }
    if (vertices[int(array)]) add(vertices[int(array)], index, g, active);
}

template <class F>
TR_LARGE void GradientSink<F>::volume(const Scene &scene, int32_t index, const Vec3<F> &p, const Spectrum<F> &g,
                                      const M &active) {
    const Record &record = scene.volumes[index];
    if (record.kind == int32_t(VolumeKind::Constant))
        return spectrum(I(record.field[ConstantVolume::Value]), g, active);
    const int32_t slot = record.field[GridVolume::Data];
    footprint(scene, slot, GridVolume::footprint(scene.values.tensors[slot], record, to_volume(scene, index, p)), g,
              active);
}

#define TR_INSTANTIATE(S) template class GradientSink<PacketOf<S>>;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
