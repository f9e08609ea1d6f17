// Wavelengths of paths, and the spectra that are looked up at them.
#include "core/color/spectral.h"
#include "harness.h"

namespace tr::testing {

// A density that rises from 360 nm on: the position of a number u is 470 sqrt(u), piecewise linear.
template <class S>
struct RisingDensity {
    static constexpr int Intervals = 32;
    std::vector<S> positions, weights;

    RisingDensity() : weights(size_t(SpectrumSamples) * 3) {
        for (int i = 0; i <= 3 * Intervals; ++i) positions.push_back(S(470 * std::sqrt(i / (3.0 * Intervals))));
        for (size_t i = 0; i < weights.size(); ++i) weights[i] = S(std::sin(0.1 * double(i)));
    }
    SpectralConfig config() const { return {positions.data(), Intervals, weights.data()}; }
};

// The places among equally likely numbers of the wavelengths of a pixel's samples.
static std::vector<double> numbers_of(uint32_t pixel, uint32_t n, int wave) {
    const RisingDensity<double> density;
    std::vector<double> found;
    for (uint32_t k = 0; k < n; ++k) {
        const auto chosen = choose_wavelengths<double>(density.config(), 7, 0, pixel, k);
        const double at = chosen.waves.at[wave];
        size_t i = 0;
        while (i + 2 < density.positions.size() && density.positions[i + 1] <= at) ++i;
        const double length = density.positions[i + 1] - density.positions[i];
        CHECK_NEAR(chosen.inverse[wave], length * RisingDensity<double>::Intervals, 1e-9);
        found.push_back((double(i) + (at - density.positions[i]) / length) / (3.0 * RisingDensity<double>::Intervals));
    }
    return found;
}

// Chi-square of 64 equal parts, 63 degrees of freedom: 116.3 is exceeded once in 20000 times, and there are three
// tests.
TR_TEST(wavelengths_have_their_density) {
    for (int wave = 0; wave < 3; ++wave) {
        std::vector<int> count(64);
        int n = 0;
        for (uint32_t pixel = 0; pixel < 1 << 14; ++pixel)
            for (double u : numbers_of(pixel, 1, wave)) ++count[size_t(u * 64)], ++n;
        double sum = 0, expected = n / 64.0;
        for (int c : count) sum += (c - expected) * (c - expected) / expected;
        CHECK(sum < 116.3);
    }
}

// Samples of a pixel are spread: in each of 16 parts of every third there is one of 3 * 34 first numbers.
TR_TEST(wavelengths_of_a_pixel_are_spread) {
    for (uint32_t pixel = 0; pixel < 50; ++pixel) {
        std::vector<bool> hit(48);
        for (double u : numbers_of(pixel, 102, 0)) hit[size_t(u * 48)] = true;
        for (bool h : hit) CHECK(h);
        const std::vector<double> first = numbers_of(pixel, 1, 0), second = numbers_of(pixel, 1, 1);
        CHECK_NEAR(std::fmod(first[0] + 1.0 / 3, 1.0), second[0], 1e-12);
    }
}

TR_TEST(tables_are_linear_between_nanometres) {
    std::vector<double> table(SpectrumSamples + 5);
    for (int i = 0; i < SpectrumSamples; ++i) table[size_t(i + 5)] = i * i;
    Wavelengths<double> waves;
    waves.chosen = true;
    waves.at[0] = 0, waves.at[1] = 100.25, waves.at[2] = 470;
    const auto found = table_spectrum(table.data(), waves, 5u, true);
    CHECK_NEAR(found[0], 0, 1e-12);
    CHECK_NEAR(found[1], 0.75 * 100 * 100 + 0.25 * 101 * 101, 1e-9);
    CHECK_NEAR(found[2], 470.0 * 470.0, 1e-9);
}

// <J v, g> = <v, J' g> for the sum of texels, and J is the slope.
TR_TEST(derivatives_of_sigmoid_texels) {
    std::vector<double> texels, tangent;
    for (int i = 0; i < 12; ++i) texels.push_back(std::cos(1.7 * i)), tangent.push_back(std::sin(2.3 * i + 1));
    Wavelengths<double> waves;
    waves.chosen = true;
    waves.at[0] = 17, waves.at[1] = 250.5, waves.at[2] = 460;
    const uint32_t at[2] = {2, 0};
    const double weight[2] = {0.3, 0.9};
    const Spectrum<double> g{{1, -2, 0.5}};
    const double *none = nullptr;
    auto value = [&](double step) {
        std::vector<double> moved = texels;
        for (size_t i = 0; i < moved.size(); ++i) moved[i] += step * tangent[i];
        return sigmoid_texels(moved.data(), none, waves, at, weight, 2, true);
    };
    const double h = 1e-6;
    const Spectrum<double> slope = (value(h) - value(-h)) * (0.5 / h);
    const Spectrum<double> forward =
        sigmoid_texels<double, double>(tangent.data(), texels.data(), waves, at, weight, 2, true);
    double reverse = 0;
    sweep_sigmoid_texels(texels.data(), waves, at, weight, 2, g, true, [&](int k, const auto &bar) {
        for (int c = 0; c < SigmoidChannels; ++c) reverse += bar[c] * tangent[at[k] * SigmoidChannels + size_t(c)];
    });
    for (int c = 0; c < 3; ++c) CHECK_NEAR(forward[c], slope[c], 1e-8);
    CHECK_NEAR(component_sum(forward * g), reverse, 1e-12);
}

TR_TEST(film_weights_and_their_transposed) {
    const RisingDensity<double> density;
    const auto chosen = choose_wavelengths<double>(density.config(), 1, 0, 3u, 5u);
    const FilmWeights<double> weights(density.config(), chosen);
    const Spectrum<double> light{{0.3, 2, -1}}, bar{{1, 0.5, 4}};
    CHECK_NEAR(component_sum(weights.channels(light) * bar), component_sum(weights.pull(bar) * light), 1e-9);
}

}  // namespace tr::testing
