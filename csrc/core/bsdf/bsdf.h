// What a BSDF provides. One header a model; the registry (core/registry.h) lists them.
//
//   static constexpr Field fields[];  static constexpr Model model;
//   static constexpr bool Smooth, Delta;      has a part with a density / has delta lobes
//   static constexpr int Albedo;              the field, a texture, that is the output `albedo`; -1: white
//   template <class T, int C> struct Params;  the parameters at a point, for a scalar type T (a Float or a dual number)
//   Params<T, C> params(const T *numbers)     (see ParamList)
//   static constexpr bool Asymmetric = true;  eval takes, last, what is transported: Transport::Radiance (the default)
//                                or Importance, for which wi is where light comes from
//   eval(params, wi, wo, lobe)   f |cos| of the lobe: smooth lobes by value, delta lobes the weight of the lobe times
//   the
//                                probability with which `sample` chooses it
//   pdf(params, wi, wo)          solid-angle density of the smooth part (0 for purely delta models)
//   sample(params, wi, u0, u1, u2) -> BsdfSample
//   direction(params, wi, lobe)  models with Delta: where a delta lobe sends wi, differentiable in wi and the numbers
//
// Directions are local: +z is the shading normal; wi points to where the path came from, wo along the new ray, both
// away from the surface. Radiance is transported along wo -> wi. Values include |cos(theta_o)|. `lobe` numbers what
// `sample` chose: 0 is the smooth part of a model that has one.
#pragma once

#include "../math/dual.h"
#include "../texture/texture.h"

namespace tr {

enum class Transport { Radiance, Importance };

template <class F>
struct BsdfSample {
    Vec3<F> wo;
    F pdf;  // density, or the probability of a delta lobe; 0: the sample failed
    F eta;  // index of refraction along wo over that along wi
    IntOf<F> lobe;
    MaskOf<F> delta, null;  // a delta lobe; passed through unchanged
};

template <class Model>
constexpr auto is_asymmetric(int) -> decltype(Model::Asymmetric) {
    return Model::Asymmetric;
}
template <class Model>
constexpr bool is_asymmetric(...) {
    return false;
}

template <Transport transport, class Model, int C, class P, class V, class I>
TR_INLINE auto eval_bsdf(const P &params, const V &wi, const V &wo, const I &lobe) {
    if constexpr (transport == Transport::Importance && is_asymmetric<Model>(0))
        return Model::template eval<C>(params, wi, wo, lobe, Transport::Importance);
    else
        return Model::template eval<C>(params, wi, wo, lobe);
}

// The parameters of a model in the order of its fields: textures and spectra as colours, single numbers as scalars,
// switches, which come last, as integers.
template <class T, int N>
struct Switches {
    IntOf<T> choice[N];
};
template <class T>
struct Switches<T, 0> {};

template <class T, int C, int NColors, int NNumbers, int NSwitches = 0>
struct Params : Switches<T, NSwitches> {
    Color<T, C> color[NColors > 0 ? NColors : 1];
    T number[NNumbers > 0 ? NNumbers : 1];
};

constexpr int count_fields(const Field *fields, int n, Kind kind) {
    int r = 0;
    for (int i = 0; i < n; ++i) r += fields[i].kind == kind;
    return r;
}

constexpr bool switches_are_last(const Field *fields, int n) {
    for (int i = 1; i < n; ++i)
        if (fields[i - 1].kind == Kind::Int && fields[i].kind != Kind::Int) return false;
    return true;
}

// Bit i is set where field i is a single number. (Device code reads constants, but no table of the host's.)
constexpr uint32_t number_fields(const Field *fields, int n) {
    uint32_t r = 0;
    for (int i = 0; i < n; ++i) r |= uint32_t(fields[i].kind == Kind::Float) << i;
    return r;
}

template <class Model>
struct ParamCount {
    static constexpr uint32_t NumberFields = number_fields(Model::fields, Model::model.n_fields);
    static constexpr int Numbers = count_fields(Model::fields, Model::model.n_fields, Kind::Float);
    static constexpr int Switches = count_fields(Model::fields, Model::model.n_fields, Kind::Int);
    static constexpr int All = Model::model.n_fields - Switches;  // the continuous ones
    static constexpr int Colors = All - Numbers;
    static_assert(switches_are_last(Model::fields, Model::model.n_fields), "continuous parameters are counted first");
};

template <class Model, class T, int C>
using ParamsOf = Params<T, C, ParamCount<Model>::Colors, ParamCount<Model>::Numbers, ParamCount<Model>::Switches>;

// Reads the parameters of a record at a surface point.
template <class Model, int C, template <class> class Point, class F, class S>
TR_INLINE ParamsOf<Model, F, C> load_params(const SceneView<S> &scene, const IntOf<F> &bsdf, const Point<F> &at,
                                            const MaskOf<F> &active) {
    ParamsOf<Model, F, C> p{};
    int color = 0, number = 0;
    for (int i = 0; i < ParamCount<Model>::All; ++i) {
        IntOf<F> field = record_field<F>(scene.bsdfs, i, bsdf, active);
        if ((ParamCount<Model>::NumberFields >> i) & 1)
            p.number[number++] = gather<F>(scene.values.constants, UIntOf<F>(field), active);
        else
            p.color[color++] = eval_texture<C>(scene, scene.values, field, at, active);
    }
    if constexpr (ParamCount<Model>::Switches > 0)
        for (int i = 0; i < ParamCount<Model>::Switches; ++i)
            p.choice[i] = record_field<F>(scene.bsdfs, ParamCount<Model>::All + i, bsdf, active);
    return p;
}

// The same with the i-th parameter as the i-th independent variable. Colours need one variable, not C: channels do not
// mix.
template <class Model, int C, class F>
TR_INLINE auto seed_params(const ParamsOf<Model, F, C> &p) {
    using D = Dual<F, ParamCount<Model>::All>;
    ParamsOf<Model, D, C> r;
    int color = 0, number = 0;
    for (int i = 0; i < ParamCount<Model>::All; ++i) {
        if ((ParamCount<Model>::NumberFields >> i) & 1) {
            r.number[number] = D(p.number[number], i);
            ++number;
        } else {
            for (int c = 0; c < C; ++c) r.color[color][c] = D(p.color[color][c], i);
            ++color;
        }
    }
    if constexpr (ParamCount<Model>::Switches > 0)
        for (int i = 0; i < ParamCount<Model>::Switches; ++i) r.choice[i] = p.choice[i];
    return r;
}

}  // namespace tr
