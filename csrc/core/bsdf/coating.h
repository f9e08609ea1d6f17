// What smooth and rough coatings over a diffuse base share.
#pragma once

#include "../color/spectrum.h"

namespace tr {

// What a coating does to the diffuse base below it: light that the interface throws back into the coat meets the base
// again and again. `reflectance` is the base's, `internal` the interface's for diffuse light from below; with
// `nonlinear`, colours deepen with every further reflection, else each is as grey as the first.
template <class T, class M>
TR_INLINE T coated_albedo(const T &reflectance, const T &internal, const M &nonlinear) {
    return reflectance / (T(1) - select(nonlinear, reflectance * internal, internal));
}

// The chance with which the interface's lobe is sampled, of which the share of light is r: in proportion to the largest
// channels, but both lobes with a chance, since what is black has a derivative too.
template <class F>
TR_INLINE F specular_sampling_weight(const F &r, const Spectrum<F> &specular, const Spectrum<F> &diffuse) {
    F coat = r * max_component(specular), base = (F(1) - r) * max_component(diffuse), sum = coat + base;
    auto some = mask<F>(sum > F(0));
    return min(max(select(some, coat / select(some, sum, F(1)), F(0.5)), F(0.1)), F(0.9));
}

}  // namespace tr
