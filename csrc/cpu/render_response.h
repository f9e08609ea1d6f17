// The derivative of an image by what wavelengths add to the film's channels, the densities of wavelengths being given.
#pragma once

#include "render.h"

namespace tr {

// Of an image with bands (SpectralConfig::weights), for the adjoint (n, numbers) of its pixels: added to `gradient`
// (SpectrumSamples, 3). (An image is linear in these weights: along a tangent its derivative is the image with that in
// their place.)
template <class S>
RenderStats response_reverse(const RenderCall<S> &call, const S *adjoint, double *gradient);

}  // namespace tr
