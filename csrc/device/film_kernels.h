// The film as kernels: an item is a wanted pixel, which adds the samples that reach it in the order of the CPU (see
// cpu/tile_schedule.h) and in double precision. So sums depend neither on the order of items nor on batches.
#pragma once

#include "core/film/filter.h"
#include "core/film/sums.h"
#include "core/state/queues.h"
#include "kernel_name.h"

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

// As many numbers of type S.
template <class S>
struct FillNumbers {
    static constexpr const char *Name = TR_KERNEL_NAME(FillNumbers), *Header = "device/film_kernels.h";
    S *number;
    S value;

    TR_HD void operator()(uint32_t i) const { number[i] = value; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(number);
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
    uint32_t first_own, n_pixels;  // where the OwnSamples of its pixels begin, if they have some, and how many
    bool opens, closes;
};

// Of a pixel with a number of samples of its own: where they begin in the unit, where those of the unit's pixels end
// behind the last one; the first of them; and how often each counts.
struct OwnSamples {
    uint32_t offset, first;
    double weight;
};

// The pixels that units have where they are not all of their rectangles; null: they are. And their samples where these
// are not as many in all; null: they are.
struct ListedPixels {
    const int32_t *pixel;  // (n, 2), row and column
    const int32_t *place;  // of each pixel of a unit's rectangle, its number in the unit or -1
    const OwnSamples *own = nullptr;

    // Slots of a unit's pixel.
    TR_HD int32_t begin_of(const FilmUnit &unit, uint32_t pixel) const {
        return unit.begin + int32_t(own ? own[unit.first_own + pixel].offset : pixel * unit.samples);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(pixel), visit(place), visit(own);
    }
};

// The last of n entries of which begins(i) says that it begins at or before something; of entry 0 it is so.
template <class Begins>
TR_HD uint32_t last_that(uint32_t n, Begins &&begins) {
    uint32_t low = 0, high = n;
    while (high - low > 1) {
        const uint32_t middle = (low + high) / 2;
        if (begins(middle))
            low = middle;
        else
            high = middle;
    }
    return low;
}

// Which sample every slot has, and as alpha how often it counts. Units are in the order of their slots.
template <class S>
struct NumberSamples {
    static constexpr const char *Name = TR_KERNEL_NAME(NumberSamples), *Header = "device/film_kernels.h";
    const FilmUnit *units;
    uint32_t n_units;
    ListedPixels list;
    SlotColumns<S> slots;

    TR_HD void operator()(uint32_t i) const {
        const auto slot = int32_t(i);
        const FilmUnit &unit = units[last_that(n_units, [&](uint32_t u) { return units[u].begin <= slot; })];
        const uint32_t k = uint32_t(slot - unit.begin);
        uint32_t pixel = 0, sample = 0;
        S weight = 1;
        if (list.own) {
            const OwnSamples *own = list.own + unit.first_own;
            pixel = last_that(unit.n_pixels, [&](uint32_t p) { return own[p].offset <= k; });
            sample = own[pixel].first + (k - own[pixel].offset), weight = S(own[pixel].weight);
        } else {
            pixel = k / unit.samples, sample = unit.first_sample + (k - pixel * unit.samples);
        }
        const auto width = uint32_t(unit.rect.width());
        int32_t y = unit.rect.y0 + int32_t(pixel / width), x = unit.rect.x0 + int32_t(pixel % width);
        if (list.pixel) {
            const int32_t *at = list.pixel + 2 * (size_t(unit.first_pixel) + pixel);
            y = at[0], x = at[1];
        }
        slots.row.at[i] = uint32_t(y), slots.column.at[i] = uint32_t(x);
        slots.pixel.at[i] = pixel_number(y, x);
        slots.sample.at[i] = sample;
        slots.alpha.at[i] = weight;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(units), list.for_pointers(visit), slots.for_arrays(visit);
    }
};

// Which samples of a batch reach a wanted pixel, the item of a launch.
template <class S>
struct FilmGather {
    Filter filter;
    int32_t reach;
    const FilmUnit *units;
    uint32_t n_units, n_slots;
    ListedPixels list;
    const int32_t *targets;  // (n, 2), row and column of each wanted pixel; null: all of `wanted`
    Rect wanted;
    uint32_t first;       // of those of this launch
    double *sums, *open;  // by wanted pixel: of the film, and of the unit that is open, see FilmBlock
    const S *film_x, *film_y;

    // Calls add(slot, weight, sums of the unit) for those of item i, of so many sums each.
    template <class Add>
    TR_HD void gather(uint32_t i, int channels, Add &&add) const {
        const uint32_t target = first + i;
        const auto width = uint32_t(wanted.width());
        const int32_t y = targets ? targets[2 * target] : wanted.y0 + int32_t(target / width),
                      x = targets ? targets[2 * target + 1] : wanted.x0 + int32_t(target % width);
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
                    const int32_t end = min(list.begin_of(unit, uint32_t(pixel) + 1), int32_t(n_slots));
                    for (int32_t k = max(list.begin_of(unit, uint32_t(pixel)), 0); k < end; ++k) {
                        const double weight = weight_of(uint32_t(k), y, x);
                        if (weight != 0) add(uint32_t(k), weight, block);
                    }
                }
            if (unit.closes)
                for (int c = 0; c < channels; ++c) film[c] += block[c];
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(units), list.for_pointers(visit), visit(targets), visit(sums), visit(open), visit(film_x), visit(film_y);
    }

private:
    TR_HD double weight_of(uint32_t k, int32_t y, int32_t x) const {
        if (reach == 0) return 1;
        return double(filter.weight_of(y, film_y[k])) * double(filter.weight_of(x, film_x[k]));
    }
};

// Radiance and alpha, and `moments` of radiance.
template <class S>
struct AddToFilm {
    static constexpr const char *Name = TR_KERNEL_NAME(AddToFilm), *Header = "device/film_kernels.h";
    FilmGather<S> film;
    int32_t colors, moments;
    SpectrumColumn<S> radiance;
    const S *alpha;

    TR_HD void operator()(uint32_t i) const {
        const int channels = colors + 2 + (moments ? 3 * moments + 1 : 0);
        film.gather(i, channels, [&](uint32_t k, double weight, double *block) {
            double value[SpectrumSize + 1];
            for (int c = 0; c < colors; ++c) value[c] = double(radiance[c][k]);
            value[colors] = double(alpha[k]);
            add_sample(block, weight, value, colors + 1, moments);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        film.for_pointers(visit), radiance.each(visit), visit(alpha);
    }
};

// Results of an image, see ImagePlaces; an item is a wanted pixel.
template <class S>
struct WriteImage {
    static constexpr const char *Name = TR_KERNEL_NAME(WriteImage), *Header = "device/film_kernels.h";
    const double *sums;
    int32_t channels, numbers, moments;
    ImagePlaces<S> to;

    TR_HD void operator()(uint32_t i) const { to.write(i, sums + size_t(i) * size_t(channels), numbers, moments); }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(sums), to.for_pointers(visit);
    }
};

// Outputs besides radiance: channel c of sample i is at[c * stride + i].
template <class S>
struct OutputValues {
    static constexpr int Most = 64;
    S *at;
    uint32_t stride;

    TR_HD S &operator()(int c, uint32_t i) const { return at[size_t(c) * size_t(stride) + i]; }
};

// Of a pixel the sums of n channels, then of the weights of samples that hit something, then of all weights.
template <class S>
struct AddOutputsToFilm {
    static constexpr const char *Name = TR_KERNEL_NAME(AddOutputsToFilm), *Header = "device/film_kernels.h";
    FilmGather<S> film;
    int32_t n;
    OutputValues<S> value;
    const S *hit;

    TR_HD void operator()(uint32_t i) const {
        film.gather(i, n + 2, [&](uint32_t k, double weight, double *block) {
            for (int c = 0; c < n; ++c) block[c] += weight * double(value(c, k));
            block[n] += weight * double(hit[k]);
            block[n + 1] += weight;
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        film.for_pointers(visit), visit(value.at), visit(hit);
    }
};

}  // namespace tr
