// What a path tracer is told, and the random numbers of its paths.
#pragma once

#include "../color/spectral.h"
#include "../sampler/sobol.h"
#include "../sampler/stratified.h"

namespace tr {

struct PathConfig {
    int32_t max_depth;        // vertices whose emission counts; -1: unlimited
    int32_t rr_depth;         // Russian roulette after this many scatterings
    bool hide_emitters;       // the camera does not see lights
    int32_t emitter_samples;  // at the first vertex: 1 and 1 for the path tracer,
    int32_t bsdf_samples;     // others for direct illumination, which stops at the second vertex
    uint64_t seed;
    uint32_t sensor;
    SamplerConfig sampler;
    TR_FACT(bool, volumetric, TR_VOLUMETRIC);  // through media
    SpectralConfig spectral{};
    TR_FACT(bool, stokes, false) = false;  // polarised light: paths are recorded, see adjoint/polarization.h
};

// What of a scene brought a value that is not finite.
enum class Culprit : uint32_t { None, Emitter, Environment, Bsdf, Medium };

// Blocks of random numbers of a path. Block 0 is the camera's: the place on the film and on the lens; of light paths
// the place on the emitter. Scattering j takes block 1 + 2 j (an emitter: 3 numbers, roulette: 1) and 2 + 2 j (a BSDF:
// 3 numbers, the choice in its stack: 1). Of light paths block 1 chooses the emitter and the direction besides.
constexpr uint32_t EmitterBlock = 1, BsdfBlock = 2, BlocksPerScattering = 2, EmissionBlock = 1;

// Those of volumetric paths besides: blocks far from the others, `BlocksPerSegment` a segment. The first one seeds free
// flight (two words) and holds the number by which a segment is chosen for the derivative; the others seed the shadow
// rays of the segment's end and of its differential sample. One block a path chooses the component that distances are
// sampled for.
constexpr uint32_t ChannelBlock = 0x3FFFFFFFu, SegmentBlock = 0x40000000u, BlocksPerSegment = 3;
// The path that goes on from a differential sample is numbered like segments that no path reaches.
constexpr uint32_t BranchLevel = 0x00100000u;

enum class ShadowPurpose : uint32_t { Vertex = 0, Differential = 1 };

// The numbers of a block of a sample that are wanted. Two of them, a pair, are a point in the plane: the first two of
// the camera's (on the film), the second and third of the others (on a light, or of a direction), whose first one
// chooses (a light, a lobe).
template <class F>
class PathNumbers {
    using U = UIntOf<F>;

public:
    U pixel, sample;

    // `keys`: of Sobol' points, if the samples are of a batch that has them.
    TR_INLINE PathNumbers(const PathConfig &config, const U &pixel, const U &sample, const CommonKeys *keys = nullptr)
        : pixel(pixel), sample(sample), config_(config), keys_(keys) {
        if (config.sampler.kind == SamplerKind::Sobol) place_ = SobolPlace<U>(config.sampler, pixel, sample);
    }

    TR_INLINE Random4<F> draw(uint32_t block, uint32_t wanted) const {
        const SamplerConfig &sampler = config_.sampler;
        if (wanted == 0) return Random4<F>{};
        if (sampler.kind == SamplerKind::Independent)
            return random4<F>(config_.seed, config_.sensor, pixel, sample, block);
        Random4<F> r = sampler.kind == SamplerKind::Sobol
                           ? sobol4<F>(sampler, config_.seed, config_.sensor, place_, block, wanted,
                                       keys_ ? (*keys_)(block) : nullptr)
                           : stratified4<F>(sampler, config_.seed, config_.sensor, pixel, sample, block, wanted);
        return block == 0 ? r : Random4<F>{{r.u[2], r.u[0], r.u[1], r.u[3]}};
    }

private:
    const PathConfig &config_;
    const CommonKeys *keys_;
    SobolPlace<U> place_;
};

// The wavelengths of a sample. Of colours in rgb there is nothing to choose.
template <class F>
TR_INLINE ChosenWavelengths<F> chosen_wavelengths(const PathConfig &config, const UIntOf<F> &pixel,
                                                  const UIntOf<F> &sample) {
    return choose_wavelengths<F>(config.spectral, config.seed, config.sensor, pixel, sample);
}
// The same with how colours at them become the film's channels; in rgb they are these.
template <class F>
struct SampleColors {
    ChosenWavelengths<F> chosen;
    SpectralConfig config;

    TR_INLINE SampleColors(const PathConfig &of, const UIntOf<F> &pixel, const UIntOf<F> &sample)
        : config(of.spectral) {
        if (config.positions) chosen = chosen_wavelengths<F>(of, pixel, sample);
    }
    TR_INLINE const Wavelengths<F> &waves() const { return chosen.waves; }
    TR_INLINE Spectrum<F> channels(const Spectrum<F> &x) const {
        return config.positions ? FilmWeights<F>(config, chosen).channels(x) : x;
    }
    TR_INLINE Spectrum<F> pull(const Spectrum<F> &g) const {
        return config.positions ? FilmWeights<F>(config, chosen).pull(g) : g;
    }
};

template <class F>
TR_INLINE Wavelengths<F> wavelengths_of(const PathConfig &config, const UIntOf<F> &pixel, const UIntOf<F> &sample) {
    return config.spectral.positions ? chosen_wavelengths<F>(config, pixel, sample).waves : Wavelengths<F>{};
}

}  // namespace tr
