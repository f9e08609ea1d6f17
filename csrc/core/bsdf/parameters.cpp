#include "parameters.h"

#include "../medium/bend_medium.h"

namespace tr {

namespace {

// Where the numbers of a kind go, in the order of BsdfParameters.
template <class F>
struct ParameterWriter {
    const SceneOf<F> &scene;
    const Wavelengths<F> &waves;
    const TexturedPoint<F> &at;
    const MaskOf<F> &active;
    F *color, *number, *luminance_to;
    int luminance_of;

    TR_INLINE ParameterWriter(const SceneOf<F> &of, const Wavelengths<F> &waves_, const TexturedPoint<F> &at_,
                              const MaskOf<F> &active_, const BsdfInfo &model, BsdfParameters<F> &to)
        : scene(of),
          waves(waves_),
          at(at_),
          active(active_),
          color(to.number),
          number(to.number + SpectrumSize * model.n_colors),
          luminance_to(number + model.n_numbers),
          luminance_of(model.luminance_of) {}
    TR_INLINE void put(int field, BsdfInfo::Use use, const IntOf<F> &texture, const Spectrum<F> &value) {
        if (use == BsdfInfo::Luminance) {
            *number++ = luminance(value);
            return;
        }
        for (int c = 0; c < SpectrumSize; ++c) *color++ = value[c];
        if (field != luminance_of) return;
        *luminance_to =
            waves.spectral() ? daylight_luminance(scene, scene.values, texture, at, active) : luminance(value);
    }
};

// The same of the function daylight_luminance.
template <class F>
TR_NOINLINE void sweep_daylight_luminance(const SceneOf<F> &scene, const IntOf<F> &texture, const TexturedPoint<F> &at,
                                          const Spectrum<F> &g, const GradientNeeds &needs, const MaskOf<F> &active,
                                          CoordinateAdjoint<F> &to, GradientSink<F> &sink) {
    if (needs.bsdf) sink.daylight_luminance(scene, texture, at, g, active);
    if (!needs.geometry) return;
    const Wavelengths<F> own = sink.waves;
    const Spectrum<F> share = uniform_spectrum(component_sum(g) * F(ScalarOf<F>(1.0 / LuminanceNodes)));
    for (int third = 0; third < LuminanceNodes / SpectrumSize; ++third) {
        sink.waves = luminance_wavelengths<F>(third);
        sweep_lookup(scene, texture, at, share, active, to, sink);
    }
    sink.waves = own;
}

}  // namespace

template <class F>
TR_LARGE void load_parameters(const SceneOf<F> &scene, const Wavelengths<F> &waves, const BsdfInfo &model,
                              const IntOf<F> &bsdf, const TexturedPoint<F> &at, const MaskOf<F> &active,
                              BsdfParameters<F> &to) {
    using I = IntOf<F>;
    ParameterWriter<F> writer(scene, waves, at, active, model, to);
    to.table = scene.bsdf_tables;
    to.refraction = IntOf<F>(waves.spectral() ? RefractsFirst : RefractsAll);
    const bool bent = model.bent;
    const int32_t first = any(active) ? int32_t(first_lane(bsdf, active)) : -1;
    if (first >= 0 && !any(active && mask<F>(bsdf != first))) {  // one object in all lanes: its record is read once
        const Record &record = scene.bsdfs[first];
        for (int i = 0; i < model.n_continuous; ++i) {
            const int32_t field = record.field[i];
            if (model.use[i] == BsdfInfo::Number)
                *writer.number++ = bent ? boundary_eta<F>(scene, at, active) : F(scene.values.constants[field]);
            else if (TextureKind(scene.textures[field].kind) == TextureKind::Constant)
                writer.put(
                    i, model.use[i], I(field),
                    constant_spectrum<F>(scene.values, waves, scene.textures[field].field[ConstantTexture::Value]));
            else
                writer.put(i, model.use[i], I(field), eval_texture(scene, waves, I(field), at, active));
        }
        for (int i = 0; i < model.n_choices; ++i) to.choice[i] = I(record.field[model.n_continuous + i]);
        to.row = I(record.field[Record::Extra]);
        return;
    }
    for (int i = 0; i < model.n_continuous; ++i) {
        const I field = record_field<F>(scene.bsdfs, i, bsdf, active);
        if (model.use[i] == BsdfInfo::Number && bent)
            *writer.number++ = boundary_eta<F>(scene, at, active);
        else if (model.use[i] == BsdfInfo::Number)
            *writer.number++ = gather<F>(scene.values.constants, UIntOf<F>(field), active);
        else
            writer.put(i, model.use[i], field, eval_texture(scene, waves, field, at, active));
    }
    for (int i = 0; i < model.n_choices; ++i)
        to.choice[i] = record_field<F>(scene.bsdfs, model.n_continuous + i, bsdf, active);
    if (model.tabulated) to.row = record_field<F>(scene.bsdfs, Record::Extra, bsdf, active);
}

template <class F>
TR_LARGE void sweep_parameters(const SceneOf<F> &scene, const BsdfInfo &model, const IntOf<F> &bsdf,
                               const TexturedPoint<F> &at, const Spectrum<F> *g, uint32_t variables,
                               const GradientNeeds &needs, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                               GradientSink<F> &sink) {
    for (int i = 0; i < model.n_variables; ++i) {
        if (!(variables >> i & 1)) continue;
        const bool is_field = i < model.n_differentiable;
        const BsdfInfo::Use use = is_field ? BsdfInfo::Use(model.use[i]) : BsdfInfo::Luminance;
        IntOf<F> field = record_field<F>(scene.bsdfs, is_field ? i : model.luminance_of, bsdf, active);
        if (model.bent && use == BsdfInfo::Number) {
            // see sweep_boundary
        } else if (use == BsdfInfo::Number) {
            sink.number(field, g[i], active);
        } else if (!is_field && sink.waves.spectral()) {
            sweep_daylight_luminance(scene, field, at, g[i], needs, active, to, sink);
        } else if (use == BsdfInfo::Luminance) {
            if (needs.bsdf) sink.scalar_texture(scene, field, at, g[i], active);
            if (needs.geometry) sweep_lookup(scene, field, at, luminance_adjoint(g[i]), active, to, sink);
        } else {
            if (needs.bsdf) sink.texture(scene, field, at, g[i], active);
            if (needs.geometry) sweep_lookup(scene, field, at, g[i], active, to, sink);
        }
    }
}

template <class F>
TR_LARGE void sweep_numbers(const SceneOf<F> &scene, const BsdfInfo &model, const IntOf<F> &bsdf,
                            const TexturedPoint<F> &at, const F *g, const MaskOf<F> &active, GradientSink<F> &sink) {
    if (model.turned_by >= 0) {
        const IntOf<F> field = record_field<F>(scene.bsdfs, model.turned_by, bsdf, active);
        return sink.vector_texture(scene, field, at, {g[0], F(0), F(0)}, active);
    }
    for (int i = 0; i < model.n_continuous; ++i)
        if (model.use[i] == BsdfInfo::Number) sink.scalar(record_field<F>(scene.bsdfs, i, bsdf, active), *g++, active);
}

#define TR_INSTANTIATE(F, S)                                                                                           \
    template void load_parameters(const SceneView<S> &, const Wavelengths<F> &, const BsdfInfo &, const IntOf<F> &,    \
                                  const TexturedPoint<F> &, const MaskOf<F> &, BsdfParameters<F> &);                   \
    template void sweep_parameters(const SceneView<S> &, const BsdfInfo &, const IntOf<F> &, const TexturedPoint<F> &, \
                                   const Spectrum<F> *, uint32_t, const GradientNeeds &, const MaskOf<F> &,            \
                                   CoordinateAdjoint<F> &, GradientSink<F> &);                                         \
    template void sweep_numbers(const SceneView<S> &, const BsdfInfo &, const IntOf<F> &, const TexturedPoint<F> &,    \
                                const F *, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
