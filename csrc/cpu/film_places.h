// Where samples lie on the film, and the filter's weights of the pixels around them, a packet of samples at a time.
#pragma once

#include <algorithm>

#include "core/film/filter.h"
#include "core/film/sums.h"

namespace tr {

// Weights of the pixels around places on the film, for W of them at once: pixel `first[i] + k` along an axis has
// weight[k][i] and slope[k][i], the derivative of the weight by the place.
template <class F>
struct SplatAxis {
    using S = ScalarOf<F>;
    static constexpr int W = Lanes<F>::Width, Most = 2 * MaxReach + 1;
    int n;
    alignas(64) int32_t first[W];
    alignas(64) S weight[Most][W], slope[Most][W];

    SplatAxis() {}  // the tables are large

    void set(const Filter &filter, const F &x, bool slopes) {
        n = filter.pixels();
        const F base = filter.first_pixel(x), from = base + F(S(0.5)) - x;
        for (int k = 0; k < n; ++k) {
            F offset = from + F(S(k));
            F by_place(0);
            store(&weight[k][0], slopes ? filter.weight(offset, by_place) : filter.weight(offset));
            if (slopes) store(&slope[k][0], -by_place);
        }
        alignas(64) S f[W];
        store(&f[0], base);
        for (int i = 0; i < W; ++i)  // places far away stay far away
            first[i] = int32_t(std::min(std::max(f[i], S(-1e9)), S(1e9)));
    }
};

// Both axes. `for_places` visits n places: visit(k, i), their weights being in lane i.
template <class F>
struct SplatAxes {
    using S = ScalarOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);
    SplatAxis<F> x, y;

    static F load_some(const S *from, size_t lanes) {
        if (lanes == W) return load<F>(from);
        alignas(64) S some[W] = {};
        for (size_t i = 0; i < lanes; ++i) some[i] = from[i];
        return load<F>(some);
    }
    template <class Visit>
    void for_places(const Filter &filter, const S *xs, const S *ys, size_t n, bool slopes, Visit &&visit) {
        for (size_t k = 0; k < n; k += W) {
            const size_t lanes = std::min(W, n - k);
            x.set(filter, load_some(xs + k, lanes), slopes), y.set(filter, load_some(ys + k, lanes), slopes);
            for (size_t i = 0; i < lanes; ++i) visit(k + i, int(i));
        }
    }
};

// Where a sample lies: in a pixel, the only one where `axes` is null, else with the weights of lane `lane` there.
template <class F>
struct FilmPlace {
    int row, column;
    const SplatAxes<F> *axes;
    int lane;
};

// visit(k, place) for samples begin .. end of columns, whose places on the film are known unless the filter is a box.
template <class F, class Columns, class Visit>
void for_film_places(const Filter &filter, const Columns &at, size_t begin, size_t end, Visit &&visit) {
    auto place = [&](size_t k, const SplatAxes<F> *axes, int lane) {
        return FilmPlace<F>{int32_t(at.row[k]), int32_t(at.column[k]), axes, lane};
    };
    if (filter.reach() == 0) {
        for (size_t k = begin; k < end; ++k) visit(k, place(k, nullptr, 0));
        return;
    }
    SplatAxes<F> axes;
    axes.for_places(filter, at.film_x.at + begin, at.film_y.at + begin, end - begin, false,
                    [&](size_t k, int lane) { visit(begin + k, place(begin + k, &axes, lane)); });
}
// visit(place) of one alone.
template <class S, class Visit>
void for_film_place(const Filter &filter, S x, S y, Visit &&visit) {
    SplatAxes<S> axes;
    if (filter.reach() > 0) axes.x.set(filter, x, false), axes.y.set(filter, y, false);
    visit(FilmPlace<S>{int(std::floor(y)), int(std::floor(x)), filter.reach() > 0 ? &axes : nullptr, 0});
}

}  // namespace tr
