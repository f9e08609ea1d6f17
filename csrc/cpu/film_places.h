// Where samples lie on the film, and the filter's weights of the pixels around them, a packet of samples at a time.
#pragma once

#include <algorithm>
#include <cstdlib>

#include "core/film/filter.h"
#include "core/film/sums.h"

namespace tr {

// Numbers begin .. end, of n along an axis from pixel `first` on, of pixels that lie in low .. high.
struct FilterSpan {
    int begin, end;

    FilterSpan(int first, int n, int low, int high) : begin(std::max(0, low - first)), end(std::min(n, high - first)) {}
    bool empty() const { return begin >= end; }
    bool operator==(const FilterSpan &other) const { return begin == other.begin && end == other.end; }
};

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
        const auto at = filter.reached(x);
        for (int k = 0; k < n; ++k) {
            const F offset = at.offset(k);
            F by_place(0);
            store(&weight[k][0], slopes ? filter.weight(offset, by_place) : filter.weight(offset));
            if (slopes) store(&slope[k][0], -by_place);
        }
        alignas(64) S f[W];
        store(&f[0], at.first);
        for (int i = 0; i < W; ++i)  // places far away stay so; what is no number lies far away
            first[i] = int32_t(std::min(std::max(S(-1e9), f[i]), S(1e9)));
    }
};

// Both axes. `for_places` visits n places: visit(k, i), their weights being in lane i; `for_packets` packets of them:
// visit(k, n), those of places k to k + n being in the first n lanes.
template <class F>
struct SplatAxes {
    using S = ScalarOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);
    SplatAxis<F> x, y;

    // Whether lane i may follow lane `begin` in RunWeights.
    bool near(int begin, int i) const {
        return std::abs(x.first[i] - x.first[begin]) <= 1 && std::abs(y.first[i] - y.first[begin]) <= 1;
    }

    static F load_some(const S *from, size_t lanes) {
        if (lanes == W) return load<F>(from);
        alignas(64) S some[W] = {};
        for (size_t i = 0; i < lanes; ++i) some[i] = from[i];
        return load<F>(some);
    }
    template <class Visit>
    void for_packets(const Filter &filter, const S *xs, const S *ys, size_t n, bool slopes, Visit &&visit) {
        for (size_t k = 0; k < n; k += W) {
            const size_t lanes = std::min(W, n - k);
            x.set(filter, load_some(xs + k, lanes), slopes), y.set(filter, load_some(ys + k, lanes), slopes);
            visit(k, lanes);
        }
    }
    template <class Visit>
    void for_places(const Filter &filter, const S *xs, const S *ys, size_t n, bool slopes, Visit &&visit) {
        for_packets(filter, xs, ys, n, slopes, [&](size_t k, size_t lanes) {
            for (size_t i = 0; i < lanes; ++i) visit(k + i, int(i));
        });
    }
};

// The weights of lanes begin to end in all pixels along an axis that one of them reaches; 0 where another does not. No
// lane begins more than a pixel before or behind the first of them.
template <class F>
struct RunWeights {
    static constexpr int Most = SplatAxis<F>::Most + 2;
    int first, n;
    alignas(64) ScalarOf<F> weight[Most][Lanes<F>::Width];  // of pixel first + k, by lane

    RunWeights(const SplatAxis<F> &axis, int begin, int end) {
        const auto range = std::minmax_element(axis.first + begin, axis.first + end);
        first = *range.first, n = *range.second - first + axis.n;
        const IntOf<F> before = load<IntOf<F>>(axis.first) - first;
        for (int k = 0; k < n; ++k) {
            F w(0);
            for (int j = std::max(0, k - axis.n + 1); j <= std::min(k, n - axis.n); ++j)
                w = select(mask<F>(before == j), load<F>(axis.weight[k - j]), w);
            store(&weight[k][0], w);
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
// Samples k .. end of columns, with a filter that is not a box: run(first, axes, begin, end) of runs of samples that
// are near each other, lanes begin to end, sample `first` being in lane 0; one(k, place) of those that are not worth a
// run.
template <class F, class Columns, class Run, class One>
void for_film_runs(const Filter &filter, const Columns &at, size_t k, size_t end, Run &&run, One &&one) {
    constexpr int LeastRun = 2;  // a run visits more pixels than its samples, and has all lanes' weights there
    SplatAxes<F> axes;
    axes.for_packets(filter, at.film_x.at + k, at.film_y.at + k, end - k, false, [&](size_t from, size_t n) {
        for (int begin = 0, next; begin < int(n); begin = next) {
            for (next = begin + 1; next < int(n) && axes.near(begin, next);) ++next;
            if (next - begin >= LeastRun && run(k + from, axes, begin, next)) continue;
            for (int i = begin; i < next; ++i) one(k + from + size_t(i), FilmPlace<F>{0, 0, &axes, i});
        }
    });
}
// visit(place) of one alone.
template <class S, class Visit>
void for_film_place(const Filter &filter, S x, S y, Visit &&visit) {
    SplatAxes<S> axes;
    if (filter.reach() > 0) axes.x.set(filter, x, false), axes.y.set(filter, y, false);
    visit(FilmPlace<S>{int(std::floor(y)), int(std::floor(x)), filter.reach() > 0 ? &axes : nullptr, 0});
}

}  // namespace tr
