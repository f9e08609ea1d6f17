// The sweep over the path tape: a packet of vertices, from the tape to the gradients and to the vertices before.
#pragma once

#include "light.h"
#include "medium.h"

namespace tr {

template <class F>
struct SweepContext {
    using S = ScalarOf<F>;
    const SceneView<S> &scene;
    const PathConfig &config;
    const SlotColumns<S> &slots;
    const GradientNeeds &needs;
    S width, height;                             // of the film
    const BranchColumns<S> *branches = nullptr;  // of media, where there are any
    bool unit_adjoint = false;                   // the radiance itself is differentiated, in all components
    bool from_camera = true;                     // paths begin there
    // of polarised light: where columns go that have arrived at the beginning, if not to the slots; null: nowhere
    const BranchColumns<S> *columns_to = nullptr;
    bool to_slots = true;
};

// A vertex of a camera path; kind as in classify.h, `scatters`: not the last one. `parents`: the level that the
// vertices before are on; null: there are none, or they are not on the tape. `level` is the number of this one. Returns
// the radiance at the vertex, which the one before receives.
template <class F>
TR_LARGE Spectrum<F> sweep_vertex(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                  const TapeColumns<ScalarOf<F>> *parents, uint32_t level, int kind, bool scatters,
                                  uint32_t i, const MaskOf<F> &active, GradientSink<F> &sink);

// The place alone of a vertex that a smooth BSDF's or the camera's ray has found: hands its adjoint `p_bar`, with those
// of places behind it, to what moves it, the vertex before included. Directions after smooth BSDFs are at rest. Returns
// the adjoint of the ray's origin.
template <class F>
TR_LARGE Vec3<F> sweep_place(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                             const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                             const Vec3<F> &p_bar, const MaskOf<F> &active, GradientSink<F> &sink);

// A vertex of a light path, or its beginning.
template <class F>
TR_LARGE void sweep_light_vertex(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                                 const TapeColumns<ScalarOf<F>> &tape, const TapeColumns<ScalarOf<F>> *parents,
                                 int kind, uint32_t i, const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
