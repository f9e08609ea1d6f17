// The functions of one BSDF model by themselves, at points whose parameters are given instead of looked up in a scene:
// what `tr.native_bsdf` is made of.
#pragma once

#include "core/bsdf/bsdf.h"
#include "native_scene.h"

namespace tr {

// `params` has an address for each continuous field: colours (n, channels), numbers (n,). Directions are (n, 3), lobes
// int32 (n,). What is written has the channels that colours have.
class BsdfFunctions {
public:
    virtual ~BsdfFunctions() = default;
    virtual const BsdfInfo &info() const = 0;
    virtual int channels() const = 0;

    // value (n, channels) of the lobe `lobe`, from wi, wo
    virtual void eval(size_t n, const Addresses &params, const Arrays &) const = 0;
    // pdf (n,) of the smooth lobe, from wi, wo
    virtual void pdf(size_t n, const Addresses &params, const Arrays &) const = 0;
    // wo, pdf (n,), eta (n,), lobe (n,), delta (n,) uint8, and the value of that lobe, from wi and u (n, 3)
    virtual void sample(size_t n, const Addresses &params, const Arrays &) const = 0;
    // Derivatives of the value: by_wi and by_wo (n, channels, 3), together, where they are given; `by_variable` (n,
    // channels) those by the model's variables (bsdf.h), of a colour by the component of that channel; 0: not wanted.
    virtual void eval_derivative(size_t n, const Addresses &params, const Arrays &,
                                 const Addresses &by_variable) const = 0;
    // Derivatives of where the delta lobe `lobe` sends wi: by_wi (n, 3, 3), by_number (n, 3, numbers).
    virtual void direction_derivative(size_t n, const Addresses &params, const Arrays &) const = 0;
};

// Of the model `type`; channels of colours: 1 or 3; dtype: as of make_scene.
std::unique_ptr<BsdfFunctions> make_bsdf_functions(const std::string &type, const std::string &dtype, int channels,
                                                   const std::vector<int32_t> &choices);

}  // namespace tr
