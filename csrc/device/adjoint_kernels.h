// What is before and behind the sweep of a derivative: from the adjoint of the image to those of samples, and from
// copies of sums to the sums.
#pragma once

#include "core/adjoint/fixed_sum.h"
#include "film_kernels.h"

namespace tr {

// Wanted pixels by their place.
struct WantedPixels {
    Rect around;            // all of them
    const int32_t *number;  // of each pixel in there, -1: not wanted; null: they are numbered by rows

    TR_HD int32_t at(int32_t y, int32_t x) const {
        if (y < around.y0 || y >= around.y1 || x < around.x0 || x >= around.x1) return -1;
        const int32_t i = (y - around.y0) * around.width() + (x - around.x0);
        return number ? number[i] : i;
    }
};

// The adjoint of the image becomes that of the film's sums; see adjoint_film. An item is a wanted pixel.
template <class S>
struct DivideAdjoint {
    static constexpr const char *Name = TR_KERNEL_NAME(DivideAdjoint), *Header = "device/adjoint_kernels.h";
    const S *image;  // (n, channels)
    int32_t channels;
    const double *sums;  // (n, 2), of which number `of` is the sum of weights; null: that is `weight` everywhere
    int32_t of;
    double weight;
    double *to;

    TR_HD void operator()(uint32_t i) const {
        const double total = sums ? sums[2 * size_t(i) + size_t(of)] : weight;
        for (int32_t c = 0; c < channels; ++c) {
            const size_t at = size_t(i) * size_t(channels) + size_t(c);
            to[at] = total == 0 ? 0 : double(image[at]) / total;
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(image), visit(sums), visit(to);
    }
};

// What samples get of it; see FilmBlock::collect.
template <class S>
struct AdjointGather {
    Filter filter;
    int32_t reach, channels;
    WantedPixels wanted;
    const double *adjoint;
    SampleColumns<S> samples;

    // Adds to `to`, a number a channel.
    TR_HD void gather(uint32_t i, double *to) const {
        gather_at(int32_t(samples.row[i]), int32_t(samples.column[i]), samples.film_x[i], samples.film_y[i], to);
    }
    // ... of a place in this pixel.
    TR_HD void gather_at(int32_t row, int32_t column, S x, S y, double *to) const {
        if (reach == 0) return add(row, column, 1, to);
        for (int32_t r = row - reach; r <= row + reach; ++r) {
            const auto wy = double(filter.weight_of(r, y));
            for (int32_t k = column - reach; wy != 0 && k <= column + reach; ++k) {
                const auto wx = double(filter.weight_of(k, x));
                if (wx != 0) add(r, k, wy * wx, to);
            }
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(wanted.number), visit(adjoint), samples.for_arrays(visit);
    }

private:
    TR_HD void add(int32_t y, int32_t x, double weight, double *to) const {
        const int32_t target = wanted.at(y, x);
        if (target < 0) return;
        for (int32_t c = 0; c < channels; ++c) to[c] += weight * adjoint[size_t(target) * size_t(channels) + size_t(c)];
    }
};

// Of radiance, see collect_adjoints.
template <class S>
struct CollectAdjoints {
    static constexpr const char *Name = TR_KERNEL_NAME(CollectAdjoints), *Header = "device/adjoint_kernels.h";
    AdjointGather<S> from;
    const S *weight;  // how often a sample counts
    SpectrumColumn<S> delta;

    TR_HD void operator()(uint32_t i) const {
        double d[SpectrumSize] = {};
        from.gather(i, d);
        for (int c = 0; c < SpectrumSize; ++c) delta[c][i] = c < from.channels ? S(d[c] * double(weight[i])) : S(0);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        from.for_pointers(visit), visit(weight), delta.each(visit);
    }
};

// Of other outputs.
template <class S>
struct CollectOutputs {
    static constexpr const char *Name = TR_KERNEL_NAME(CollectOutputs), *Header = "device/adjoint_kernels.h";
    AdjointGather<S> from;
    OutputValues<S> value;

    TR_HD void operator()(uint32_t i) const {
        double d[OutputValues<S>::Most] = {};
        from.gather(i, d);
        for (int c = 0; c < from.channels; ++c) value(c, i) = S(d[c]);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        from.for_pointers(visit), visit(value.at);
    }
};

struct SumCopies {
    static constexpr const char *Name = "tr::SumCopies", *Header = "device/adjoint_kernels.h";
    const double *from;  // (n, copies)
    uint32_t copies;
    double *to;

    TR_HD void operator()(uint32_t i) const {
        double sum = 0;
        for (uint32_t k = 0; k < copies; ++k) sum += from[size_t(i) * size_t(copies) + k];
        to[i] = sum;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(from), visit(to);
    }
};

// Sums of a batch are added to those of all, and are zero again: of constants, of which there are copies, and vertices,
// in double precision; of texels as they are. One of both is null.
template <class S>
struct SettleSums {
    static constexpr const char *Name = TR_KERNEL_NAME(SettleSums), *Header = "device/adjoint_kernels.h";
    FixedSum<S> *from;  // (n, copies)
    uint32_t copies;
    double *to;
    S *to_texels;

    TR_HD void operator()(uint32_t i) const {
        double sum = 0;
        for (uint32_t k = 0; k < copies; ++k) {
            FixedSum<S> &each = from[size_t(i) * size_t(copies) + k];
            if (each.largest == 0) continue;
            sum += each.value();
            each = {};
        }
        if (to)
            to[i] += sum;
        else
            to_texels[i] += S(sum);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(from), visit(to), visit(to_texels);
    }
};

}  // namespace tr
