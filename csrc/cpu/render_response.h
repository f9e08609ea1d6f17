// The derivative of an image by what wavelengths add to the film's channels, the densities of wavelengths being given.
#pragma once

#include <vector>

#include "core/color/spectral.h"
#include "render.h"

namespace tr {

// The gradient by (SpectrumSamples, 3) weights, of a thread.
class ResponseSums {
public:
    ResponseSums() : sums_(size_t(SpectrumSamples) * SpectrumSize, 0.0) {}

    // What a path brings at its wavelengths, value(c), for the adjoints of channels, adjoint(j).
    template <class S, class Adjoint, class Value>
    void add(const ChosenWavelengths<S> &chosen, Adjoint &&adjoint, Value &&value) {
        for (int c = 0; c < SpectrumSize; ++c) {
            const TablePlace<S> place(chosen.waves.at[c]);
            const double at = double(value(c)) * double(chosen.inverse[c]), fraction = double(place.fraction);
            double *to = sums_.data() + size_t(place.index) * SpectrumSize;
            for (int j = 0; j < SpectrumSize; ++j) {
                const double g = double(adjoint(j)) * at;
                to[j] += g * (1 - fraction), to[SpectrumSize + j] += g * fraction;
            }
        }
    }
    void add_to(double *gradient) const {
        for (size_t i = 0; i < sums_.size(); ++i) gradient[i] += sums_[i];
    }

private:
    std::vector<double> sums_;
};

// Of an image with bands (SpectralConfig::weights), for the adjoint (n, numbers) of its pixels: added to `gradient`
// (SpectrumSamples, 3). (An image is linear in these weights: along a tangent its derivative is the image with that in
// their place.)
template <class S>
RenderStats response_reverse(const RenderCall<S> &call, const S *adjoint, double *gradient);
// The same of light paths.
template <class S>
RenderStats trace_light_responses(const RenderCall<S> &call, const S *adjoint, double *gradient);

}  // namespace tr
