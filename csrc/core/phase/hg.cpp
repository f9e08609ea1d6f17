// `hg`: Henyey and Greenstein, "Diffuse Radiation in the Galaxy", Astrophysical Journal 93 (1941), equation 2.
//
// Near |g| = 1 all light goes into a cone that is narrower than what cosines resolve in single precision. Everything is
// therefore expressed in t = 1 - cos of the angle to the lobe's axis, which is d for g >= 0 and -d for g < 0; t is half
// the squared distance of the two unit vectors.
#include "../math/dual.h"
#include "../math/warp.h"
#include "kernels.h"

namespace tr {

struct HenyeyGreenstein {
    static constexpr Field fields[] = {
        {"g", Kind::Float, 0.8, -0.9999, 0.9999, "interior", "mean cosine; positive scatters forward"},
    };
    static constexpr int G = field_index(fields, "g");
    static constexpr Model model = {"phase",           "hg", "Henyey and Greenstein's phase function.", fields, 1, 0,
                                    "HenyeyGreenstein"};

    template <class S>
    TR_INLINE static S g_of(const SceneView<S> &scene, const Record &record) {
        return scene.values.constants[record.field[G]];
    }

    // T is F or a dual number.
    template <class T, class F>
    TR_INLINE static T value(const T &g, const Vec3<F> &d, const Vec3<F> &wo) {
        T a = abs(g), rest = T(F(1)) - a;
        Vec3<F> apart = select(mask<F>(value_of(g) < F(0)), wo + d, wo - d);
        T squared = rest * rest + a * squared_norm(apart);
        return rest * (T(F(1)) + a) * F(1 / (4 * Pi)) / (squared * sqrt(squared));
    }

    template <class F>
    TR_HD static F eval(const SceneOf<F> &scene, const Record &record, const Vec3<F> &, const Vec3<F> &d,
                        const Vec3<F> &wo, const MaskOf<F> &) {
        return value(F(g_of(scene, record)), d, wo);
    }

    // Inverts the cumulative distribution, which is written so that g = 0 is no special case.
    template <class F>
    TR_HD static Vec3<F> sample(const SceneOf<F> &scene, const Record &record, const Vec3<F> &, const Vec3<F> &d,
                                const F &, const F &u1, const F &u2, const MaskOf<F> &) {
        using S = ScalarOf<F>;
        const S g = g_of(scene, record), a = abs(g), rest = S(1) - a;
        const bool backward = g < S(0);
        F u = backward ? F(1) - u1 : u1;  // the cosine grows with u1 in both cases
        F scale = F(rest) / fmadd(F(S(2) * a), u, F(rest));
        F t = F(2) * scale * scale * (F(1) - u) * fmadd(F(a), u, F(1));
        F cosine = backward ? t - F(1) : F(1) - t;
        return direction_about(d, cosine, sqrt(max(t * (F(2) - t), F(0))), u2);
    }

    // With the squared distance 2 - 2 cos, or 2 + 2 cos: 3 g p / (1 + g^2 - 2 g cos).
    template <class F>
    TR_HD static F slope(const SceneOf<F> &scene, const Record &record, const Vec3<F> &, const Vec3<F> &d,
                         const Vec3<F> &wo, const F &, const MaskOf<F> &, Vec3<F> &, GradientSink<F> &) {
        using S = ScalarOf<F>;
        const S g = g_of(scene, record), a = abs(g), rest = S(1) - a;
        F squared = fmadd(F(a), squared_norm(g < S(0) ? wo + d : wo - d), F(rest * rest));
        return value(F(g), d, wo) * F(3 * g) / squared;
    }

    template <class F>
    TR_HD static void vjp(const SceneOf<F> &scene, const Record &record, const Vec3<F> &, const Vec3<F> &d,
                          const Vec3<F> &wo, const Spectrum<F> &g, const MaskOf<F> &active, GradientSink<F> &sink) {
        auto dual = value(Dual<F, 1>(F(g_of(scene, record)), 0), d, wo);
        sink.number(IntOf<F>(record.field[G]), g * dual.d[0], active);
    }
};

TR_PHASE(HenyeyGreenstein)

}  // namespace tr
