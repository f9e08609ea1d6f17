// `circular`: an ideal circular polariser of what a plate lets through.
#include "plate.h"

namespace tr {

struct CircularPolarizer : PassingPlate<CircularPolarizer> {
    static constexpr Field fields[] = {
        {"transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is ideal"},
        {"left_handed", Kind::Int, 0, 0, 1, "", "whether it lets left circular light pass, else right", Boolean},
    };
    static constexpr int Transmittance = color_index(fields, "transmittance");
    static constexpr Model model = {"bsdf", "circular", "Circular polariser.", fields, 2, Flags, "CircularPolarizer"};
    static constexpr Polarization Polarizes = Polarization::Circular;

    template <class P>
    TR_INLINE static auto passed(const P &params) {
        using T = std::decay_t<decltype(params.color[0][0])>;
        return params.color[Transmittance] * T(0.5);
    }
};

TR_BSDF(CircularPolarizer)

}  // namespace tr
