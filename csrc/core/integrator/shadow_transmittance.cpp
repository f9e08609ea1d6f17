#include "shadow_transmittance.h"

namespace tr {

template <class F>
TR_LARGE void seed_shadow_rays(const PathContext<F> &c, const ShadowQueue<ScalarOf<F>> &shadows,
                               const TransmittanceColumns<ScalarOf<F>> &at, uint32_t level, uint32_t round,
                               const UIntOf<F> &id, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    Gathered<F> ray(id, active);
    Gathered<F> sample(ray(shadows.slot), active);
    U block = U(SegmentBlock + BlocksPerSegment * level + 1u) + ray(shadows.purpose);
    auto random = random_bits4<F>(c.config.seed, c.config.sensor + (round << 16), sample(c.slots.pixel),
                                  sample(c.slots.sample), block);
    scatter_lanes<F>(at.seed_a.at, id, random.bits[0] | U(1u), active);
    scatter_lanes<F>(at.seed_b.at, id, random.bits[1], active);
    scatter_lanes<F>(at.choice.at, id, uniform_of<F>(random.bits[2]), active);
    scatter_lanes<F>(at.place.at, id, uniform_of<F>(random.bits[3]), active);
}

template <class F>
TR_LARGE MaskOf<F> cross_boundary(const PathContext<F> &c, const ShadowQueue<ScalarOf<F>> &shadows,
                                  const TransmittanceColumns<ScalarOf<F>> &at, const SurfacePoint<F> &hit, const F &t,
                                  const UIntOf<F> &id, const MaskOf<F> &active) {
    Gathered<F> from(id, active);
    Ray<F> ray{from(shadows.o), from(shadows.d)};
    Interaction<F> si = hit_interaction(c, ray, hit, t, active);
    // straight on: beside this line the light's own edge may be in the way
    F ahead = offset_along(si.p, si.ng, ray.d), length = from(shadows.length) - t - ahead;
    Vec3<F> o = ray.o + ray.d * (t + ahead);
    IntOf<F> medium = medium_behind(c.scene, si.at.shape, si.ng, ray.d, from(shadows.medium), active);
    auto put = [&](auto *column, const auto &value) { scatter_lanes<F>(column, id, value, active); };
    put(shadows.o.x, o.x), put(shadows.o.y, o.y), put(shadows.o.z, o.z);
    put(shadows.length.at, length);
    put(shadows.ray_offset.at, ahead);
    put(shadows.medium.at, medium);
    Spectrum<F> through = from(at.transmittance);
    MaskOf<F> lit(false);
    for (int k = 0; k < SpectrumSize; ++k) lit = lit || mask<F>(through[k] > F(0));
    return active && lit && mask<F>(length > F(0));
}

#define TR_INSTANTIATE(F, S)                                                                                           \
    template void seed_shadow_rays(const PathContext<F> &, const ShadowQueue<S> &, const TransmittanceColumns<S> &,    \
                                   uint32_t, uint32_t, const UIntOf<F> &, const MaskOf<F> &);                          \
    template MaskOf<F> cross_boundary(const PathContext<F> &, const ShadowQueue<S> &, const TransmittanceColumns<S> &, \
                                      const SurfacePoint<F> &, const F &, const UIntOf<F> &, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
