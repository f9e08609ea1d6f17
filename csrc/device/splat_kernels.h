// What light paths bring to the film, and the transposed of it. An item is a connection, and many reach one pixel:
// sums are FixedSums, whatever the order, of which a first launch measures and a second one adds.
#pragma once

#include "core/adjoint/fixed_sum.h"
#include "core/film/filter.h"
#include "core/film/sums.h"
#include "core/state/queues.h"
#include "entries.h"
#include "kernel_name.h"

namespace tr {

// The wanted rectangle of the film, and what of it a place reaches, as SplatAxes of the CPU.
struct SplatPlace {
    Filter filter;
    Rect film;
    int32_t values;  // of a pixel

    // Along an axis: visit(pixel, weight, slope) for those of low <= pixel < high; the slope is the weight's derivative
    // by the place.
    template <class S, class Visit>
    TR_HD void along(S at, int32_t low, int32_t high, Visit &&visit) const {
        const auto reached = filter.reached(at);
        const int32_t first = int32_t(min(max(reached.first, S(-1e9)), S(1e9)));  // places far away stay far away
        for (int32_t k = max(0, low - first), end = min(filter.pixels(), high - first); k < end; ++k) {
            S slope(0);
            const S weight = filter.weight(reached.offset(k), slope);
            visit(first + k, weight, -slope);
        }
    }
    // visit(number of the pixel, weight, slope along x, along y)
    template <class S, class Visit>
    TR_HD void for_pixels(S x, S y, Visit &&visit) const {
        along(y, film.y0, film.y1, [&](int32_t row, S wy, S sy) {
            along(x, film.x0, film.x1, [&](int32_t column, S wx, S sx) {
                visit(size_t(row - film.y0) * size_t(film.width()) + size_t(column - film.x0), wy * wx, wy * sx,
                      sy * wx);
            });
        });
    }
};

// Sums of the film, (pixels, values).
template <class S>
struct SplatSums {
    FixedSum<S> *at;
    bool measures;

    TR_HD void add(size_t i, S x) const {
        if (x == 0) return;
        measures ? at[i].measure(x) : at[i].add(x);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(at);
    }
};

// Connections of a launch, those that are free being Kept.
template <class S>
struct FreeConnections {
    ShadowQueue<S> of;
    EntryList rays;
    const int32_t *key;

    // Calls f(entry) for item k if it is free.
    template <class Do>
    TR_HD void at(uint32_t k, Do &&f) const {
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        if (key[i] != Gone) f(i);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        of.for_arrays(visit), rays.for_pointers(visit), visit(key);
    }
};

template <class S>
struct SplatConnections {
    static constexpr const char *Name = TR_KERNEL_NAME(SplatConnections), *Header = "device/splat_kernels.h";
    SplatPlace place;
    FreeConnections<S> connections;
    SplatSums<S> film;

    TR_HD void operator()(uint32_t k) const {
        connections.at(k, [&](uint32_t i) {
            const ShadowQueue<S> &of = connections.of;
            place.for_pixels(of.film_x[i], of.film_y[i], [&](size_t pixel, S weight, S, S) {
                for (int c = 0; c < place.values; ++c)
                    film.add(pixel * size_t(place.values) + size_t(c), of.contribution[c][i] * weight);
            });
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        connections.for_pointers(visit), film.for_pointers(visit);
    }
};

// What connections on the tape have for the sweep: the adjoint of what they bring, in each component, and of their
// places.
template <class S>
struct ConnectionAdjoints {
    SpectrumColumn<S> value;
    NumberColumn<S> x, y;

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        value.each(visit), x.each(visit), y.each(visit);
    }
};

// ... in reverse mode.
template <class S>
struct CollectConnections {
    static constexpr const char *Name = TR_KERNEL_NAME(CollectConnections), *Header = "device/splat_kernels.h";
    static constexpr int Stride = 4;
    SplatPlace place;
    FreeConnections<S> connections;
    const S *film;  // adjoints of its sums, (pixels, Stride)
    ConnectionAdjoints<S> to;

    TR_HD void operator()(uint32_t k) const {
        connections.at(k, [&](uint32_t i) {
            const ShadowQueue<S> &of = connections.of;
            S sum[SpectrumSize] = {}, by_x[SpectrumSize] = {}, by_y[SpectrumSize] = {};
            place.for_pixels(of.film_x[i], of.film_y[i], [&](size_t pixel, S weight, S slope_x, S slope_y) {
                for (int c = 0; c < place.values; ++c) {
                    const S adjoint = film[Stride * pixel + size_t(c)];
                    sum[c] += weight * adjoint, by_x[c] += slope_x * adjoint, by_y[c] += slope_y * adjoint;
                }
            });
            const uint32_t at = of.position[i];
            S x_bar = 0, y_bar = 0;
            for (int c = 0; c < SpectrumSize; ++c) {
                to.value[c][at] = sum[c];
                x_bar += by_x[c] * of.contribution[c][i], y_bar += by_y[c] * of.contribution[c][i];
            }
            to.x[at] = x_bar, to.y[at] = y_bar;
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        connections.for_pointers(visit), visit(film), to.for_pointers(visit);
    }
};

// By entry of the tape in forward mode: the place of a connection and what it brings, which count where `free` is not
// 0.
#define TR_SPLAT_COLUMNS(X) X(Number, x) X(Number, y) X(Spectrum, value) X(Index, free)
template <class S>
struct KeptConnections {
    TR_COLUMNS(TR_SPLAT_COLUMNS)
};

// Before the sweeps for them they hand on nothing.
template <class S>
struct KeepConnections {
    static constexpr const char *Name = TR_KERNEL_NAME(KeepConnections), *Header = "device/splat_kernels.h";
    FreeConnections<S> connections;
    KeptConnections<S> kept;
    ConnectionAdjoints<S> to;

    TR_HD void operator()(uint32_t k) const {
        connections.at(k, [&](uint32_t i) {
            const ShadowQueue<S> &of = connections.of;
            const uint32_t at = of.position[i];
            kept.x[at] = of.film_x[i], kept.y[at] = of.film_y[i], kept.free[at] = 1;
            for (int c = 0; c < SpectrumSize; ++c) kept.value[c][at] = of.contribution[c][i], to.value[c][at] = 0;
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        connections.for_pointers(visit), kept.for_arrays(visit), to.for_pointers(visit);
    }
};

// What a sweep in forward mode is for: the values of connections or of these a component, or their place.
struct SplatPart {
    static constexpr int32_t Nothing = -1, All = -2, PlaceX = SpectrumSize, PlaceY = SpectrumSize + 1;
    int32_t which;

    TR_HD bool has(int component) const { return which == All || which == component; }
    TR_HD bool moves() const { return which == PlaceX || which == PlaceY; }
};

// The adjoints of a level's entries in such a sweep.
template <class S>
struct SetAdjoints {
    static constexpr const char *Name = TR_KERNEL_NAME(SetAdjoints), *Header = "device/splat_kernels.h";
    SplatPart part;
    KeptConnections<S> kept;
    ConnectionAdjoints<S> to;

    TR_HD void operator()(uint32_t i) const {
        if (kept.free[i] == 0) return;
        for (int c = 0; c < SpectrumSize; ++c) to.value[c][i] = part.has(c) ? S(1) : S(0);
        to.x[i] = part.which == SplatPart::PlaceX ? S(1) : S(0),
        to.y[i] = part.which == SplatPart::PlaceY ? S(1) : S(0);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        kept.for_arrays(visit), to.for_pointers(visit);
    }
};

// What it has found, by slot: changes of values, or in the first component that of a place.
template <class S>
struct SplatTangents {
    static constexpr const char *Name = TR_KERNEL_NAME(SplatTangents), *Header = "device/splat_kernels.h";
    SplatPart part;
    SplatPlace place;
    KeptConnections<S> kept;
    const uint32_t *slot;  // by entry
    SpectrumColumn<S> change;
    SplatSums<S> film;

    TR_HD void operator()(uint32_t i) const {
        if (kept.free[i] == 0) return;
        const uint32_t s = slot[i];
        place.for_pixels(kept.x[i], kept.y[i], [&](size_t pixel, S weight, S slope_x, S slope_y) {
            const S moved = (part.which == SplatPart::PlaceX ? slope_x : slope_y) * change[0][s];
            for (int c = 0; c < place.values; ++c) {
                const size_t at = pixel * size_t(place.values) + size_t(c);
                if (part.moves())
                    film.add(at, kept.value[c][i] * moved);
                else if (part.has(c))
                    film.add(at, change[c][s] * weight);
            }
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        kept.for_arrays(visit), visit(slot), change.each(visit), film.for_pointers(visit);
    }
};

}  // namespace tr
