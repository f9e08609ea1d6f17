// `projector`: a camera the other way round. It throws an image along +z of its frame, +x to the left and +y up in it:
// on a plane z = 1 of the frame the irradiance is pi * scale * irradiance, so that a white diffuse screen there shows
// the image itself; nothing goes beside the image.
#include "delta_position.h"

namespace tr {

struct ProjectorEmitter {
    static constexpr bool HasFrame = true;
    static constexpr const char *Edges =
        "interior, without the motion of the image's border, and of shadow edges that are seen in mirrors or through "
        "glass; zero where the image is black at its border and there are no such edges";
    static constexpr Field fields[] = {
        {"irradiance", Kind::Texture, 1, 0, INFINITY, "interior",
         "what a white diffuse screen at distance 1 shows, W / (m^2 sr); row 0 is at the top"},
        {"scale", Kind::Float, 1, 0, INFINITY, "interior", "factor of the image"},
        {"x_fov", Kind::Float, None, 0, 180, Edges, "horizontal field of view, degrees"},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Edges,
         "the projector's frame to the world, no scale; it looks along +z"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
        {"stokes", Kind::Vector, 0, -1, 1, "interior",
         "(3,) Q, U and V of the light's Stokes vector over I, Q along the x axis of to_world across the ray", nullptr,
         Optional},
    };
    static constexpr int ColorField = -1, PlaceField = field_index(fields, "to_world");
    static constexpr int TextureField = field_index(fields, "irradiance");
    static constexpr int Numbers = 3, Differentiable = 2;  // the last is the aspect of the image
    static constexpr std::array NumberFields{field_index(fields, "scale"), field_index(fields, "x_fov"), ImageAspect};
    static constexpr Model model = {"emitter", "projector", "A light that throws an image.",
                                    fields,    6,           HasDeltaPosition | HasImageAspect};

    // tangents of half the fields of view
    template <class T, int N>
    TR_INLINE static Vec2<T> slopes(const T (&number)[N]) {
        T sine, cosine;
        sincos(number[1] * T(Pi / 360), sine, cosine);
        T slope = sine / cosine;
        return {slope, slope / number[2]};
    }

    template <class T, int N>
    TR_INLINE static Pattern<T> pattern(const Vec3<T> &d, const T (&number)[N]) {
        Vec2<T> slope = slopes(number);
        auto front = mask<T>(d.z > T(1e-6));
        T inverse = T(1) / select(front, d.z, T(1));
        T a = d.x * inverse / slope.x, b = d.y * inverse / slope.y;
        Pattern<T> r;
        r.lit = front && mask<T>(abs(a) < T(1)) && mask<T>(abs(b) < T(1));
        r.factor = number[0] * T(Pi) * inverse * inverse * inverse;
        r.u = T(0.5) - T(0.5) * a;
        r.v = T(0.5) - T(0.5) * b;
        return r;
    }

    // uniform over the image
    template <class F, int N>
    TR_INLINE static Vec3<F> sample(const F (&number)[N], const F &u1, const F &u2, F &inverse_pdf) {
        Vec2<F> slope = slopes(number);
        Vec3<F> d{(F(1) - F(2) * u1) * slope.x, (F(1) - F(2) * u2) * slope.y, F(1)};
        F inverse = rsqrt(squared_norm(d));
        inverse_pdf = F(4) * slope.x * slope.y * inverse * inverse * inverse;
        return d * inverse;
    }

    // the integral of the factor
    static double flux(const double *number) {
        double slope = std::tan(number[1] * Pi / 360);
        return number[0] * Pi * 4 * slope * slope / number[2];
    }
};

template <class F>
using ProjectorLight = DeltaPosition<ProjectorEmitter, F>;
TR_EMITTER(ProjectorEmitter, ProjectorLight)

}  // namespace tr
