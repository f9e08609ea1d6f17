// The film as kernels: an item is a wanted pixel, which adds the samples that reach it in the order of the CPU (see
// cpu/tile_schedule.h) and in double precision. So sums depend neither on the order of items nor on batches.
#pragma once

#include "core/film/filter.h"
#include "core/film/sums.h"
#include "core/state/queues.h"

namespace tr {

struct FillWords {
    static constexpr const char *Name = "tr::FillWords", *Header = "device/film_kernels.h";
    uint32_t *word;
    uint32_t value;

    TR_HD void operator()(uint32_t i) const { word[i] = value; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(word);
    }
};

// Samples of a batch that belong to one unit of the schedule, pixel by pixel of its rectangle, or of a list of them, in
// each `samples` from `first_sample` on. A unit that is longer than a batch opens in one and closes in another one.
struct FilmUnit {
    Rect rect;
    int32_t begin;         // the slot of its first sample, which is below 0 if that was in an earlier batch
    uint32_t first_pixel;  // where the list of its pixels begins, and
    uint32_t first_place;  // where they are in that list
    uint32_t samples, first_sample;
    bool opens, closes;
};

// The pixels that units have where they are not all of their rectangles; null: they are.
struct ListedPixels {
    const int32_t *pixel;  // (n, 2), row and column
    const int32_t *place;  // of each pixel of a unit's rectangle, its number in the unit or -1

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(pixel), visit(place);
    }
};

// Which sample every slot has. Units are in the order of their slots.
struct NumberSamples {
    static constexpr const char *Name = "tr::NumberSamples", *Header = "device/film_kernels.h";
    const FilmUnit *units;
    uint32_t n_units;
    ListedPixels list;
    SlotColumns<float> slots;

    TR_HD void operator()(uint32_t i) const {
        uint32_t low = 0, high = n_units;
        while (high - low > 1) {
            const uint32_t middle = (low + high) / 2;
            if (units[middle].begin <= int32_t(i))
                low = middle;
            else
                high = middle;
        }
        const FilmUnit &unit = units[low];
        const uint32_t k = uint32_t(int32_t(i) - unit.begin), pixel = k / unit.samples;
        const auto width = uint32_t(unit.rect.width());
        int32_t y = unit.rect.y0 + int32_t(pixel / width), x = unit.rect.x0 + int32_t(pixel % width);
        if (list.pixel) {
            const int32_t *at = list.pixel + 2 * (size_t(unit.first_pixel) + pixel);
            y = at[0], x = at[1];
        }
        slots.row.at[i] = uint32_t(y), slots.column.at[i] = uint32_t(x);
        slots.pixel.at[i] = pixel_number(y, x);
        slots.sample.at[i] = unit.first_sample + (k - pixel * unit.samples);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(units), list.for_pointers(visit), slots.for_arrays(visit);
    }
};

struct AddToFilm {
    static constexpr const char *Name = "tr::AddToFilm", *Header = "device/film_kernels.h";
    Filter filter;
    int32_t reach, colors, moments;
    const FilmUnit *units;
    uint32_t n_units, n_slots;
    ListedPixels list;
    const int32_t *targets;  // (n, 2), row and column of each wanted pixel; null: all of `wanted`
    Rect wanted;
    uint32_t first;       // of those of this launch
    double *sums, *open;  // by wanted pixel: of the film, and of the unit that is open, see FilmBlock
    SlotColumns<float> slots;

    TR_HD void operator()(uint32_t i) const {
        const uint32_t target = first + i;
        const auto width = uint32_t(wanted.width());
        const int32_t y = targets ? targets[2 * target] : wanted.y0 + int32_t(target / width),
                      x = targets ? targets[2 * target + 1] : wanted.x0 + int32_t(target % width);
        const int channels = colors + 2 + (moments ? 3 * moments + 1 : 0);
        double *film = sums + size_t(target) * size_t(channels), *block = open + size_t(target) * size_t(channels);
        for (uint32_t u = 0; u < n_units; ++u) {
            const FilmUnit &unit = units[u];
            const Rect near{max(unit.rect.y0, y - reach), max(unit.rect.x0, x - reach),
                            min(unit.rect.y1, y + reach + 1), min(unit.rect.x1, x + reach + 1)};
            if (near.y0 >= near.y1 || near.x0 >= near.x1) continue;
            if (unit.opens)
                for (int c = 0; c < channels; ++c) block[c] = 0;
            for (int32_t row = near.y0; row < near.y1; ++row)
                for (int32_t column = near.x0; column < near.x1; ++column) {
                    int32_t pixel = (row - unit.rect.y0) * unit.rect.width() + column - unit.rect.x0;
                    if (list.place) pixel = list.place[unit.first_place + uint32_t(pixel)];
                    if (pixel < 0) continue;
                    const int32_t begin = unit.begin + pixel * int32_t(unit.samples);
                    const int32_t end = min(begin + int32_t(unit.samples), int32_t(n_slots));
                    for (int32_t k = max(begin, 0); k < end; ++k) add(uint32_t(k), y, x, block);
                }
            if (unit.closes)
                for (int c = 0; c < channels; ++c) film[c] += block[c];
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(units), list.for_pointers(visit), visit(targets), visit(sums), visit(open), slots.for_arrays(visit);
    }

private:
    TR_HD void add(uint32_t k, int32_t y, int32_t x, double *block) const {
        double weight = 1;
        if (reach > 0) {
            const double wx = filter.weight<double>(x + 0.5 - double(slots.film_x[k])),
                         wy = filter.weight<double>(y + 0.5 - double(slots.film_y[k]));
            if (wx == 0 || wy == 0) return;
            weight = wy * wx;
        }
        double value[SpectrumSize + 1];
        for (int c = 0; c < colors; ++c) value[c] = double(slots.radiance[c][k]);
        value[colors] = double(slots.alpha[k]);
        add_sample(block, weight, value, colors + 1, moments);
    }
};

}  // namespace tr
