// `hg`: Henyey and Greenstein, "Diffuse Radiation in the Galaxy", Astrophysical Journal 93 (1941).
#pragma once

#include "../math/warp.h"
#include "../model.h"

namespace tr {

struct HenyeyGreenstein {
    enum { G };
    static constexpr Field fields[] = {
        {"g", Kind::Float, 0.8, -0.9999, 0.9999, "interior", "mean cosine; positive scatters forward"},
    };
    static constexpr Model model = {"phase", "hg", "Henyey and Greenstein's phase function.", fields, 1};

    // `cosine` between the direction of travel and the scattered one. T may be a dual number.
    template <class T, class F>
    TR_INLINE static T eval(const T &g, const F &cosine) {
        T d = g * g + F(1) - g * (cosine * F(2));
        return (F(1) - g * g) * F(1 / (4 * Pi)) / (d * sqrt(d));
    }

    template <class F>
    TR_INLINE static F sample(const F &g, const F &u) {
        // the inverse of the cumulative distribution; near g = 0 its limit
        auto straight = mask<F>(abs(g) < F(1e-3));
        F safe = select(straight, F(1), g), s = (F(1) - safe * safe) / (F(1) - safe + F(2) * safe * u);
        F peaked = (F(1) + safe * safe - s * s) / (F(2) * safe);
        F linear = F(2) * u - F(1);  // plus g times what vanishes with it
        F flat = linear + F(1.5) * g * (F(1) - linear * linear);
        return max(F(-1), min(F(1), select(straight, flat, peaked)));
    }
};

}  // namespace tr
