// Light through a rough coating, by Gaussian quadrature over visible normals m: of light from wi, the share
// (1 - F(wi.m)) G1(wt) goes on below, wt being refracted at m, and F(wi.m) G1(wr) is reflected (Walter et al., EGSR
// 2007, equations 20 and 21 over the density of visible normals). Derivatives in index and roughness are differences of
// that over two or five percent of them: those of the nodes' values would be infinite where total reflection begins.
#include "rough_transmittance.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "../core/bsdf/dielectric_microfacet.h"

namespace tr {

namespace {

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
    void visit(const Coating &coating, double alpha, double sine, double cosine, Visit &&visit) const {
        double length = std::sqrt(alpha * alpha * sine * sine + cosine * cosine);
        double s = alpha * sine / length, c = cosine / length;
        for (size_t j = 0; j < height.x.size(); ++j) {
            // nodes crowd at both ends, where normals vary with the square root of the number
            double t = height.x[j], u = t * t * (3 - 2 * t), w = height.w[j] * 6 * t * (1 - t);
            double z = (1 - u) * (1 + c) - c, r = std::sqrt(std::max(1 - z * z, 0.0));
            double slope = coating.ggx ? 0 : visible_beckmann_slopes(s, c, u, 0.5).x;
            for (size_t i = 0; i < azimuth.x.size(); ++i) {
                Vec3<double> m;
                if (coating.ggx) {
                    double phi = Pi * azimuth.x[i];
                    Vec3<double> h{r * std::cos(phi) + s, r * std::sin(phi), z + c};
                    m = {alpha * h.x, alpha * h.y, h.z};
                } else {
                    double other = erf_inverse_of_share(0.5 + 0.5 * azimuth.x[i]);
                    m = {-alpha * slope, -alpha * other, 1};
                }
                visit(m * (1 / norm(m)), w * azimuth.w[i]);
            }
        }
    }
};

double masking(const Coating &coating, double alpha, const Vec3<double> &v) {
    return std::fabs(v.z) * smith_g1_over_cos(coating.ggx, alpha, v);
}

double reflected(const Normals &normals, const Coating &coating, double alpha, double eta, double cosine) {
    double sine = std::sqrt(1 - cosine * cosine);
    double sum = 0;
    normals.visit(coating, alpha, sine, cosine, [&](const Vec3<double> &m, double w) {
        double c = m.x * sine + m.z * cosine;
        Vec3<double> wo = m * (c + c) - Vec3<double>{sine, 0, cosine};
        if (wo.z > 0) sum += fresnel_dielectric(c, eta).reflectance * masking(coating, alpha, wo) * w;
    });
    return sum;
}

double transmitted(const Normals &normals, const Coating &coating, double alpha, double eta, double cosine) {
    double sine = std::sqrt(1 - cosine * cosine);
    double sum = 0;
    normals.visit(coating, alpha, sine, cosine, [&](const Vec3<double> &m, double w) {
        double c = m.x * sine + m.z * cosine;
        Fresnel<double> fresnel = fresnel_dielectric(c, eta);
        Vec3<double> wo = m * (fresnel.eta_ti * c + fresnel.cos_t) - Vec3<double>{sine, 0, cosine} * fresnel.eta_ti;
        if (wo.z < 0) sum += (1 - fresnel.reflectance) * masking(coating, alpha, wo) * w;
    });
    return sum;
}

// The values of the table's rows.
void fill_values(const Coating &coating, double *rows) {
    static const Normals coarse(8, 16), fine(16, 32);  // total reflection from inside has an edge
    constexpr int n = RoughTransmittanceSize::Cosines;
    rows[0] = 0;
    for (int i = 0; i < n; ++i) {
        double cosine = std::max(double(i) / (n - 1), 1e-6);
        rows[1 + i] = transmitted(coarse, coating, coating.alpha, coating.eta, cosine);
        // 2 R cos over cosines: their mean over the cosines of the table, as Mitsuba has it
        rows[0] += reflected(fine, coating, coating.alpha, 1 / coating.eta, cosine) * (2 * cosine / n);
    }
}

}  // namespace

Coating make_coating(double eta, double alpha, int32_t distribution) {
    return {std::max(eta, 1e-3), clamp_alpha(alpha), distribution == int32_t(Microfacets::Ggx)};
}

void fill_rough_transmittance(const Coating &coating, double *numbers) {
    constexpr int n = RoughTransmittanceSize::Rows;
    double value[n], high[n], low[n];
    fill_values(coating, value);
    for (int i = 0; i < n; ++i) numbers[4 * i] = value[i], numbers[4 * i + 3] = 0;
    for (double Coating::*variable : {&Coating::eta, &Coating::alpha}) {
        const bool roughness = variable == &Coating::alpha;
        const double step = coating.*variable * (roughness ? 0.05 : 0.02);
        Coating moved = coating;
        moved.*variable = coating.*variable + step;
        fill_values(moved, high);
        moved.*variable = coating.*variable - step;
        fill_values(moved, low);
        for (int i = 0; i < n; ++i) numbers[4 * i + (roughness ? 2 : 1)] = (high[i] - low[i]) / (2 * step);
    }
}

}  // namespace tr
