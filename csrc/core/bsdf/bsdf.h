// What a BSDF provides. One header a model; the registry (core/registry.h) lists them.
//
//   static constexpr Field fields[];  static constexpr Model model;
//   static constexpr bool Smooth, Delta;      has a part with a density / has delta lobes
//   static constexpr bool Oriented = true;    x and y count: they are along dp/du and across it
//   static constexpr int OrientedBy;          the field, a texture, without which they do not after all
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
// Directions are local: +z is the shading normal, x and y are any two axes unless the model is Oriented; wi points to
// where the path came from, wo along the new ray, both away from the surface. Radiance is transported along wo -> wi.
// Values include |cos(theta_o)|. `lobe` numbers what `sample` chose: 0 is the smooth part of a model that has one.
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
TR_INLINE auto eval_inline(const P &params, const V &wi, const V &wo, const I &lobe) {
    if constexpr (transport == Transport::Importance && is_asymmetric<Model>(0))
        return Model::template eval<C>(params, wi, wo, lobe, Transport::Importance);
    else
        return Model::template eval<C>(params, wi, wo, lobe);
}

// The parameters of a model in the order of its fields: textures and spectra as colours, single numbers and textures of
// them as scalars, switches, which come last, as integers.
template <class T, int N>
struct Switches {
    IntOf<T> choice[N];
};
template <class T>
struct Switches<T, 0> {};

// Where the host's table for a model that is `Tabled` begins.
template <class T, bool Tabled>
struct TableOf {
    const ScalarOf<T> *table;
    IntOf<T> row;
};
template <class T>
struct TableOf<T, false> {};

template <class T, int C, int NColors, int NNumbers, int NSwitches = 0, bool Tabled = false>
struct Params : Switches<T, NSwitches>, TableOf<T, Tabled> {
    Color<T, C> color[NColors > 0 ? NColors : 1];
    T number[NNumbers > 0 ? NNumbers : 1];
};

// Directions as those of another scalar type.
template <class T, class F>
TR_INLINE Vec3<T> convert(const Vec3<F> &v) {
    return {T(v.x), T(v.y), T(v.z)};
}

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

// Bit i is set where field i is of the kind. (Device code reads constants, but no table of the host's.)
constexpr uint32_t fields_of(const Field *fields, int n, Kind kind) {
    uint32_t r = 0;
    for (int i = 0; i < n; ++i) r |= uint32_t(fields[i].kind == kind) << i;
    return r;
}

// The continuous fields whose derivative is not "none: ...", which must come first.
constexpr int count_differentiable(const Field *fields, int n) {
    int r = 0;
    while (r < n && fields[r].kind != Kind::Int && fields[r].derivative[0] != 'n') ++r;
    return r;
}

// A model may ask for the luminance of one of its colours by declaring the field, `static constexpr int LuminanceOf`.
// It is a further number, the last, and a parameter of its own for derivatives, since all channels depend on it.
template <class Model, class = void>
struct LuminanceField {
    static constexpr int value = -1;
};
template <class Model>
struct LuminanceField<Model, std::enable_if_t<(Model::LuminanceOf >= 0)>> {
    static constexpr int value = Model::LuminanceOf;
};

// A model for which the host makes a table declares `static constexpr bool Tabled = true`.
template <class Model, class = void>
struct IsTabled : std::false_type {};
template <class Model>
struct IsTabled<Model, std::enable_if_t<Model::Tabled>> : std::true_type {};

// A model whose frame follows the texture coordinates, see tangent_frame.
template <class Model, class = void>
struct IsOriented : std::false_type {};
template <class Model>
struct IsOriented<Model, std::enable_if_t<Model::Oriented>> : std::true_type {};

template <class Model, class = void>
struct OrientingField {
    static constexpr int value = -1;
};
template <class Model>
struct OrientingField<Model, std::enable_if_t<(Model::OrientedBy >= 0)>> {
    static constexpr int value = Model::OrientedBy;
};

template <class Model>
struct ParamCount {
    static constexpr uint32_t ScalarFields = fields_of(Model::fields, Model::model.n_fields, Kind::Scalar);
    static constexpr uint32_t NumberFields =
        fields_of(Model::fields, Model::model.n_fields, Kind::Float) | ScalarFields;
    static constexpr int Scalars = count_fields(Model::fields, Model::model.n_fields, Kind::Scalar);
    static constexpr int Numbers = count_fields(Model::fields, Model::model.n_fields, Kind::Float) + Scalars;
    static constexpr int Switches = count_fields(Model::fields, Model::model.n_fields, Kind::Int);
    static constexpr int All = Model::model.n_fields - Switches;  // the continuous ones
    static constexpr int Colors = All - Numbers;
    static constexpr bool Luminance = LuminanceField<Model>::value >= 0;
    static constexpr int Fields = count_differentiable(Model::fields, All);
    static constexpr int Variables = Fields + Luminance;  // of derivatives
    // More of them are taken a block at a time: that many numbers in flight no longer fit into registers.
    static constexpr int Blocks = (Variables + 5) / 6;
    static constexpr int Block = Blocks > 0 ? (Variables + Blocks - 1) / Blocks : 0;
    static constexpr bool is_scalar(int i) { return (ScalarFields >> i) & 1; }
    static constexpr bool is_number(int i) { return (NumberFields >> i) & 1; }
    static_assert(switches_are_last(Model::fields, Model::model.n_fields), "continuous parameters are counted first");
};

template <class Model, class T, int C>
using ParamsOf = Params<T, C, ParamCount<Model>::Colors, ParamCount<Model>::Numbers + ParamCount<Model>::Luminance,
                        ParamCount<Model>::Switches, IsTabled<Model>::value>;

// Reads the parameters of a record at a surface point.
template <class Model, int C, template <class> class Point, class F, class S>
TR_INLINE ParamsOf<Model, F, C> load_params(const SceneView<S> &scene, const IntOf<F> &bsdf, const Point<F> &at,
                                            const MaskOf<F> &active) {
    ParamsOf<Model, F, C> p{};
    int color = 0, number = 0;
    for (int i = 0; i < ParamCount<Model>::All; ++i) {
        IntOf<F> field = record_field<F>(scene.bsdfs, i, bsdf, active);
        if (ParamCount<Model>::is_scalar(i))
            p.number[number++] = luminance(eval_texture<C>(scene, scene.values, field, at, active));
        else if (ParamCount<Model>::is_number(i))
            p.number[number++] = gather<F>(scene.values.constants, UIntOf<F>(field), active);
        else
            p.color[color++] = eval_texture<C>(scene, scene.values, field, at, active);
        if (i == LuminanceField<Model>::value) p.number[ParamCount<Model>::Numbers] = luminance(p.color[color - 1]);
    }
    if constexpr (ParamCount<Model>::Switches > 0)
        for (int i = 0; i < ParamCount<Model>::Switches; ++i)
            p.choice[i] = record_field<F>(scene.bsdfs, ParamCount<Model>::All + i, bsdf, active);
    if constexpr (IsTabled<Model>::value) {
        static_assert(Model::model.n_fields <= Record::Extra, "the first number of the host's is free");
        p.table = scene.bsdf_tables;
        p.row = record_field<F>(scene.bsdfs, Record::Extra, bsdf, active);
    }
    return p;
}

// The same with the parameters from `first` on, as many as a block has, as independent variables. Colours need one
// variable, not C: channels do not mix.
template <class Model, int C, class F>
TR_INLINE auto seed_params(const ParamsOf<Model, F, C> &p, int first = 0) {
    using Count = ParamCount<Model>;
    using D = Dual<F, Count::Block>;
    auto seed = [&](const F &value, int variable) {
        D d(value);
        int i = variable - first;
        if (variable < Count::Variables && i >= 0 && i < Count::Block) d.d[i] = F(1);
        return d;
    };
    ParamsOf<Model, D, C> r;
    int color = 0, number = 0;
    for (int i = 0; i < Count::All; ++i) {
        int variable = i < Count::Fields ? i : Count::Variables;
        if (Count::is_number(i)) {
            r.number[number] = seed(p.number[number], variable);
            ++number;
        } else {
            for (int c = 0; c < C; ++c) r.color[color][c] = seed(p.color[color][c], variable);
            ++color;
        }
    }
    if (Count::Luminance) r.number[number] = seed(p.number[number], Count::Fields);
    if constexpr (ParamCount<Model>::Switches > 0)
        for (int i = 0; i < ParamCount<Model>::Switches; ++i) r.choice[i] = p.choice[i];
    if constexpr (IsTabled<Model>::value) r.table = p.table, r.row = p.row;
    return r;
}

// Large models are compiled once for all places that call them.
template <class Model>
constexpr bool IsLarge = Model::Smooth && ParamCount<Model>::Variables > 2;

template <Transport transport, class Model, int C, class P, class V, class I>
TR_NOINLINE auto eval_large(const P &params, const V &wi, const V &wo, const I &lobe) {
    return eval_inline<transport, Model, C>(params, wi, wo, lobe);
}
template <Transport transport, class Model, int C, class P, class V, class I>
TR_INLINE auto eval_bsdf(const P &params, const V &wi, const V &wo, const I &lobe) {
    if constexpr (IsLarge<Model>)
        return eval_large<transport, Model, C>(params, wi, wo, lobe);
    else
        return eval_inline<transport, Model, C>(params, wi, wo, lobe);
}

}  // namespace tr
