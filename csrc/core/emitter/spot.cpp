// `spot`: a cone of light along +z of its frame. Its intensity is constant within `beam_width` of the axis and falls
// linearly, in the angle, to zero at `cutoff_angle`. The texture is looked up where directions meet the plane z = 1 of
// the frame, of which the square around the cone of the cutoff is the square of its coordinates.
#include "delta_position.h"

namespace tr {

struct SpotEmitter {
    static constexpr bool HasFrame = true;
    static constexpr const char *Rim =
        "interior, without the motion of the cone's edge; zero unless beam_width reaches "
        "cutoff_angle";
    static constexpr Field fields[] = {
        {"intensity", Kind::Spectrum, 1, 0, INFINITY, "interior", "radiant intensity along the axis, W / sr"},
        {"cutoff_angle", Kind::Float, 20, 0, 180, Rim, "angle between the axis and the end of the light, degrees"},
        {"beam_width", Kind::Float, None, 0, 180, Rim,
         "angle between the axis and where the intensity begins to fall, degrees; 3/4 of cutoff_angle"},
        {"texture", Kind::Texture, 1, 0, INFINITY, "interior", "factor of the intensity", nullptr, Optional},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY,
         "interior, without shadow edges that are seen in mirrors or through glass; zero where there are none",
         "the light's frame to the world, no scale; it looks along +z"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
        {"stokes", Kind::Vector, 0, -1, 1, "interior",
         "(3,) Q, U and V of the light's Stokes vector over I, Q along the x axis of to_world across the ray", nullptr,
         Optional},
    };
    static constexpr int ColorField = field_index(fields, "intensity"), PlaceField = field_index(fields, "to_world");
    static constexpr int TextureField = field_index(fields, "texture"), Numbers = 2, Differentiable = 2;
    static constexpr std::array NumberFields{field_index(fields, "cutoff_angle"), field_index(fields, "beam_width")};
    static constexpr Model model = {"emitter", "spot", "A spot light.", fields, 7, HasDeltaPosition, "SpotLight"};

    template <class T, int N>
    TR_INLINE static Pattern<T> pattern(const Vec3<T> &d, const T (&number)[N]) {
        T cutoff = number[0] * T(Pi / 180), beam = number[1] * T(Pi / 180);
        T angle = atan2(sqrt(d.x * d.x + d.y * d.y), d.z), width = cutoff - beam;
        auto falls = mask<T>(angle > beam) && mask<T>(width > T(0));
        Pattern<T> r;
        r.lit = mask<T>(angle < cutoff);
        r.factor = select(falls, (cutoff - angle) / select(falls, width, T(1)), T(1));
        T sine, cosine;
        sincos(cutoff, sine, cosine);
        T below = d.z * sine;
        T scale = T(0.5) * cosine / select(mask<T>(abs(below) > T(1e-6)), below, T(1e-6));
        r.u = T(0.5) + d.x * scale;
        r.v = T(0.5) + d.y * scale;
        return r;
    }

    template <class F, int N>
    TR_INLINE static Vec3<F> sample(const F (&number)[N], const F &u1, const F &u2, F &inverse_pdf) {
        F sine, cosine;
        sincos(number[0] * F(Pi / 360), sine, cosine);
        F one_minus_cos = F(2) * sine * sine;
        inverse_pdf = F(2 * Pi) * one_minus_cos;
        return square_to_cone(u1, u2, one_minus_cos);
    }

    // the integral of the factor: of sin(t) (cutoff - t) / (cutoff - beam) between the two angles
    static double flux(const double *number) {
        double cutoff = number[0] * Pi / 180, beam = number[1] * Pi / 180, width = cutoff - beam;
        if (!(width > 1e-6)) return 2 * Pi * (1 - std::cos(cutoff));
        return 2 * Pi * (1 - (std::sin(cutoff) - std::sin(beam)) / width);
    }
};

template <class F>
using SpotLight = DeltaPosition<SpotEmitter, F>;
TR_EMITTER(SpotEmitter, SpotLight)

}  // namespace tr
