// Reconstruction filters: how a sample spreads over pixels. Separable; a pixel gets f(x) f(y) of a sample that lies
// (x, y) from its centre. Names and parameters are Mitsuba 3's.
//
// `mitchell` (Mitchell and Netravali, "Reconstruction Filters in Computer Graphics", SIGGRAPH 1988, eq. 8),
// `catmullrom` (the same with B = 0, C = 1/2) and `lanczos` (a sinc times a wider one) have negative lobes. Weighted
// means with them are no longer between the samples: an image may be negative next to an edge, alpha larger than 1.
#pragma once

#include <algorithm>
#include <cmath>

#include "../math/lanes.h"
#include "../math/vector.h"
#include "sums.h"

namespace tr {

enum class FilterKind { Box, Tent, Gaussian, Mitchell, CatmullRom, Lanczos };

class Filter {
public:
    Filter() : Filter(FilterKind::Box, 0.5) {}
    // Radius of the tent, standard deviation of the Gaussian, B and C of Mitchell and Netravali, lobes of Lanczos.
    Filter(FilterKind kind, double parameter, double second = 0)
        : kind_(kind),
          radius_(kind == FilterKind::Box                                          ? 0.5
                  : kind == FilterKind::Gaussian                                   ? 4 * parameter
                  : kind == FilterKind::Mitchell || kind == FilterKind::CatmullRom ? 2
                                                                                   : parameter),
          scale_(-0.5 / (parameter * parameter)),
          end_(std::exp(scale_ * radius_ * radius_)),
          // a tent narrower than a pixel reaches its own pixel only, but not all of it
          reach_(kind == FilterKind::Box ? 0 : std::max(1, int(std::ceil(radius_ - 0.5)))) {
        const double within = std::min(radius_, MaxReach + 0.5);
        pixels_ = int(std::ceil(2 * within)), first_ = 0.5 - within;
        if (kind == FilterKind::CatmullRom) kind_ = FilterKind::Mitchell, parameter = 0, second = 0.5;
        const double b = parameter, c = second;
        const double inner[4] = {6 - 2 * b, 0, -18 + 12 * b + 6 * c, 12 - 9 * b - 6 * c};
        const double outer[4] = {8 * b + 24 * c, -12 * b - 48 * c, 6 * b + 30 * c, -b - 6 * c};
        for (int i = 0; i < 4; ++i) inner_[i] = inner[i] / 6, outer_[i] = outer[i] / 6;
    }

    // pixels on each side of the sample's own that a sample can reach; 0: the box, whose weights are 1
    int reach() const { return reach_; }

    // The pixels along an axis that lie in the filter around a place: how many, and the first of them.
    TR_HD int pixels() const { return pixels_; }
    template <class F>
    struct Reached {
        F first, from;
        // from the place to the centre of pixel `first + k`
        TR_INLINE F offset(int k) const { return from + F(ScalarOf<F>(k)); }
    };
    template <class F>
    TR_INLINE Reached<F> reached(const F &place) const {
        const F first = floor(place + F(S<F>(first_)));
        return {first, first + F(S<F>(0.5)) - place};
    }
    // What a sample at `place` weighs in a pixel.
    template <class T>
    TR_HD T weight_of(int32_t pixel, T place) const {
        const Reached<T> at = reached(place);
        const int32_t k = pixel - int32_t(at.first);
        return k < 0 || k >= pixels_ ? T(0) : weight(at.offset(k));
    }

    // The same filter without its sign: what it weights with are means of what is averaged.
    Filter magnitude() const {
        Filter r = *this;
        r.unsigned_ = true;
        return r;
    }

    double operator()(double x) const { return weight<double>(x); }

    // In lanes, of offsets of at most the radius and half a pixel.
    template <class F>
    TR_INLINE F weight(const F &x) const {
        F a = abs(x), w;
        switch (kind_) {
            case FilterKind::Box:
                return F(1);
            case FilterKind::Tent:
                w = F(1) - a * F(S<F>(1 / radius_));
                break;
            case FilterKind::Gaussian:
                w = gaussian(x) - F(S<F>(end_));
                break;
            case FilterKind::Lanczos: {
                F u = a * F(S<F>(Pi));
                w = sinc(u) * sinc(u * F(S<F>(1 / radius_)));
                break;
            }
            default:
                w = cubic(a);
        }
        w = select(mask<F>(a < F(S<F>(radius_))), w, F(0));
        return unsigned_ ? abs(w) : w;
    }
    // Its derivative; that of the box is not a function.
    template <class F>
    TR_INLINE F slope(const F &x) const {
        F a = abs(x), w;
        switch (kind_) {
            case FilterKind::Box:
                return F(0);
            case FilterKind::Tent:
                w = mulsign(F(S<F>(-1 / radius_)), x);
                break;
            case FilterKind::Gaussian:
                w = x * gaussian(x) * F(S<F>(2 * scale_));
                break;
            case FilterKind::Lanczos: {
                const F narrow(S<F>(1 / radius_));
                F u = a * F(S<F>(Pi)), v = u * narrow;
                w = mulsign((sinc_slope(u) * sinc(v) + sinc(u) * sinc_slope(v) * narrow) * F(S<F>(Pi)), x);
                break;
            }
            default:
                w = mulsign(cubic_slope(a), x);
        }
        return select(mask<F>(a < F(S<F>(radius_))), w, F(0));
    }

    // Both at once, which share a Gaussian's exponential.
    template <class F>
    TR_INLINE F weight(const F &x, F &slope_of) const {
        if (kind_ != FilterKind::Gaussian) {
            slope_of = slope(x);
            return weight(x);
        }
        F e = gaussian(x), w = e - F(S<F>(end_));
        auto inside = mask<F>(abs(x) < F(S<F>(radius_)));
        slope_of = select(inside, x * e * F(S<F>(2 * scale_)), F(0));
        w = select(inside, w, F(0));
        return unsigned_ ? abs(w) : w;
    }

    double integral(double a, double b) const {
        a = std::min(std::max(a, -radius_), radius_), b = std::min(std::max(b, -radius_), radius_);
        if (kind_ == FilterKind::Mitchell || kind_ == FilterKind::Lanczos) return quadrature(a, b);
        auto primitive = [&](double x) {
            if (kind_ == FilterKind::Box) return x;
            if (kind_ == FilterKind::Tent) return x - std::copysign(0.5 * x * x / radius_, x);
            double s = std::sqrt(-scale_);
            return 0.5 * std::sqrt(Pi) / s * std::erf(s * x) - end_ * x;
        };
        return primitive(b) - primitive(a);
    }

private:
    template <class F>
    using S = ScalarOf<F>;

    template <class F>
    TR_INLINE F gaussian(const F &x) const {
        return exp(x * x * F(S<F>(scale_)));
    }
    template <class F>
    TR_INLINE F cubic(const F &a) const {
        F w[2];
        for (int k = 0; k < 2; ++k) {
            const double *c = k ? outer_ : inner_;
            w[k] = fmadd(fmadd(fmadd(F(S<F>(c[3])), a, F(S<F>(c[2]))), a, F(S<F>(c[1]))), a, F(S<F>(c[0])));
        }
        return select(mask<F>(a < F(1)), w[0], w[1]);
    }
    template <class F>
    TR_INLINE F cubic_slope(const F &a) const {
        F w[2];
        for (int k = 0; k < 2; ++k) {
            const double *c = k ? outer_ : inner_;
            w[k] = fmadd(fmadd(F(S<F>(3 * c[3])), a, F(S<F>(2 * c[2]))), a, F(S<F>(c[1])));
        }
        return select(mask<F>(a < F(1)), w[0], w[1]);
    }
    // sin(u) / u and its derivative (u cos u - sin u) / u^2, u >= 0
    template <class F>
    TR_INLINE static F sinc(const F &u) {
        F s, c;
        sincos(u, s, c);
        auto apart = mask<F>(u > F(S<F>(1e-6)));
        return select(apart, s / select(apart, u, F(1)), F(1));
    }
    template <class F>
    TR_INLINE static F sinc_slope(const F &u) {
        F s, c;
        sincos(u, s, c);
        auto apart = mask<F>(u > F(S<F>(0.25)));
        F inverse = F(1) / select(apart, u, F(1)), q = u * u;
        // Taylor's series, the next term of which is 3e-7 u^9
        F near =
            u * (F(S<F>(-1.0 / 3)) + q * (F(S<F>(1.0 / 30)) + q * (F(S<F>(-1.0 / 840)) + q * F(S<F>(1.0 / 45360)))));
        return select(apart, (c - s * inverse) * inverse, near);
    }
    // Gauss and Legendre's five points on quarters of a pixel, no cell of which has a kink inside
    double quadrature(double a, double b) const {
        const double inner = std::sqrt(5 - 2 * std::sqrt(10.0 / 7)) / 3,
                     outer = std::sqrt(5 + 2 * std::sqrt(10.0 / 7)) / 3;
        const double at[5] = {0, inner, -inner, outer, -outer};
        const double by_inner = (322 + 13 * std::sqrt(70.0)) / 900, by_outer = (322 - 13 * std::sqrt(70.0)) / 900;
        const double by[5] = {128.0 / 225, by_inner, by_inner, by_outer, by_outer};
        double sum = 0;
        for (double low = a; low < b;) {
            double high = std::min(b, (std::floor(4 * low) + 1) / 4), half = 0.5 * (high - low);
            for (int i = 0; i < 5; ++i) sum += half * by[i] * (*this)(low + half * (1 + at[i]));
            low = high;
        }
        return sum;
    }

    FilterKind kind_;
    double radius_, scale_, end_;
    int reach_, pixels_;
    double first_;
    double inner_[4], outer_[4];  // coefficients of the cubics for |x| < 1 and 1 < |x| < 2, from the constant on
    bool unsigned_ = false;
};

}  // namespace tr
