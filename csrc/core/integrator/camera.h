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
TR_INLINE Random4<F> choose_position(const PathConfig &config, const Columns &samples, bool lens, size_t i) {
    Entries<F> from(i);
    Random4<F> u = draw4<F>(config, from(samples.pixel), from(samples.sample), 0, lens ? 4 : 2);
    write(samples.film_x, i, F(IntOf<F>(from(samples.column))) + u.u[0]);
    write(samples.film_y, i, F(IntOf<F>(from(samples.row))) + u.u[1]);
    return u;
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
        r.choose_lens(draw4<F>(config, from(samples.pixel), from(samples.sample), 0, 4));
    return r;
}

}  // namespace tr
