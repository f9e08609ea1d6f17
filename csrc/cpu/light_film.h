// The film of light paths: sums over all of them, wherever they end, and what these are multiplied with.
#pragma once

#include <cmath>

#include "core/sensor/irradiancemeter.h"
#include "render.h"
#include "splat.h"

namespace tr {

// Spp paths start in every pixel, taken as a stratum of the emitters.
template <class S>
TileSchedule schedule_of_light(const RenderCall<S> &call) {
    Rect film{0, 0, call.film_height, call.film_width};
    return TileSchedule(film, film, 0, call.spp);
}

// What is splatted apart: radiance, or the components of Stokes vectors.
template <class S>
size_t n_parts(const RenderCall<S> &call) {
    return call.config.stokes ? 4 : 1;
}
template <class T, class S>
std::vector<SplatFilm<T>> empty_films(const RenderCall<S> &call) {
    std::vector<SplatFilm<T>> films;
    films.reserve(n_parts(call));
    for (size_t p = 0; p < n_parts(call); ++p) films.emplace_back(call.crop);
    return films;
}

// What sums over all paths are multiplied with, by row and column: the image is the average that the path tracer takes
// of a film with `sample_border`. Light counts beyond the film's edge, too, as far as filters reach: it may cross it
// when things move. A surface that measures ends at the film's edge, and so do the averages.
template <class S>
class LightScale {
public:
    LightScale(const RenderCall<S> &call, int64_t spp)
        : paths_(double(spp) * call.film_height * call.film_width),
          rows_(within(call, call.film_height)),
          columns_(within(call, call.film_width)) {}

    double operator()(int row, int column) const {
        return 1 / (paths_ * rows_[size_t(row)] * columns_[size_t(column)]);
    }

private:
    // What of the filter around each pixel along an axis counts.
    static std::vector<double> within(const RenderCall<S> &call, int size) {
        std::vector<double> r(size_t(size), call.filter.integral(-INFINITY, INFINITY));
        if (call.scene->sensors[call.config.sensor].kind == IrradianceMeterKind)
            for (int pixel = 0; pixel < size; ++pixel) {
                const double center = pixel + 0.5;
                r[size_t(pixel)] = call.filter.integral(-center, size - center);
            }
        return r;
    }

    double paths_;
    std::vector<double> rows_, columns_;
};

// The wanted pixels in the order of the results: visit(result, y, x).
template <class S, class Visit>
void for_results(const RenderCall<S> &call, Visit &&visit) {
    size_t i = 0;
    if (call.pixels) {
        for (const Pixel &p : *call.pixels) visit(i++, p.y, p.x);
        return;
    }
    for (int y = call.crop.y0; y < call.crop.y1; ++y)
        for (int x = call.crop.x0; x < call.crop.x1; ++x) visit(i++, y, x);
}

// The image of sums: total(part, y, x, value). `sums`, if not null, are those of earlier paths, to which these are
// added.
template <class S, class Total>
void write_light(const RenderCall<S> &call, S *image, FilmSums *sums, Total &&total) {
    const int values = call.values, numbers = call.numbers();
    const size_t n_results = call.pixels ? call.pixels->size() : size_t(call.crop.height()) * size_t(call.crop.width());
    if (sums) sums->begin(n_results * size_t(numbers), call.spp);
    const LightScale<S> scale(call, sums ? sums->spp : call.spp);
    for_results(call, [&](size_t i, int row, int column) {
        const double s = scale(row, column);
        double own[4 * SpectrumSize];
        for (int k = 0; k < numbers; ++k) own[k] = double(total(size_t(k / values), row, column, k % values));
        const double *p = sums ? sums->add(i * size_t(numbers), own, numbers) : own;
        for (int c = 0; c < numbers; ++c) image[i * size_t(numbers) + size_t(c)] = S(p[c] * s);
    });
}

// The gradient of an image's pixels as sums are splatted.
template <class S>
std::vector<SplatFilm<S>> adjoint_films(const RenderCall<S> &call, const S *adjoint) {
    std::vector<SplatFilm<S>> films = empty_films<S>(call);
    const LightScale<S> scale(call, call.spp);
    for_results(call, [&](size_t i, int row, int column) {
        const double s = scale(row, column);
        const S *from = adjoint + i * size_t(call.numbers());
        for (size_t p = 0; p < films.size(); ++p)
            for (int c = 0; c < call.values; ++c)
                films[p].at(row, column)[c] += S(double(from[int(p) * call.values + c]) * s);
    });
    return films;
}

}  // namespace tr
