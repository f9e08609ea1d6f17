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

// A pixel of a batch: its samples, from this one on, have the slots from `begin` on.
struct SampledPixel {
    uint32_t begin;
    int32_t y, x;
    uint32_t sample;
};

// Which sample every slot has. Pixels are in the order of their slots.
struct NumberSamples {
    static constexpr const char *Name = "tr::NumberSamples", *Header = "device/film_kernels.h";
    const SampledPixel *pixels;
    uint32_t n_pixels;
    SlotColumns<float> slots;

    TR_HD void operator()(uint32_t i) const {
        uint32_t low = 0, high = n_pixels;
        while (high - low > 1) {
            const uint32_t middle = (low + high) / 2;
            if (pixels[middle].begin <= i)
                low = middle;
            else
                high = middle;
        }
        const SampledPixel &pixel = pixels[low];
        slots.row.at[i] = uint32_t(pixel.y), slots.column.at[i] = uint32_t(pixel.x);
        slots.pixel.at[i] = pixel_number(pixel.y, pixel.x);
        slots.sample.at[i] = pixel.sample + (i - pixel.begin);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(pixels), slots.for_arrays(visit);
    }
};

// Samples of a batch that belong to one unit of the schedule: the rectangle of its pixels, and where the spans of these
// are. A unit that is longer than a batch opens in one and closes in another one.
struct FilmUnit {
    Rect rect;
    uint32_t first_span;
    bool opens, closes;
};
// Samples begin .. end of a pixel.
struct FilmSpan {
    uint32_t begin, end;
};

struct AddToFilm {
    static constexpr const char *Name = "tr::AddToFilm", *Header = "device/film_kernels.h";
    Filter filter;
    int32_t reach, colors, moments;
    const FilmUnit *units;
    uint32_t n_units;
    const FilmSpan *spans;
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
                    const FilmSpan span = spans[unit.first_span + uint32_t((row - unit.rect.y0) * unit.rect.width() +
                                                                           column - unit.rect.x0)];
                    for (uint32_t k = span.begin; k < span.end; ++k) add(k, y, x, block);
                }
            if (unit.closes)
                for (int c = 0; c < channels; ++c) film[c] += block[c];
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(units), visit(spans), visit(targets), visit(sums), visit(open), slots.for_arrays(visit);
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
