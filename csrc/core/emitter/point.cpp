// `point`: radiates equally in all directions from a point.
#include "delta_position.h"

namespace tr {

struct PointEmitter {
    static constexpr bool HasFrame = false;
    static constexpr Field fields[] = {
        {"intensity", Kind::Spectrum, 1, 0, INFINITY, "interior", "radiant intensity, W / sr"},
        {"position", Kind::Point, 0, -INFINITY, INFINITY,
         "interior, without shadow edges that are seen in mirrors or through glass; zero where there are none",
         "where it is, world space"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
        {"stokes", Kind::Vector, 0, -1, 1, "interior",
         "(3,) Q, U and V of the light's Stokes vector over I, Q along the world's x axis across the ray", nullptr,
         Optional},
    };
    static constexpr int ColorField = field_index(fields, "intensity"), PlaceField = field_index(fields, "position");
    static constexpr int Numbers = 0;
    static constexpr Model model = {"emitter", "point", "A point light.", fields, 4, HasDeltaPosition, "PointLight"};

    template <class F>
    TR_INLINE static Vec3<F> sample(const F (&)[1], const F &u1, const F &u2, F &inverse_pdf) {
        inverse_pdf = F(4 * Pi);
        return square_to_sphere(u1, u2);
    }
};

template <class F>
using PointLight = DeltaPosition<PointEmitter, F>;
TR_EMITTER(PointEmitter, PointLight)

}  // namespace tr
