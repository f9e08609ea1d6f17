// What integrators know of a BSDF: a table of functions on packets. Each model is one translation unit that fills in
// such a table (kernels.h); the registry lists them. Directions are local: +z is the shading normal, x and y are any
// two axes unless the model FollowsTangent; wi points to where the path came from, wo along the new ray, both away from
// the surface. Radiance is transported along wo -> wi. Values include |cos(theta_o)|.
#pragma once

#include "../color/spectrum.h"
#include "../math/polarization.h"
#include "../model.h"

namespace tr {

enum class Transport { Radiance, Importance };  // of importance wi is where light comes from

// Lobes of a model that disperses, beside lobe 0, which reflects: of three wavelengths the first goes on, for all of
// them; the one that is left; or all, where components are no wavelengths.
constexpr int32_t RefractsFirst = 1, RefractsSingle = 2, RefractsAll = 3;

template <class F>
struct BsdfSample {
    Vec3<F> wo;
    F pdf;            // density, or the probability of a delta lobe; 0: the sample failed
    F eta;            // index of refraction along wo over that along wi
    IntOf<F> lobe;    // 0 is the smooth part of a model that has one
    MaskOf<F> delta;  // a delta lobe
};

// What a record's continuous fields are at a point: first the colours, in the order of their fields, then the numbers,
// then the luminance of a colour if the model asks for it. Behind them the choices, and where the host's table for a
// model that is tabulated begins.
template <class F>
struct BsdfParameters {
    static constexpr int MaxNumbers = 24, MaxChoices = 2;
    F number[MaxNumbers];
    IntOf<F> choice[MaxChoices];
    const ScalarOf<F> *table;
    IntOf<F> row;
    IntOf<F> refraction;  // of a model that disperses: the lobe by which this path is refracted
};

// A model's declaration as the loops over its fields need it. Variables of derivatives are the continuous fields that
// have one, which come first, and then the luminance.
struct BsdfInfo : ModelInfo {
    static constexpr int MaxFields = 16, MaxVariables = MaxFields + 1;
    enum Use : uint8_t { Color, Number, Luminance };  // of a texture; of a number; of a texture's luminance
    Use use[MaxFields];
    int n_continuous, n_differentiable, n_variables, n_colors, n_numbers, n_choices;
    int luminance_of;  // the field whose luminance is a further number, -1: none
    bool tabulated;
    int turned_by;  // the field of a model that disperses, a colour, whose components refract, or -1
    Polarization polarizes;
    int eta, k, theta;                // the fields by which it does, -1: none; `eta` is a retarder's retardance
    bool bent;                        // the number is not the record's, see medium/bend_medium.h
    int albedo, specular, roughness;  // the fields that these outputs show, -1: none
    int tangent_of;  // the field, a texture, without which a model that follows the tangent does not, -1: it always
                     // does
};

// f of a smooth lobe and the density of sampling wo.
template <class F>
struct BsdfValue {
    Spectrum<F> f;
    F pdf;
};

// What of a derivative is wanted: by which variables, a bit each, and whether by both directions.
struct BsdfNeeds {
    static constexpr uint32_t All = 0xffffffffu;
    uint32_t variables;
    bool directions;
};

// The value f and, with a row a and a column R of spectra, the derivatives of the number a f R: by each variable, apart
// by components of the spectrum, and by both directions. What is not wanted may not be written.
template <class F>
struct BsdfDerivative {
    Spectrum<F> f;
    Spectrum<F> by_variable[BsdfInfo::MaxVariables];
    Vec3<F> wi_bar, wo_bar;

    TR_HD void clear(int n_variables) {
        const Spectrum<F> black = uniform_spectrum(F(0));
        f = black, wi_bar = wo_bar = Vec3<F>{F(0), F(0), F(0)};
        for (int i = 0; i < n_variables; ++i) by_variable[i] = black;
    }
};

template <class F>
struct BsdfKernels : BsdfInfo {
    using Parameters = BsdfParameters<F>;

    void (*eval_pdf)(const Parameters &, const Vec3<F> &wi, const Vec3<F> &wo, Transport, BsdfValue<F> &);
    // A direction, and f of the lobe it belongs to: of a delta lobe its weight times the probability of choosing it.
    void (*sample)(const Parameters &, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2, Transport,
                   BsdfSample<F> &, Spectrum<F> &f);
    void (*vjp)(const Parameters &, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &lobe, Transport,
                const Spectrum<F> &a, const Spectrum<F> &R, BsdfNeeds, BsdfDerivative<F> &);
    // Where a delta lobe sends wi is a function of wi and the numbers, or of the first component of the colour
    // `turned_by`: adds to the adjoint of wi and gives those of the numbers. Null without delta lobes.
    void (*direction_vjp)(const Parameters &, const Vec3<F> &wi, const IntOf<F> &lobe, const Vec3<F> &wo_bar,
                          Vec3<F> &wi_bar, F *number_bar);
};

}  // namespace tr
