// Compiled once for all who look up spectra.
#include "spectral.h"

namespace tr {

#define TR_INSTANTIATE(S)                                                                                      \
    template ChosenWavelengths<PacketOf<S>> choose_wavelengths<PacketOf<S>>(                                   \
        const SpectralConfig &, uint64_t, uint32_t, const UIntOf<PacketOf<S>> &, const UIntOf<PacketOf<S>> &); \
    template Spectrum<PacketOf<S>> table_spectrum(const S *, const Wavelengths<PacketOf<S>> &,                 \
                                                  const UIntOf<PacketOf<S>> &, const MaskOf<PacketOf<S>> &);   \
    template Spectrum<PacketOf<S>> sigmoid_texels(const S *, const S *, const Wavelengths<PacketOf<S>> &,      \
                                                  const UIntOf<PacketOf<S>> *, const PacketOf<S> *, int,       \
                                                  const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
