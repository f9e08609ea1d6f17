// `polarizer`: an ideal linear polariser of what a plate lets through.
#include "plate.h"

namespace tr {

struct Polarizer : PassingPlate<Polarizer> {
    static constexpr Field fields[] = {
        {"theta", Kind::Scalar, 0, -INFINITY, INFINITY, "interior",
         "angle of the axis that passes, in degrees from dp/du away from dp/dv"},
        {"transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is ideal"},
    };
    static constexpr int Transmittance = color_index(fields, "transmittance");
    static constexpr Model model = {"bsdf", "polarizer", "Linear polariser.", fields, 2, Flags};
    static constexpr Polarization Polarizes = Polarization::Polarizer;

    template <class P>
    TR_INLINE static auto passed(const P &params) {
        using T = std::decay_t<decltype(params.number[0])>;
        return params.color[Transmittance] * T(0.5);
    }
};

TR_BSDF(Polarizer)

}  // namespace tr
