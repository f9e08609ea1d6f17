// One model of a scene at a time, by the functions that integrators call: what `torchrender.testing` hands to
// statistical tests.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "accel/accel.h"
#include "core/adjoint/gradient_sink.h"

namespace tr {

template <class S>
struct Probe {
    const SceneView<S> &scene;
    const Accel &accel;
    int channels;                                    // of colours
    const std::map<std::string, uintptr_t> &arrays;  // by name

    S *at(const char *name) const { return reinterpret_cast<S *>(arrays.at(name)); }

    // value (n, channels) with the cosine, density (n,) of the smooth part, of directions wi, wo and coordinates uv
    void bsdf(int index, size_t n) const;
    // direction (n, 3), weight = value / density (n, channels), density or probability (n,), relative index (n,),
    // whether the lobe is a delta (n,), from uniform numbers u
    void bsdf_sample(int index, size_t n) const;
    // direction (n, 3), distance, density per solid angle (n,), radiance that would arrive (n, channels) at p
    void emitter_sample(size_t n) const;
    // density with which emitter sampling at p takes the direction d (of what a ray from there meets first), and the
    // radiance that arrives
    void emitter_pdf(size_t n) const;
    // value (n,) at p of light that travels along d and goes on along wo
    void phase(int index, size_t n) const;
    // wo (n, 3) from uniform numbers u
    void phase_sample(int index, size_t n) const;
    // Hands every row to the sink with the adjoint g (n, channels); in forward mode its derivative is written.
    void phase_sweep(int index, size_t n, GradientSink<PacketOf<S>> &sink) const;
};

}  // namespace tr
