// Rays under way, as structures of arrays: the samples of a batch, paths (one entry a ray in flight), what their rays
// have hit, and the shadow rays of a step.
#pragma once

#include "columns.h"

namespace tr {

// ----------------------------------------------------------------------------------------------------------- samples
// By sample of a batch, its `slot`: which it is, and where on the film.
// clang-format off
#define TR_SAMPLE_COLUMNS(X) \
    X(Index, pixel) X(Index, row) X(Index, column) X(Index, sample) X(Number, film_x) X(Number, film_y)
// clang-format on

template <class S>
struct SampleColumns {
    TR_COLUMNS(TR_SAMPLE_COLUMNS)
};

// Of paths also the adjoint of their radiance in reverse mode; radiance or, in forward mode, its derivative; whether
// something was seen.
#define TR_SLOT_COLUMNS(X) \
    TR_SAMPLE_COLUMNS(X) X(Spectrum, delta) X(Spectrum, radiance) X(Number, alpha) TR_SLOT_STOKES_COLUMNS(X)
// The same of polarised light, Q, U and V.
#define TR_SLOT_STOKES_COLUMNS(X) \
    X(Spectrum, delta_q) X(Spectrum, delta_u) X(Spectrum, delta_v) X(Spectrum, q) X(Spectrum, u) X(Spectrum, v)

template <class S>
struct SlotColumns {
    TR_COLUMNS(TR_SLOT_COLUMNS)
    PairColumn<S> lens{nullptr, nullptr};  // where on it, if that was not drawn
};

// ------------------------------------------------------------------------------------------------------------- paths
// The ray; what the weight of emission at its end needs (PreviousVertex); throughput, index of refraction relative to
// where the path began, and the throughput that roulette looks at; the sample, the entry of the level before, and
// what was seen already (below).
// clang-format off
#define TR_PATH_COLUMNS(X) \
    X(Vector, o) X(Vector, d) X(Number, length) X(Vector, from) X(Number, pdf) X(Spectrum, beta) X(Number, eta) \
    X(Spectrum, survival) X(Index, slot) X(Index, parent) X(Index, seen)
// clang-format on
// Through media: the medium the ray is in or -1, scatterings so far, the weights of the components' densities where
// extinction is coloured, and how far the ray's origin is ahead of the surface it leaves: the medium begins there.
#define TR_PATH_MEDIUM_COLUMNS(X) X(Integer, medium) X(Index, depth) X(Spectrum, channel) X(Number, ray_offset)
#define TR_PATH_QUEUE_COLUMNS(X) TR_PATH_COLUMNS(X) TR_PATH_MEDIUM_COLUMNS(X)

// Something that is not invisible; dispersion has left the first of the wavelengths alone; a BSDF that is
// differentiated (only where PathContext::bsdfs_alone).
constexpr uint32_t SeenSomething = 1, SingleWave = 2, SeenDifferentiated = 4;

template <class S>
struct PathQueue {
    TR_COLUMNS(TR_PATH_QUEUE_COLUMNS)
    uint32_t n = 0;
};

TR_PACKET(PathState, TR_PATH_COLUMNS)
TR_PACKET(PathMedium, TR_PATH_MEDIUM_COLUMNS)

// -------------------------------------------------------------------------------------------------------------- hits
// By entry of a path queue: what its ray has met, `shape` being NoHit, or MediumHit where it collided in a medium.
constexpr uint32_t NoHit = 0xFFFFFFFFu, MediumHit = 0xFFFFFFFEu;
#define TR_HIT_COLUMNS(X) X(Point, at) X(Number, t)

// Whether a camera ray that has hit this shape goes on behind it, where emitters are hidden; and how often at most.
template <class S>
TR_INLINE bool passes_emitter(const SceneView<S> &scene, uint32_t shape) {
    return shape != NoHit && scene.shapes[shape].emitter >= 0;
}
constexpr int MostPasses = 256;

template <class S>
struct HitColumns {
    TR_COLUMNS(TR_HIT_COLUMNS)
};

// By entry of a path queue, and on the tape: of rays through media that bend them the last step but one that is whole,
// as the bits of the state's integers (medium/bend.h), how much of a step is left from there to the hit, the steps
// before it, the length of all, and the medium; -1: the ray is straight. Also the path's throughput where the ray
// began, its optical depth, and what the medium emits along it, as it comes out there.
// clang-format off
#define TR_BENT_COLUMNS(X) \
    X(Vector, q) X(Vector, u) X(Number, rest) X(Index, steps) X(Number, length) X(Integer, medium) \
    X(Spectrum, begin) X(Spectrum, depth) X(Spectrum, emitted)
// clang-format on

template <class S>
struct BentColumns {
    TR_COLUMNS(TR_BENT_COLUMNS)
};
TR_PACKET(BentPacket, TR_BENT_COLUMNS)

// ------------------------------------------------------------------------------------------------------- shadow rays
// Rays to emitters, and of light paths to the camera: the ray, the sample, the entry of the tape's level, and what
// they bring if nothing is in the way.
#define TR_SHADOW_COLUMNS(X) X(Vector, o) X(Vector, d) X(Number, length) X(Index, slot) X(Index, position)
#define TR_SHADOW_VALUE_COLUMNS(X) X(Spectrum, contribution)
// Through media: as of paths; and what for, see ShadowPurpose.
#define TR_SHADOW_MEDIUM_COLUMNS(X) X(Integer, medium) X(Number, ray_offset) X(Index, purpose)
// Connections: the place on the film.
#define TR_SHADOW_FILM_COLUMNS(X) X(Number, film_x) X(Number, film_y)
// clang-format off
#define TR_SHADOW_QUEUE_COLUMNS(X) \
    TR_SHADOW_COLUMNS(X) TR_SHADOW_VALUE_COLUMNS(X) TR_SHADOW_MEDIUM_COLUMNS(X) TR_SHADOW_FILM_COLUMNS(X)
// clang-format on

template <class S>
struct ShadowQueue {
    TR_COLUMNS(TR_SHADOW_QUEUE_COLUMNS)
    uint32_t n = 0;
};

TR_PACKET(ShadowRay, TR_SHADOW_COLUMNS)
TR_PACKET(ShadowValue, TR_SHADOW_VALUE_COLUMNS)
TR_PACKET(ShadowMedium, TR_SHADOW_MEDIUM_COLUMNS)
TR_PACKET(ShadowFilm, TR_SHADOW_FILM_COLUMNS)

// ------------------------------------------------------------------------------------------------------------- media
// By entry of a path queue. In: the ray up to `end` (from `ray_offset` before its origin), seeds of its random numbers,
// and the component that distances are sampled for. Out: where the medium begins, the length of the segment in it,
// whether it ends with a collision, and the shape behind. Where they are asked for two points uniform on the segment,
// as distances: the differential sample, for derivatives of the extinction, and one for emission. Coloured extinction:
// weights up to the end and up to these points, see medium/tracking.h; the throughput at the beginning, and the weights
// of the densities at the differential sample.
// clang-format off
#define TR_FLIGHT_COLUMNS(X) \
    X(Number, end) X(Index, seed_a) X(Index, seed_b) X(Index, hero) X(Number, choice) X(Number, start) \
    X(Number, length) X(Index, collided) X(Index, behind) X(Number, differential) X(Number, emission) X(Spectrum, weight) \
    X(Spectrum, differential_weight) X(Spectrum, emission_weight) X(Spectrum, first) \
    X(Spectrum, differential_channel)
// clang-format on

template <class S>
struct FlightColumns {
    TR_COLUMNS(TR_FLIGHT_COLUMNS)
};

// By slot. The component that a path samples distances for; and of the path that goes on from one of its segments'
// differential samples: which one, the sum of the weights by which it was chosen, where the path begins, and in the end
// what it brought. Of polarised light that is the column which arrives there along -wo, `radiance` its intensity, and
// `factor` is what it is multiplied with on its way through the sample and the segment's beginning.
// clang-format off
#define TR_BRANCH_COLUMNS(X) \
    X(Index, hero) X(Index, level) X(Index, entry) X(Number, total_weight) X(Vector, p) X(Vector, d) \
    X(Integer, medium) X(Index, depth) X(Spectrum, beta) X(Spectrum, channel) X(Spectrum, radiance) \
    X(Vector, wo) X(Spectrum, factor) X(Spectrum, q) X(Spectrum, u) X(Spectrum, v) X(Vector, axis)
// clang-format on

template <class S>
struct BranchColumns {
    TR_COLUMNS(TR_BRANCH_COLUMNS)
};

// By entry of a shadow queue. In: the part of the ray in front of what it has met, seeds, and two uniform numbers. Out:
// its transmittance, which multiplies what is there; where it is in the medium, and how long; of all parts so far the
// length in media, and a point uniform on them with its medium. Where something moves: the boundary that the part
// begins at, how far from the ray's beginning, and both ends of the part with that point, with their distances.
// clang-format off
#define TR_TRANSMITTANCE_COLUMNS(X) \
    X(Number, end) X(Index, seed_a) X(Index, seed_b) X(Number, choice) X(Number, place) X(Spectrum, transmittance) \
    X(Number, start) X(Number, length) X(Number, total_length) X(Vector, point) X(Integer, point_medium) \
    X(Point, boundary) X(Number, begin) X(Point, part_from) X(Point, part_to) X(Number, part_t0) X(Number, part_t1) \
    X(Number, part_t)
// clang-format on

template <class S>
struct TransmittanceColumns {
    TR_COLUMNS(TR_TRANSMITTANCE_COLUMNS)
};

}  // namespace tr
