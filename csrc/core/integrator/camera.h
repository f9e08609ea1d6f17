// Where paths begin: camera rays.
#pragma once

#include "../sensor/camera.h"
#include "surface.h"

namespace tr {

// Of the samples in slots i on: their places on the film, and rays in the queue. `skip_zero_adjoint`: not of paths
// whose adjoint is zero.
template <class F>
TR_LARGE void start_paths(const PathContext<F> &c, ScalarOf<F> width, ScalarOf<F> height, bool skip_zero_adjoint,
                          uint32_t i, uint32_t n_slots, PathQueue<ScalarOf<F>> &out);

// The place of samples i on on the film, as start_paths chooses it; returns their numbers. `lens`: with those of a
// lens.
template <class F, class Columns>
TR_INLINE Random4<F> choose_position(const PathConfig &config, const Columns &samples, bool lens, size_t i,
                                     const CommonKeys *keys = nullptr) {
    Entries<F> from(i);
    const PathNumbers<F> numbers(config, from(samples.pixel), from(samples.sample), keys);
    Random4<F> u = numbers.draw(0, lens ? AllWanted : PairWanted);
    write(samples.film_x, i, F(IntOf<F>(from(samples.column))) + u.u[0]);
    write(samples.film_y, i, F(IntOf<F>(from(samples.row))) + u.u[1]);
    return u;
}

// The numbers that choose a sample's place on the lens.
template <class F>
TR_INLINE Random4<F> lens_numbers(const PathConfig &config, const UIntOf<F> &pixel, const UIntOf<F> &sample) {
    return PathNumbers<F>(config, pixel, sample).draw(0, ThirdWanted | FourthWanted);
}

// The camera's sample that these were.
template <class F, class Columns, class From>
TR_INLINE CameraSample<F> camera_sample(const PathConfig &config, const Record &sensor, const Columns &samples,
                                        const From &from) {
    CameraSample<F> r{from(samples.film_x), from(samples.film_y)};
    if (samples.lens.x) {
        const Vec2<F> lens = from(samples.lens);
        r.lens_x = lens.x, r.lens_y = lens.y;
    } else if (uses_lens(sensor))
        r.choose_lens(lens_numbers<F>(config, from(samples.pixel), from(samples.sample)));
    return r;
}

}  // namespace tr
