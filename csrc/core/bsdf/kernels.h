// From a model's functions to its table. A model provides
//
//   static constexpr Field fields[];  static constexpr Model model;
//   static constexpr int Albedo;              the field, a texture, that is the output `albedo`; -1: white
//   static constexpr int LuminanceOf = i;     (optional) the luminance of this colour is a further number, the last,
//   and
//                                             a variable of its own, since all components depend on it
//   static constexpr bool Tabulated = true;   (optional) the host makes a table for its records
//   static constexpr int TurnedBy = i;        (optional) this colour's first component refracts, in place of a number
//   static constexpr Polarization Polarizes = ...;  (optional) what its facets make of polarised light
//   static constexpr bool Bent = true;        (optional) its number is the index of a medium at the point
//   eval(params, wi, wo, lobe)    f |cos| of a smooth lobe, or of a delta lobe its weight times the probability with
//                                 which `sample` chooses it; takes the Transport last if the model IsAsymmetric.
//                                 Written for a scalar type T, it is its own derivative when T is a dual number
//   pdf(params, wi, wo)           solid-angle density of the smooth part (0 for purely delta models)
//   sample(params, wi, u0, u1, u2) -> BsdfSample
//                                 u0 is a number only if the model ChoosesLobe, the others only if it HasSmoothLobes
//   direction(params, wi, lobe)   models with delta lobes: where such a lobe sends wi
//
// or, where value and density are found together (`static constexpr bool Joint = true`), in place of pdf and sample
//
//   eval_pdf(params, wi, wo, transport) -> BsdfValue
//   sample(params, wi, u0, u1, u2, transport) -> Vec3    the direction, of the density that eval_pdf gives
//
// and ends with TR_BSDF(Model).
#pragma once

#include "../math/dual.h"
#include "bsdf.h"

namespace tr {

// ------------------------------------------------------------------------------------------------- the declaration
constexpr int count_fields(const Model &model, Kind kind) {
    int r = 0;
    for (int i = 0; i < model.n_fields; ++i) r += model.fields[i].kind == kind;
    return r;
}

template <class M, class = void>
struct LuminanceOf : std::integral_constant<int, -1> {};
template <class M>
struct LuminanceOf<M, std::enable_if_t<(M::LuminanceOf >= 0)>> : std::integral_constant<int, M::LuminanceOf> {};
template <class M, class = void>
struct IsTabulated : std::false_type {};
template <class M>
struct IsTabulated<M, std::enable_if_t<M::Tabulated>> : std::true_type {};

template <class M, class = void>
struct IsBent : std::false_type {};
template <class M>
struct IsBent<M, std::enable_if_t<M::Bent>> : std::true_type {};

template <class M, class = void>
struct TurnedBy : std::integral_constant<int, -1> {};
template <class M>
struct TurnedBy<M, std::enable_if_t<(M::TurnedBy >= 0)>> : std::integral_constant<int, M::TurnedBy> {};

template <class M, class = void>
struct Polarizes : std::integral_constant<Polarization, Polarization::None> {};
template <class M>
struct Polarizes<M, std::enable_if_t<(M::Polarizes != Polarization::None)>>
    : std::integral_constant<Polarization, M::Polarizes> {};

template <class M, class = void>
struct IsJoint : std::false_type {};
template <class M>
struct IsJoint<M, std::enable_if_t<M::Joint>> : std::true_type {};

template <class M>
constexpr BsdfInfo bsdf_info() {
    const Model &model = M::model;
    BsdfInfo r{};
    static_cast<ModelInfo &>(r) = model;
    r.n_choices = count_fields(model, Kind::Int);
    r.n_continuous = model.n_fields - r.n_choices;
    for (int i = 0; i < r.n_continuous; ++i) {
        Kind kind = model.fields[i].kind;
        r.use[i] = kind == Kind::Float    ? BsdfInfo::Number
                   : kind == Kind::Scalar ? BsdfInfo::Luminance
                                          : BsdfInfo::Color;
        (r.use[i] == BsdfInfo::Color ? r.n_colors : r.n_numbers)++;
    }
    while (r.n_differentiable < r.n_continuous && model.fields[r.n_differentiable].derivative[0] != 'n')
        ++r.n_differentiable;
    r.luminance_of = LuminanceOf<M>::value;
    r.n_variables = r.n_differentiable + (r.luminance_of >= 0);
    r.tabulated = IsTabulated<M>::value;
    r.turned_by = TurnedBy<M>::value;
    r.polarizes = Polarizes<M>::value;
    r.eta = field_named(model, r.polarizes == Polarization::Retarder ? "delta" : "eta");
    r.k = field_named(model, "k"), r.theta = field_named(model, "theta");
    r.bent = IsBent<M>::value;
    r.albedo = M::Albedo;
    r.specular = field_named(model, "specular_reflectance");
    r.roughness = field_named(model, "alpha") >= 0 ? field_named(model, "alpha") : field_named(model, "roughness");
    r.tangent_of = -1;
    for (int i = 0; i < model.n_fields; ++i)
        if (model.fields[i].traits & FollowsTangent) r.tangent_of = i;
    return r;
}

// The position of a field among colours.
constexpr int color_of(const BsdfInfo &info, int field) {
    int r = 0;
    for (int i = 0; i < field; ++i) r += info.use[i] == BsdfInfo::Color;
    return r;
}

// Positions among colours, numbers and choices of fields by their names: what eval, pdf and sample ask.
template <int N>
constexpr int place_of(const Field (&fields)[N], const char *name, bool (*same)(Kind)) {
    int r = 0;
    for (int i = 0; i < field_index(fields, name); ++i) r += same(fields[i].kind);
    return r;
}
template <int N>
constexpr int color_index(const Field (&fields)[N], const char *name) {
    return place_of(fields, name, [](Kind kind) { return kind == Kind::Texture; });
}
template <int N>
constexpr int number_index(const Field (&fields)[N], const char *name) {
    return place_of(fields, name, [](Kind kind) { return kind == Kind::Float || kind == Kind::Scalar; });
}
template <int N>
constexpr int choice_index(const Field (&fields)[N], const char *name) {
    return place_of(fields, name, [](Kind kind) { return kind == Kind::Int; });
}

// ---------------------------------------------------------------------------------------------------- parameters
template <class T, int N>
struct ChoicesOf {
    IntOf<T> choice[N];
};
template <class T>
struct ChoicesOf<T, 0> {};
template <class T, bool Tabulated>
struct TableOf {
    const ScalarOf<T> *table;
    IntOf<T> row;
};
template <class T>
struct TableOf<T, false> {};
template <class T, bool Disperses>
struct RefractionOf {
    IntOf<T> refraction;
};
template <class T>
struct RefractionOf<T, false> {};

// A model's parameters for a scalar type T: a Float or a dual number.
template <class T, int NColors, int NNumbers, int NChoices = 0, bool Tabulated = false, bool Disperses = false>
struct Params : ChoicesOf<T, NChoices>, TableOf<T, Tabulated>, RefractionOf<T, Disperses> {
    Spectrum<T> color[NColors > 0 ? NColors : 1];
    T number[NNumbers > 0 ? NNumbers : 1];
};

template <class M, class T>
using ParamsOf = Params<T, bsdf_info<M>().n_colors, bsdf_info<M>().n_numbers + (bsdf_info<M>().luminance_of >= 0),
                        bsdf_info<M>().n_choices, bsdf_info<M>().tabulated, (TurnedBy<M>::value >= 0)>;

template <class M, class F, class T>
TR_INLINE void copy_constants(const BsdfParameters<F> &from, ParamsOf<M, T> &to) {
    constexpr BsdfInfo info = bsdf_info<M>();
    if constexpr (info.n_choices > 0)
        for (int i = 0; i < info.n_choices; ++i) to.choice[i] = from.choice[i];
    if constexpr (info.tabulated) to.table = from.table, to.row = from.row;
    if constexpr (info.turned_by >= 0) to.refraction = from.refraction;
}

template <class M, class F>
TR_INLINE ParamsOf<M, F> unpack(const BsdfParameters<F> &from) {
    constexpr BsdfInfo info = bsdf_info<M>();
    static_assert(SpectrumSize * info.n_colors + info.n_numbers < BsdfParameters<F>::MaxNumbers, "there is room");
    static_assert(info.n_choices <= BsdfParameters<F>::MaxChoices, "there is room");
    static_assert(!info.tabulated || M::model.n_fields <= Record::Extra, "the host's number has a place");
    ParamsOf<M, F> to{};
    for (int i = 0; i < info.n_colors; ++i)
        for (int c = 0; c < SpectrumSize; ++c) to.color[i][c] = from.number[SpectrumSize * i + c];
    for (int i = 0; i < info.n_numbers + (info.luminance_of >= 0); ++i)
        to.number[i] = from.number[SpectrumSize * info.n_colors + i];
    copy_constants<M>(from, to);
    return to;
}

// Derivatives by many variables are taken a block of them at a time: more numbers in flight do not fit into registers.
// Blocks in which nothing is wanted are left out; a colour's luminance comes behind that colour, for both are wanted
// then.
template <class M>
struct VariableBlocks {
    static constexpr BsdfInfo Info = bsdf_info<M>();
    static constexpr int N = Info.n_variables, Count = (N + 5) / 6, Size = Count ? (N + Count - 1) / Count : 0;

    // Places in the order of blocks.
    TR_HD static constexpr int place_of(int variable) {
        if (Info.luminance_of < 0 || variable <= Info.luminance_of) return variable;
        return variable == Info.n_differentiable ? Info.luminance_of + 1 : variable + 1;
    }
    TR_HD static constexpr int variable_at(int place) {
        if (Info.luminance_of < 0 || place <= Info.luminance_of) return place;
        return place == Info.luminance_of + 1 ? Info.n_differentiable : place - 1;
    }
    // The variables of the block that begins at a place, a bit each.
    TR_HD static constexpr uint32_t bits(int first) {
        uint32_t r = 0;
        for (int i = first; i < first + Size && i < N; ++i) r |= 1u << variable_at(i);
        return r;
    }
};

// The same with the variables of the block that begins at the place `first` as independent ones. Colours need one
// variable, not one a component: components do not mix.
template <class M, class F>
TR_INLINE auto seed(const BsdfParameters<F> &from, int first) {
    constexpr BsdfInfo info = bsdf_info<M>();
    constexpr int Block = VariableBlocks<M>::Size;
    using D = Dual<F, Block>;
    auto dual = [&](const F &value, int variable) {
        D d(value);
        int i = VariableBlocks<M>::place_of(variable) - first;
        if (variable < info.n_variables && i >= 0 && i < Block) d.d[i] = F(1);
        return d;
    };
    ParamsOf<M, D> to;
    int color = 0, number = 0;
    for (int i = 0; i < info.n_continuous; ++i) {
        int variable = i < info.n_differentiable ? i : info.n_variables;
        if (info.use[i] == BsdfInfo::Color) {
            for (int c = 0; c < SpectrumSize; ++c)
                to.color[color][c] = dual(from.number[SpectrumSize * color + c], variable);
            ++color;
        } else {
            to.number[number] = dual(from.number[SpectrumSize * info.n_colors + number], variable);
            ++number;
        }
    }
    if (info.luminance_of >= 0)
        to.number[number] = dual(from.number[SpectrumSize * info.n_colors + number], info.n_differentiable);
    copy_constants<M>(from, to);
    return to;
}

// Directions as those of another scalar type.
template <class T, class F>
TR_INLINE Vec3<T> convert(const Vec3<F> &v) {
    return {T(v.x), T(v.y), T(v.z)};
}

// ------------------------------------------------------------------------------------------------------- functions
template <class M, class P, class V, class I>
TR_INLINE auto eval_model(const P &params, const V &wi, const V &wo, const I &lobe, Transport transport) {
    if constexpr (M::model.is(IsAsymmetric))
        return M::eval(params, wi, wo, lobe, transport);
    else
        return M::eval(params, wi, wo, lobe);
}

template <class M, class F>
struct KernelsOf {
    using Parameters = BsdfParameters<F>;
    static constexpr bool Smooth = M::model.is(HasSmoothLobes), Delta = M::model.is(HasDeltaLobes);

    TR_HD static void eval_pdf(const Parameters &at, const Vec3<F> &wi, const Vec3<F> &wo, Transport transport,
                               BsdfValue<F> &r) {
        auto params = unpack<M>(at);
        if constexpr (IsJoint<M>::value) {
            r = M::eval_pdf(params, wi, wo, transport);
            return;
        } else {
            r.pdf = M::pdf(params, wi, wo);
        }
        if constexpr (Smooth)
            r.f = eval_model<M>(params, wi, wo, IntOf<F>(0), transport);
        else
            r.f = uniform_spectrum(F(0));
    }

    TR_HD static void sample(const Parameters &at, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2,
                             Transport transport, BsdfSample<F> &sample, Spectrum<F> &f) {
        auto params = unpack<M>(at);
        constexpr bool chooses = M::model.is(ChoosesLobe);
        if constexpr (IsJoint<M>::value) {
            static_assert(chooses && Smooth, "numbers are there for those who say that they take them");
            Vec3<F> wo = M::sample(params, wi, u0, u1, u2, transport);
            BsdfValue<F> value = M::eval_pdf(params, wi, wo, transport);
            sample = {wo, value.pdf, F(1), IntOf<F>(0), MaskOf<F>(false)};
            f = value.f;
        } else {
            // (what is not declared is not drawn, and shows)
            const F none(NAN);
            sample = M::sample(params, wi, chooses ? u0 : none, Smooth ? u1 : none, Smooth ? u2 : none);
            f = eval_model<M>(params, wi, sample.wo, sample.lobe, transport);
        }
    }

    TR_HD static void vjp(const Parameters &at, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &lobe,
                          Transport transport, const Spectrum<F> &a, const Spectrum<F> &R, BsdfNeeds needs,
                          BsdfDerivative<F> &r) {
        using Blocks = VariableBlocks<M>;
        bool evaluated = false;
        if constexpr (Blocks::N > 0) {
            for (int first = 0; first < Blocks::N; first += Blocks::Size)
                if (needs.variables & Blocks::bits(first))
                    by_block(at, first, wi, wo, lobe, transport, a, R, r), evaluated = true;
        }
        if (!evaluated) r.f = eval_model<M>(unpack<M>(at), wi, wo, lobe, transport);
        if (needs.directions) by_directions(at, wi, wo, lobe, transport, a * R, r);
    }

    TR_HD static void direction_vjp(const Parameters &at, const Vec3<F> &wi, const IntOf<F> &lobe,
                                    const Vec3<F> &wo_bar, Vec3<F> &wi_bar, F *number_bar) {
        if constexpr (Delta) {
            constexpr BsdfInfo info = bsdf_info<M>();
            constexpr int Numbers = count_fields(M::model, Kind::Float);
            static_assert(Numbers == 0 || Numbers == info.n_numbers, "what turns delta lobes comes first");
            // (that colour's first component stands for the number that other models have)
            constexpr bool by_color = info.turned_by >= 0;
            constexpr int N = by_color ? 1 : Numbers,
                          First = SpectrumSize * (by_color ? color_of(info, info.turned_by) : info.n_colors);
            using D = Dual<F, 3 + N>;
            Params<D, 0, N> numbers;
            for (int i = 0; i < N; ++i) numbers.number[i] = D(at.number[First + i], 3 + i);
            Vec3<D> to = M::direction(numbers, Vec3<D>{D(wi.x, 0), D(wi.y, 1), D(wi.z, 2)}, lobe);
            auto chain = [&](int i) { return to.x.d[i] * wo_bar.x + to.y.d[i] * wo_bar.y + to.z.d[i] * wo_bar.z; };
            wi_bar = wi_bar + Vec3<F>{chain(0), chain(1), chain(2)};
            for (int i = 0; i < N; ++i) number_bar[i] = chain(3 + i);
        }
    }

private:
    TR_INLINE static void by_block(const Parameters &at, int first, const Vec3<F> &wi, const Vec3<F> &wo,
                                   const IntOf<F> &lobe, Transport transport, const Spectrum<F> &a,
                                   const Spectrum<F> &R, BsdfDerivative<F> &r) {
        constexpr int N = VariableBlocks<M>::N, Block = VariableBlocks<M>::Size;
        auto f = eval_model<M>(seed<M>(at, first), wi, wo, lobe, transport);
        for (int c = 0; c < SpectrumSize; ++c) r.f[c] = f[c].v;
        for (int i = 0; i < Block && first + i < N; ++i)
            for (int c = 0; c < SpectrumSize; ++c)
                r.by_variable[VariableBlocks<M>::variable_at(first + i)][c] = f[c].d[i] * R[c] * a[c];
    }

    TR_INLINE static void by_directions(const Parameters &at, const Vec3<F> &wi, const Vec3<F> &wo,
                                        const IntOf<F> &lobe, Transport transport, const Spectrum<F> &weight,
                                        BsdfDerivative<F> &r) {
        constexpr int N = Smooth ? 6 : 3;  // delta lobes do not ask for wo
        using D = Dual<F, N>;
        Vec3<D> from{D(wi.x, 0), D(wi.y, 1), D(wi.z, 2)}, to = convert<D>(wo);
        if constexpr (Smooth) to = {D(wo.x, 3), D(wo.y, 4), D(wo.z, 5)};
        Spectrum<D> f = eval_model<M>(unpack<M>(at), from, to, lobe, transport);
        F sum[6] = {F(0), F(0), F(0), F(0), F(0), F(0)};
        for (int i = 0; i < N; ++i) {
            sum[i] = f[0].d[i] * weight[0];
            for (int c = 1; c < SpectrumSize; ++c) sum[i] = fmadd(f[c].d[i], weight[c], sum[i]);
        }
        r.wi_bar = {sum[0], sum[1], sum[2]};
        r.wo_bar = {sum[3], sum[4], sum[5]};
    }
};

template <class M, class F>
TR_DEVICE_CONSTEXPR BsdfKernels<F> bsdf_kernels_of() {
    using K = KernelsOf<M, F>;
    return {bsdf_info<M>(), &K::eval_pdf, &K::sample, TR_OF_DERIVATIVES(&K::vjp),
            K::Delta ? TR_OF_DERIVATIVES(&K::direction_vjp) : nullptr};
}

}  // namespace tr

// The table of a model, for the arithmetics of this build.
#define TR_BSDF_FOR(S, M) template BsdfKernels<PacketOf<S>> bsdf_kernels_of<M, PacketOf<S>>();
#define TR_BSDF(M) TR_FOR_EACH_PRECISION_OF(TR_BSDF_FOR, M)
