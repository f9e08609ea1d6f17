// The film of a rendering on a device: which pixels and samples there are, their sums, and the adjoint of these.
#include "device_work.h"

namespace tr {

template <class S>
ListedPixels DevicePaths<S>::list_pixels(const TileSchedule &schedule, std::vector<TileList> &lists) {
    std::vector<int32_t> pixels, places;
    lists.resize(schedule.n_tiles());
    for (size_t i = 0; i < schedule.n_tiles(); ++i) {
        const Tile tile = schedule.tile(i);
        const Rect &rect = tile.sampled;
        lists[i] = {uint32_t(pixels.size() / 2), uint32_t(places.size())};
        places.resize(places.size() + size_t(rect.height()) * size_t(rect.width()), -1);
        for (size_t p = 0; p < tile.n; ++p) {
            const Pixel at = tile.pixel(p);
            pixels.insert(pixels.end(), {at.y, at.x});
            places[lists[i].place + size_t(at.y - rect.y0) * size_t(rect.width()) + size_t(at.x - rect.x0)] =
                int32_t(p);
        }
    }
    pixels_.upload(launcher_, pixels.data(), pixels.size());
    places_.upload(launcher_, places.data(), places.size());
    return {pixels_.get(), places_.get()};
}

template <class S>
void DevicePaths<S>::begin_film(const Work &work, int channels) {
    const TileSchedule &schedule = work.schedule;
    const size_t n = schedule.n_targets() * size_t(channels);
    if (schedule.n_targets() > UINT32_MAX / (2 * size_t(channels)))
        throw std::invalid_argument("device: the image has too many pixels");
    if (work.call.pixels) {
        std::vector<int32_t> targets;
        for (size_t i = 0; i < schedule.n_targets(); ++i) {
            const Pixel at = schedule.target(i);
            targets.insert(targets.end(), {at.y, at.x});
        }
        targets_.upload(launcher_, targets.data(), targets.size());
    }
    sums_.reserve(launcher_, n), open_.reserve(launcher_, n);
    clear(launcher_, sums_.get(), n), clear(launcher_, open_.get(), n);
}

template <class S>
void DevicePaths<S>::number_samples(Work &work, const SampleNumbers &batch) {
    units_.upload(launcher_, batch.units.data(), batch.units.size());
    own_.upload(launcher_, batch.own.data(), batch.own.size());
    work.list.own = batch.own.empty() ? nullptr : own_.get();
    launcher_.run(NumberSamples<S>{units_.get(), uint32_t(batch.units.size()), work.list, at_.slots}, batch.size);
}

template <class S>
FilmGather<S> DevicePaths<S>::gather(const Work &work, const SampleNumbers &batch, const Filter &filter,
                                     uint32_t first) const {
    return {filter,
            int32_t(std::min(filter.reach(), MaxReach)),
            units_.get(),
            uint32_t(batch.units.size()),
            batch.size,
            work.list,
            work.call.pixels ? targets_.get() : nullptr,
            work.schedule.rect(),
            first,
            sums_.get(),
            open_.get(),
            at_.slots.film_x.at,
            at_.slots.film_y.at};
}

template <class S>
void DevicePaths<S>::add_to_film(const Work &work, const SampleNumbers &batch, int colors, int moments) {
    const auto [first, n_targets] = work.targets(batch.units);
    launcher_.run(AddToFilm<S>{gather(work, batch, work.call.filter, first), int32_t(colors), int32_t(moments),
                               at_.slots.radiance, at_.slots.alpha.at},
                  n_targets);
}

template <class S>
const double *DevicePaths<S>::download_film(const Work &work, int channels) {
    const size_t n = work.schedule.n_targets() * size_t(channels);
    auto *to = static_cast<double *>(film_.reserve(launcher_, n * sizeof(double)));
    sums_.download(to, n);
    return to;
}

// Results of radiance and alpha, in the host's memory or where they are said to be on the device.
template <class S>
void DevicePaths<S>::write_image(const Work &work, int moments, const RenderOutput<S> &out) {
    const RenderCall<S> &call = work.call;
    const int channels = FilmBlock::channels(call.values + 1, moments);
    if (call.pixels || out.sums) return write_results(call, work.schedule, download_film(work, channels), moments, out);
    const size_t n = work.schedule.n_results(), colors = size_t(call.values);
    const size_t each =
        colors * (1 + (out.to.variance != nullptr) + (out.to.second_moment != nullptr)) + (out.to.alpha != nullptr);
    results_.reserve(launcher_, n * each);
    struct Part {
        S *to, *from;
        size_t n;
    };
    std::vector<Part> parts;
    S *next = results_.get();
    const auto place = [&](S *to, size_t numbers) {
        if (to) parts.push_back({to, std::exchange(next, next + n * numbers), n * numbers});
        return to ? parts.back().from : nullptr;
    };
    const ImagePlaces<S> there{place(out.to.image, colors), place(out.to.alpha, 1), place(out.to.variance, colors),
                               place(out.to.second_moment, colors)};
    launcher_.run(WriteImage<S>{sums_.get(), channels, call.values, moments, there}, uint32_t(n));
    if (call.on_device.image) {
        for (const Part &part : parts) launcher_.copy(part.to, part.from, part.n * sizeof(S));
        return launcher_.synchronize();  // what went wrong is said
    }
    const auto all = size_t(next - results_.get());
    auto *here = static_cast<S *>(film_.reserve(launcher_, all * sizeof(S)));
    results_.download(here, all);
    for (const Part &part : parts) std::copy_n(here + (part.from - results_.get()), part.n, part.to);
}

// As adjoint_film.
template <class S>
void DevicePaths<S>::begin_adjoint(Work &work, const S *image, RenderStats &stats) {
    const bool box = work.call.filter.reach() == 0;
    if (!box) {
        begin_film(work, FilmBlock::channels(1, 0));
        for_batches(work, stats, true, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            launcher_.run(PlaceSamples<S>{work.call.config, at_.slots}, batch.size);
            add_to_film(work, batch, 0, 0);
        });
    }
    derivative_.begin_adjoint(launcher_, work.call, work.schedule, {image, work.call.values, work.call.on_device.image},
                              {box ? nullptr : sums_.get(), 0});  // which samples count for as often as they do
}

template class DevicePaths<float>;
template class DevicePaths<double>;

}  // namespace tr
