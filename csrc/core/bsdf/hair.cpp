// `hair`: a fibre of circular cross section, rough and covered with tilted scales. Chiang, Bitterli, Tappan and Burley,
// "A Practical and Controllable Hair and Fur Model for Production Path Tracing", EGSR 2016, with the longitudinal lobes
// of d'Eon, Francois, Hill, Letteri and Aubry, "An Energy-Conserving Hair Reflectance Model", EGSR 2011; both as put
// together by Pharr, "The Implementation of a Hair Scattering Model", 2016. Lobe 0 is light reflected off the fibre
// (R), lobe 1 light that went through it (TT), lobe 2 light that was reflected inside once (TRT), and lobe 3 all that
// was reflected more often.
//
// Locally y is along the fibre and z its normal, so that where on the width of the fibre a ray arrives is known from
// its direction: the offset h is the sine of the angle between the normal and wi in the plane across the fibre. What
// leaves the fibre is taken to do so where light arrived (wi is where the path came from: the camera's side).
#include "../math/bessel.h"
#include "../math/fresnel.h"
#include "kernels.h"

namespace tr {

struct Hair {
    static constexpr Field fields[] = {
        {"sigma_a", Kind::Texture, 0, 0, INFINITY, "interior", "absorption inside, per radius of the fibre", nullptr,
         Optional},
        {"eumelanin", Kind::Scalar, 0, 0, INFINITY, "interior", "concentration of the brown pigment", nullptr,
         Optional},
        {"pheomelanin", Kind::Scalar, 0, 0, INFINITY, "interior", "concentration of the red pigment", nullptr,
         Optional},
        {"eumelanin_absorption", Kind::Texture, 0, 0, INFINITY, "interior",
         "absorption of eumelanin of concentration 1", nullptr, Optional},
        {"pheomelanin_absorption", Kind::Texture, 0, 0, INFINITY, "interior",
         "absorption of pheomelanin of concentration 1", nullptr, Optional},
        {"longitudinal_roughness", Kind::Float, 0.3, 0, 1, "interior",
         "along the fibre; below 0.001 it counts as that"},
        {"azimuthal_roughness", Kind::Float, 0.3, 0, 1, "interior", "around it; below 0.001 it counts as that"},
        {"scale_tilt", Kind::Float, 2, -90, 90, "interior", "angle of the scales with the fibre, in degrees"},
        {"eta", Kind::Float, 1.55 / 1.000277, 1, 1e3, "interior", "index of refraction inside over outside"},
        {"scale", Kind::Float, 1, 0, INFINITY, "interior", "factor of sigma_a"},
    };
    static constexpr int SigmaA = color_index(fields, "sigma_a"),
                         EumelaninAbsorption = color_index(fields, "eumelanin_absorption"),
                         PheomelaninAbsorption = color_index(fields, "pheomelanin_absorption");
    static constexpr int Eumelanin = number_index(fields, "eumelanin"),
                         Pheomelanin = number_index(fields, "pheomelanin"),
                         Longitudinal = number_index(fields, "longitudinal_roughness"),
                         Azimuthal = number_index(fields, "azimuthal_roughness"),
                         Tilt = number_index(fields, "scale_tilt"), Eta = number_index(fields, "eta"),
                         Scale = number_index(fields, "scale");
    static constexpr Model model = {
        "bsdf", "hair", "Hair and fur, on the surface of a fibre.",
        fields, 10,     HasSmoothLobes | FollowsTangent | Transmits | IsAsymmetric | ChoosesLobe};
    static constexpr int Albedo = -1;
    static constexpr bool Joint = true;

    // Of lobe p: the tilt of the scales times this is added to the inclination of wi, and the variance is this times
    // that of the first.
    static constexpr int Lobes = 4;
    static constexpr double tilts(int p) { return p == 0 ? -2 : p == 1 ? 1 : p == 2 ? 4 : 0; }
    static constexpr double widths(int p) { return p == 0 ? 1 : p == 1 ? 0.25 : 4; }

    // What all lobes need of the fibre and of the direction wi.
    template <class T>
    struct Strand {
        T sin_i, cos_i, phi_i;      // inclination and azimuth of wi
        T gamma_t, path;            // refracted: azimuth against the normal; length of the way through, in radii
        T reflected, shared, tilt;  // by Fresnel; what enters and leaves; in radians
        T variance, deviation;      // of lobe 0 along the fibre; of the logistic function around it
        Spectrum<T> absorption;

        template <class P, class F>
        TR_INLINE Strand(const P &params, const Vec3<F> &wi) {
            using S = std::decay_t<decltype(value_of(wi.z))>;
            auto number = [&](int i, double low, double high) {
                T x(params.number[i]);
                return with_value(x, max(S(low), min(S(high), value_of(x))));
            };
            T x(wi.x), y(wi.y), z(wi.z), eta = number(Eta, 1, 1e3);
            sin_i = y;
            cos_i = sqrt(x * x + z * z);
            phi_i = atan2(x, z);
            // Inside, the projections onto the cross section refract by the index of Bravais; its root is that of
            // eta^2 - sin^2 over cos_i, which is not divided by here.
            T bravais2 = max(eta * eta - y * y, T(S(1e-6))), height = sqrt(max(bravais2 - x * x, T(S(0))));
            gamma_t = atan2(x, height);
            path = S(2) * eta * height / bravais2;
            reflected = fresnel_dielectric(abs(z), eta).reflectance;  // the cosine of both angles is that of the normal
            shared = (S(1) - reflected) * (S(1) - reflected);
            T l = number(Longitudinal, 1e-3, 1), l4 = (l * l) * (l * l), l16 = (l4 * l4) * (l4 * l4);
            variance = l * (S(0.726) + l * S(0.812)) + S(3.7) * (l16 * l4);
            variance = variance * variance;
            T a = number(Azimuthal, 1e-3, 1), a2 = a * a, a4 = a2 * a2, a16 = (a4 * a4) * (a4 * a4);
            deviation = S(SqrtPi / 2.8284271247461903) * (a * (S(0.265) + a * S(1.194)) + S(5.372) * (a16 * a4 * a2));
            tilt = T(params.number[Tilt]) * S(Pi / 180);
            for (int c = 0; c < SpectrumSize; ++c) {
                T sum = T(params.number[Scale]) * T(params.color[SigmaA][c]) +
                        T(params.number[Eumelanin]) * T(params.color[EumelaninAbsorption][c]) +
                        T(params.number[Pheomelanin]) * T(params.color[PheomelaninAbsorption][c]);
                absorption[c] = with_value(sum, max(value_of(sum), S(0)));
            }
        }

        // Inclination of wi as lobe p sees it.
        TR_INLINE void tilted(const T &angle, T &s, T &c) const {
            T sin_a, cos_a;
            sincos(angle, sin_a, cos_a);
            s = sin_i * cos_a + cos_i * sin_a;
            c = abs(cos_i * cos_a - sin_i * sin_a);
        }
        // The attenuation of the lobe after one of attenuation a, `t` being what a way through the fibre leaves: the
        // last is the sum of a geometric series, and 0 / 0 where nothing enters.
        TR_INLINE T next(int p, const T &a, const T &t) const {
            using S = std::decay_t<decltype(value_of(t))>;
            T again = t * reflected;
            return p == 0 ? shared * t : p == 1 ? a * again : a * again / max(S(1) - again, T(S(1e-12)));
        }
        // What leaves the fibre of a component whose way through leaves t.
        TR_INLINE T albedo(const T &t) const {
            T a = reflected, sum = a;
            for (int p = 0; p < Lobes - 1; ++p) sum = sum + (a = next(p, a, t));
            return sum;
        }
        // What the component is left with that is absorbed least, and which is the brightest one of every lobe.
        TR_INLINE T clearest() const { return exp(-path * min(absorption[0], min(absorption[1], absorption[2]))); }
    };

    // Density of inclinations, of d'Eon and others: exp(-sin_p sin_o / v) I_0(cos_p cos_o / v) / (2 v sinh(1 / v)),
    // with sin_p and cos_p of wi as tilted and v the variance. The exponents of all three factors make one that is not
    // positive, so that no variance is too small.
    template <class T>
    TR_INLINE static T longitudinal(const T &sin_p, const T &cos_p, const T &sin_o, const T &cos_o, const T &v) {
        using S = std::decay_t<decltype(value_of(v))>;
        T inverse = S(1) / v, along = sin_p + sin_o, across = cos_p - cos_o;
        T bell = exp(S(-0.5) * inverse * (along * along + across * across));
        return scaled_bessel_i0(cos_p * cos_o * inverse) * bell * inverse / (S(1) - exp(S(-2) * inverse));
    }

    // Density of azimuths that are x away from where a smooth fibre sends light: the logistic function of the deviation
    // s, wrapped, and cut off at +-pi (Chiang and others).
    template <class T>
    TR_INLINE static T azimuthal(const T &x, const T &s) {
        using S = std::decay_t<decltype(value_of(x))>;
        T wrapped = x - T(S(2 * Pi) * floor(value_of(x) * S(1 / (2 * Pi)) + S(0.5)));
        T inverse = S(1) / s, e = exp(-abs(wrapped) * inverse), end = exp(S(-Pi) * inverse), both = S(1) + e;
        return e * (S(1) + end) * inverse / (both * both * (S(1) - end));
    }

    // f |cos| of radiance. `around`: all lobes go evenly around the fibre instead.
    template <class P, class F>
    TR_NOINLINE static auto value(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, bool around) {
        using T = std::decay_t<decltype(params.number[Eta] * wi.z)>;
        using S = std::decay_t<decltype(value_of(wi.z))>;
        const Strand<T> strand(params, wi);
        T x(wo.x), z(wo.z), sin_o(wo.y), cos_o = sqrt(x * x + z * z);
        T phi = strand.phi_i + atan2(x, z), turn = S(2) * strand.gamma_t + T(S(Pi));
        Spectrum<T> left, attenuation = uniform_spectrum(strand.reflected), sum = uniform_spectrum(T(S(0)));
        for (int c = 0; c < SpectrumSize; ++c) left[c] = exp(-strand.path * strand.absorption[c]);
        for (int p = 0; p < Lobes; ++p) {
            T sin_p, cos_p, density(S(1 / (2 * Pi)));
            strand.tilted(strand.tilt * S(tilts(p)), sin_p, cos_p);
            if (p < Lobes - 1 && !around) density = azimuthal(phi, strand.deviation);
            density = density * longitudinal(sin_p, cos_p, sin_o, cos_o, strand.variance * S(widths(p)));
            for (int c = 0; c < SpectrumSize; ++c) {
                sum[c] = sum[c] + attenuation[c] * density;
                attenuation[c] = strand.next(p, attenuation[c], left[c]);
            }
            phi = phi - turn;
        }
        return sum;
    }

    // The same of importance: the light's side is wi there.
    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &,
                               Transport transport = Transport::Radiance) {
        const bool forward = transport == Transport::Radiance;
        auto f = value(params, forward ? wi : wo, forward ? wo : wi, false);
        if (forward) return f;
        auto lies = mask<F>(value_of(wi.z) == value_of(F(0)));
        return f * select(lies, F(0), abs(wo.z / select(lies, F(1), wi.z)));
    }

    // Lobes are chosen by their attenuation of the component that is absorbed least, so that of this one the density is
    // its value over all that leaves the fibre, and no weight is above 1. Importance goes evenly around the fibre,
    // since there the offset is that of wo.
    template <class P, class F>
    TR_INLINE static F density(const P &params, const Vec3<F> &wi, const Spectrum<F> &f) {
        Strand<F> strand(params, wi);
        F all = strand.albedo(strand.clearest());
        auto some = mask<F>(all > F(0));
        return select(some, max_component(f) / select(some, all, F(1)), F(0));
    }
    template <class P, class F>
    TR_INLINE static BsdfValue<F> eval_pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, Transport transport) {
        const bool forward = transport == Transport::Radiance;
        Spectrum<F> f = value(params, wi, wo, !forward);
        BsdfValue<F> r{f, density(params, wi, f)};
        if (!forward) r.f = eval(params, wi, wo, IntOf<F>(0), transport);
        return r;
    }

    template <class P, class F>
    TR_INLINE static Vec3<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2,
                                    Transport transport) {
        Strand<F> strand(params, wi);
        F left = strand.clearest(), share = strand.reflected, rest = u0 * strand.albedo(left);
        F u(0), tilt(0), width(0), order(0);
        MaskOf<F> chosen(false);
        for (int p = 0; p < Lobes; ++p) {
            auto here = !chosen && (mask<F>(rest < share) || MaskOf<F>(p == Lobes - 1));
            u = select(here, rest / max(share, F(1e-30)), u);
            tilt = select(here, F(tilts(p)), tilt);
            width = select(here, F(widths(p)), width);
            order = select(here, F(p), order);
            chosen = chosen || here;
            rest = rest - share;
            share = strand.next(p, share, left);
        }
        u = max(min(u, F(1)), F(0));
        // Inclinations: d'Eon, Marschner and Hanika, "Importance Sampling for Physically-Based Hair Fiber Models",
        // SIGGRAPH Asia 2013 technical briefs; w is 1 less the cosine of the angle to the mirrored direction.
        F sin_p, cos_p, s, c;
        strand.tilted(strand.tilt * tilt, sin_p, cos_p);
        F v = strand.variance * width;
        F least = exp(F(-2) / v), w = -v * log(max(fmadd(u1, F(1) - least, least), F(1e-30)));
        w = max(F(0), min(F(2), w));
        sincos(F(2 * Pi) * u2, s, c);
        F sin_o = fmadd(sqrt(w * (F(2) - w)) * c, cos_p, (w - F(1)) * sin_p);
        sin_o = max(F(-1), min(F(1), sin_o));
        F cos_o = sqrt(max(F(1) - sin_o * sin_o, F(0)));
        // azimuths
        F end = exp(F(-Pi) / strand.deviation), within = u * (F(1) - end);
        F x = strand.deviation * log(max(end + within, F(1e-30)) / max(F(1) - within, F(1e-30)));
        x = fmadd(order, fmadd(F(2), strand.gamma_t, F(Pi)), max(F(-Pi), min(F(Pi), x)));
        auto evenly = mask<F>(order == F(Lobes - 1)) || MaskOf<F>(transport == Transport::Importance);
        sincos(select(evenly, F(2 * Pi) * u, x) - strand.phi_i, s, c);
        return {cos_o * s, sin_o, cos_o * c};
    }
};

TR_BSDF(Hair)

}  // namespace tr
