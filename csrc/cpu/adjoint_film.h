// The adjoint of an image as paths see it.
#pragma once

#include "work_items.h"

namespace tr {

// d loss / d (sum of weighted radiances) of every wanted pixel, of that of the image: (n, numbers). `weights`: the
// pixels' sums of them, see sum_weights.
template <class S>
std::unique_ptr<Film> adjoint_film(const RenderCall<S> &call, const TileSchedule &schedule, const Film &weights,
                                   const S *given) {
    const int values = call.numbers();
    auto adjoint = std::make_unique<Film>(schedule, values);
    for (size_t i = 0; i < schedule.n_results(); ++i) {
        size_t target = schedule.target_of(i);  // a pixel that was asked for twice has two results
        double total = *weights.at(target);
        if (total == 0) continue;
        for (int c = 0; c < values; ++c)
            adjoint->at(target)[c] += double(given[i * size_t(values) + size_t(c)]) / total;
    }
    return adjoint;
}

// The adjoints of the radiances of a batch.
template <class F>
void collect_adjoints(const RenderCall<ScalarOf<F>> &call, const std::vector<FilmBlock> &blocks,
                      const std::vector<Span> &spans, const SlotColumns<ScalarOf<F>> &slots) {
    using S = ScalarOf<F>;
    const bool box = call.filter.reach() == 0;  // asks for pixels only, whose samples follow each other
    const SpectrumColumn<S> parts[] = {slots.delta, slots.delta_q, slots.delta_u, slots.delta_v};
    const int n_parts = call.config.stokes ? 4 : 1;
    for_film_places<F>(call.filter, slots, spans, [&](const Span &span, size_t k, const FilmPlace<F> &place) {
        if (box && k > span.begin && slots.pixel[k] == slots.pixel[k - 1]) {
            for (int p = 0; p < n_parts; ++p)
                for (int c = 0; c < SpectrumSize; ++c) parts[p][c][k] = parts[p][c][k - 1];
            return;
        }
        double d[4 * SpectrumSize] = {};
        blocks[span.unit].collect(place, d);
        for (int p = 0; p < n_parts; ++p)
            for (int c = 0; c < SpectrumSize; ++c)
                parts[p][c][k] = c < call.values ? S(d[p * call.values + c] * span.weight) : S(0);
    });
}

}  // namespace tr
