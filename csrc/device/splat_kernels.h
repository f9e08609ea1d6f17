// What light paths bring to the film, and the transposed of it. An item is a connection, and many reach one pixel:
// sums are FixedSums, whatever the order, of which a first launch measures and a second one adds.
#pragma once

#include "core/adjoint/fixed_sum.h"
#include "core/film/filter.h"
#include "core/film/sums.h"
#include "core/state/queues.h"
#include "entries.h"

namespace tr {

// The wanted rectangle of the film, and what of it a place reaches, as SplatAxes of the CPU.
struct SplatPlace {
    Filter filter;
    int32_t reach;
    Rect film;
    int32_t values;  // of a pixel

    // Along an axis: visit(pixel, weight, slope) for those of low <= pixel < high; the slope is the weight's derivative
    // by the place.
    template <class Visit>
    TR_HD void along(float at, int32_t low, int32_t high, Visit &&visit) const {
        const float base = floor(at), from = base + (0.5f - float(reach)) - at;
        const int32_t first = int32_t(min(max(base, -1e9f), 1e9f)) - reach;  // places far away stay far away
        for (int32_t k = max(0, low - first), end = min(2 * reach + 1, high - first); k < end; ++k) {
            const float offset = from + float(k);
            visit(first + k, filter.weight(offset), -filter.slope(offset));
        }
    }
    // visit(number of the pixel, weight, slope along x, along y)
    template <class Visit>
    TR_HD void for_pixels(float x, float y, Visit &&visit) const {
        along(y, film.y0, film.y1, [&](int32_t row, float wy, float sy) {
            along(x, film.x0, film.x1, [&](int32_t column, float wx, float sx) {
                visit(size_t(row - film.y0) * size_t(film.width()) + size_t(column - film.x0), wy * wx, wy * sx,
                      sy * wx);
            });
        });
    }
};

// Sums of the film, (pixels, values).
struct SplatSums {
    FixedSum *at;
    bool measures;

    TR_HD void add(size_t i, float x) const {
        if (x == 0) return;
        measures ? at[i].measure(x) : at[i].add(x);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(at);
    }
};

// Connections of a launch, those that are free being Kept.
struct FreeConnections {
    ShadowQueue<float> of;
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

struct SplatConnections {
    static constexpr const char *Name = "tr::SplatConnections", *Header = "device/splat_kernels.h";
    SplatPlace place;
    FreeConnections connections;
    SplatSums film;

    TR_HD void operator()(uint32_t k) const {
        connections.at(k, [&](uint32_t i) {
            const ShadowQueue<float> &of = connections.of;
            place.for_pixels(of.film_x[i], of.film_y[i], [&](size_t pixel, float weight, float, float) {
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
struct ConnectionAdjoints {
    SpectrumColumn<float> value;
    NumberColumn<float> x, y;

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        value.each(visit), x.each(visit), y.each(visit);
    }
};

// ... in reverse mode.
struct CollectConnections {
    static constexpr const char *Name = "tr::CollectConnections", *Header = "device/splat_kernels.h";
    static constexpr int Stride = 4;
    SplatPlace place;
    FreeConnections connections;
    const float *film;  // adjoints of its sums, (pixels, Stride)
    ConnectionAdjoints to;

    TR_HD void operator()(uint32_t k) const {
        connections.at(k, [&](uint32_t i) {
            const ShadowQueue<float> &of = connections.of;
            float sum[SpectrumSize] = {}, by_x[SpectrumSize] = {}, by_y[SpectrumSize] = {};
            place.for_pixels(of.film_x[i], of.film_y[i], [&](size_t pixel, float weight, float slope_x, float slope_y) {
                for (int c = 0; c < place.values; ++c) {
                    const float adjoint = film[Stride * pixel + size_t(c)];
                    sum[c] += weight * adjoint, by_x[c] += slope_x * adjoint, by_y[c] += slope_y * adjoint;
                }
            });
            const uint32_t at = of.position[i];
            float x_bar = 0, y_bar = 0;
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
struct KeptConnections {
    using S = float;
    TR_COLUMNS(TR_SPLAT_COLUMNS)
};

// Before the sweeps for them they hand on nothing.
struct KeepConnections {
    static constexpr const char *Name = "tr::KeepConnections", *Header = "device/splat_kernels.h";
    FreeConnections connections;
    KeptConnections kept;
    ConnectionAdjoints to;

    TR_HD void operator()(uint32_t k) const {
        connections.at(k, [&](uint32_t i) {
            const ShadowQueue<float> &of = connections.of;
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
struct SetAdjoints {
    static constexpr const char *Name = "tr::SetAdjoints", *Header = "device/splat_kernels.h";
    SplatPart part;
    KeptConnections kept;
    ConnectionAdjoints to;

    TR_HD void operator()(uint32_t i) const {
        if (kept.free[i] == 0) return;
        for (int c = 0; c < SpectrumSize; ++c) to.value[c][i] = part.has(c) ? 1.f : 0.f;
        to.x[i] = part.which == SplatPart::PlaceX ? 1.f : 0.f, to.y[i] = part.which == SplatPart::PlaceY ? 1.f : 0.f;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        kept.for_arrays(visit), to.for_pointers(visit);
    }
};

// What it has found, by slot: changes of values, or in the first component that of a place.
struct SplatTangents {
    static constexpr const char *Name = "tr::SplatTangents", *Header = "device/splat_kernels.h";
    SplatPart part;
    SplatPlace place;
    KeptConnections kept;
    const uint32_t *slot;  // by entry
    SpectrumColumn<float> change;
    SplatSums film;

    TR_HD void operator()(uint32_t i) const {
        if (kept.free[i] == 0) return;
        const uint32_t s = slot[i];
        place.for_pixels(kept.x[i], kept.y[i], [&](size_t pixel, float weight, float slope_x, float slope_y) {
            const float moved = (part.which == SplatPart::PlaceX ? slope_x : slope_y) * change[0][s];
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
