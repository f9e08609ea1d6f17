// `retarder`: a plate that delays what is polarised across its fast axis.
#include "plate.h"

namespace tr {

struct Retarder : PassingPlate<Retarder> {
    static constexpr Field fields[] = {
        {"theta", Kind::Scalar, 0, -INFINITY, INFINITY, "interior",
         "angle of the fast axis, in degrees from dp/du towards dp/dv"},
        {"delta", Kind::Scalar, 90, -INFINITY, INFINITY, "interior",
         "retardance in degrees: 90 is a quarter-wave plate, 180 a half-wave plate"},
        {"transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is ideal"},
    };
    static constexpr int Transmittance = color_index(fields, "transmittance");
    static constexpr Model model = {"bsdf", "retarder", "Linear retarder.", fields, 3, Flags};
    static constexpr Polarization Polarizes = Polarization::Retarder;

    template <class P>
    TR_INLINE static auto passed(const P &params) {
        return params.color[Transmittance];
    }
};

TR_BSDF(Retarder)

}  // namespace tr
