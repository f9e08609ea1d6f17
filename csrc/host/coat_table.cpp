// Light through a rough coating, by Gaussian quadrature over visible normals m: of light from wi, the share
// (1 - F(wi.m)) G1(wt) goes on below, wt being refracted at m, and F(wi.m) G1(wr) is reflected (Walter et al., EGSR
// 2007, equations 20 and 21 over the density of visible normals). Dual numbers carry the derivatives: nodes are
// functions of index and roughness, as if they were sampled with the same random numbers.
#include "coat_table.h"

#include <cmath>
#include <vector>

#include "../core/bsdf/facet_interface.h"

namespace tr {

namespace {

using D = Dual<double, 2>;  // derivatives in index and roughness

// Nodes and weights on [0, 1], by Newton's method for the roots of the Legendre polynomial.
struct Gauss {
    std::vector<double> x, w;
    explicit Gauss(int n) : x(size_t(n)), w(size_t(n)) {
        for (int i = 0; i < n; ++i) {
            double z = std::cos(Pi * (i + 0.75) / (n + 0.5)), slope = 1;
            for (int k = 0; k < 100; ++k) {
                double p = 1, before = 0;
                for (int j = 1; j <= n; ++j) {
                    double next = ((2 * j - 1) * z * p - (j - 1) * before) / j;
                    before = p, p = next;
                }
                slope = n * (z * p - before) / (z * z - 1);
                double step = p / slope;
                z -= step;
                if (std::abs(step) < 1e-15) break;
            }
            x[size_t(i)] = 0.5 * (1 - z), w[size_t(i)] = 1 / ((1 - z * z) * slope * slope);
        }
    }
};

// Visible normals from directions in the plane of x and z, above one half of which the other is mirrored.
struct Normals {
    Gauss azimuth, height;
    Normals(int n_azimuth, int n_height) : azimuth(n_azimuth), height(n_height) {}

    // Calls visit(normal, weight) for every node.
    template <class Visit>
    void visit(const Coat &coat, const D &alpha, double sine, double cosine, Visit &&visit) const {
        D length = sqrt(alpha * alpha * D(sine * sine) + D(cosine * cosine));
        D s = alpha * D(sine) / length, c = D(cosine) / length;
        for (size_t j = 0; j < height.x.size(); ++j) {
            // nodes crowd at both ends, where normals vary with the square root of the number
            double t = height.x[j], u = t * t * (3 - 2 * t), w = height.w[j] * 6 * t * (1 - t);
            D z = D(1 - u) * (D(1) + c) - c, r = sqrt(max(D(1) - z * z, D(0)));
            D slope = coat.ggx ? D(0) : visible_slope(s, c, u);
            for (size_t i = 0; i < azimuth.x.size(); ++i) {
                Vec3<D> m;
                if (coat.ggx) {
                    double phi = Pi * azimuth.x[i];
                    Vec3<D> h{r * D(std::cos(phi)) + s, r * D(std::sin(phi)), z + c};
                    m = {alpha * h.x, alpha * h.y, h.z};
                } else {
                    double other = erf_inverse_of_share(0.5 + 0.5 * azimuth.x[i]);
                    m = {-alpha * slope, -alpha * D(other), D(1)};
                }
                visit(m * (D(1) / sqrt(squared_norm(m))), w * azimuth.w[i]);
            }
        }
    }

private:
    // The slope along x of share u (see visible_beckmann_slopes): value by sampling; the derivative follows from the
    // equation that it solves, sqrt(pi) c (1 + erf(x)) + s exp(-x^2) = u times the same at x = c / s, of which the
    // derivative in x is 0 there.
    static D visible_slope(const D &s, const D &c, double u) {
        double x = visible_beckmann_slopes(s.v, c.v, u, 0.5).x, largest = std::min(c.v / std::max(s.v, 1e-10), 10.0);
        auto below = [&](double y) { return c * D(SqrtPi * (1 + std::erf(y))) + s * D(std::exp(-y * y)); };
        D excess = below(x) - D(u) * below(largest);
        double by_x = 2 * std::exp(-x * x) * (c.v - s.v * x);
        return with_value(excess * D(-1 / std::max(by_x, 1e-30)), x);
    }
};

D masking(const Coat &coat, const D &alpha, const Vec3<D> &v) {
    return abs(v.z) * masking_over_cosine(coat.ggx, alpha, v);
}

D reflected(const Normals &normals, const Coat &coat, const D &alpha, const D &eta, double cosine) {
    double sine = std::sqrt(1 - cosine * cosine);
    D sum(0);
    normals.visit(coat, alpha, sine, cosine, [&](const Vec3<D> &m, double w) {
        D c = m.x * D(sine) + m.z * D(cosine);
        Vec3<D> wo = m * (c + c) - Vec3<D>{D(sine), D(0), D(cosine)};
        if (wo.z.v > 0) sum = sum + fresnel_dielectric(c, eta).reflectance * masking(coat, alpha, wo) * D(w);
    });
    return sum;
}

D transmitted(const Normals &normals, const Coat &coat, const D &alpha, const D &eta, double cosine) {
    double sine = std::sqrt(1 - cosine * cosine);
    D sum(0);
    normals.visit(coat, alpha, sine, cosine, [&](const Vec3<D> &m, double w) {
        D c = m.x * D(sine) + m.z * D(cosine);
        Fresnel<D> fresnel = fresnel_dielectric(c, eta);
        Vec3<D> wo = m * (fresnel.eta_ti * c + fresnel.cos_t) - Vec3<D>{D(sine), D(0), D(cosine)} * fresnel.eta_ti;
        if (wo.z.v < 0) sum = sum + (D(1) - fresnel.reflectance) * masking(coat, alpha, wo) * D(w);
    });
    return sum;
}

}  // namespace

void fill_coat_table(const Coat &coat, double *numbers) {
    static const Normals coarse(8, 16), fine(16, 32);  // total reflection from inside has an edge
    constexpr int n = CoatTableSize::Cosines;
    D eta(coat.eta, 0), alpha(coat.alpha, 1), internal(0);
    auto put = [&](int row, const D &value) {
        numbers[4 * row] = value.v;
        for (int k = 0; k < 2; ++k) numbers[4 * row + 1 + k] = value.d[k];
        numbers[4 * row + 3] = 0;
    };
    for (int i = 0; i < n; ++i) {
        double cosine = std::max(double(i) / (n - 1), 1e-6);
        put(1 + i, transmitted(coarse, coat, alpha, eta, cosine));
        // 2 R cos over cosines: their mean over the cosines of the table, as Mitsuba has it
        internal = internal + reflected(fine, coat, alpha, D(1) / eta, cosine) * D(2 * cosine / n);
    }
    put(0, internal);
}

}  // namespace tr
