// Light paths, and their derivatives: as render_paths.cpp, but what a path brings may be anywhere on the film. The
// items of the schedule are divided into groups, as many whatever the number of threads; a group has a film of its own,
// and films are added, in double precision, in the order of their groups.
#include <array>
#include <optional>

#include "light_tile.h"
#include "splat.h"
#include "work_items.h"

namespace tr {

namespace {

// Spp paths start in every pixel, taken as a stratum of the emitters.
template <class S>
TileSchedule schedule_of_light(const RenderCall<S> &call) {
    Rect film{0, 0, call.film_height, call.film_width};
    return TileSchedule(film, film, 0, call.spp);
}

// What sums over all paths are multiplied with, by row and column: the image is the average that the path tracer takes
// of a film with `sample_border`. Light counts beyond the film's edge, too, as far as filters reach: it may cross it
// when things move. A surface that measures ends at the film's edge, and so do the averages.
template <class S>
class LightScale {
public:
    LightScale(const RenderCall<S> &call, int64_t spp)
        : call_(call),
          paths_(double(spp) * call.film_height * call.film_width),
          measured_(call.scene->sensors[call.config.sensor].kind == IrradianceMeterKind) {}

    double operator()(int row, int column) const {
        return 1 / (paths_ * within(row, call_.film_height) * within(column, call_.film_width));
    }

private:
    double within(int pixel, int size) const {
        double center = pixel + 0.5;
        return measured_ ? call_.filter.integral(-center, size - center) : call_.filter.integral(-INFINITY, INFINITY);
    }
    const RenderCall<S> &call_;
    double paths_;
    bool measured_;
};

// The wanted pixels in the order of the results: visit(result, y, x).
template <class S, class Visit>
void for_results(const RenderCall<S> &call, Visit &&visit) {
    size_t i = 0;
    if (call.pixels) {
        for (const Pixel &p : *call.pixels) visit(i++, p.y, p.x);
        return;
    }
    for (int y = call.crop.y0; y < call.crop.y1; ++y)
        for (int x = call.crop.x0; x < call.crop.x1; ++x) visit(i++, y, x);
}

template <class S>
size_t n_results(const RenderCall<S> &call) {
    return call.pixels ? call.pixels->size() : size_t(call.crop.height()) * size_t(call.crop.width());
}

// Sums up films in the order of their numbers, whoever finishes first.
template <class S>
class OrderedFilms {
public:
    explicit OrderedFilms(const Rect &rect) : total(rect) {}
    SplatFilm<double> total;

    void push(size_t number, std::unique_ptr<SplatFilm<S>> film) {
        std::lock_guard<std::mutex> lock(mutex_);
        waiting_.emplace(number, std::move(film));
        for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(++next_)) {
            total.add(*it->second);
            waiting_.erase(it);
        }
    }

private:
    std::mutex mutex_;
    std::map<size_t, std::unique_ptr<SplatFilm<S>>> waiting_;
    size_t next_ = 0;
};

// In the spectral variant: what connections bring becomes channels of the film.
template <class F>
class ConnectionChannels {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

public:
    ConnectionChannels(const RenderCall<S> &call, const SlotColumns<S> &slots) : config_(call.config), slots_(slots) {}
    bool on() const { return config_.spectral.positions != nullptr; }

    // Of n entries that belong to these slots: value[c] becomes what map(weights, spectrum) makes of it, where `at`
    // says, or entry by entry without.
    template <class Map>
    void each(const uint32_t *slot, size_t n, const std::array<S *, SpectrumSize> &value, const uint32_t *at,
              Map &&map) const {
        if (!on()) return;
        for (size_t k = 0; k < n; k += W) {
            const LaneSet<F> lanes(slot + k, uint32_t(n - k));
            const auto m = lanes.active;
            alignas(64) uint32_t own[W], place[W];
            for (uint32_t i = 0; i < W; ++i) {
                const size_t j = std::min(k + i, n - 1);
                own[i] = slot[j], place[i] = at ? at[j] : uint32_t(j);
            }
            Gathered<F> path(load_uint<F>(own), m), entry(load_uint<F>(place), m);
            const FilmWeights<F> weights(config_.spectral,
                                         chosen_wavelengths<F>(config_, path(slots_.pixel), path(slots_.sample)));
            Spectrum<F> spectrum;
            for (int c = 0; c < SpectrumSize; ++c) spectrum[c] = entry.get(value[size_t(c)]);
            spectrum = map(weights, spectrum);
            for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(value[size_t(c)], entry.index, spectrum[c], m);
        }
    }
    void to_channels(const uint32_t *slot, size_t n, const std::array<S *, SpectrumSize> &value) const {
        each(slot, n, value, nullptr,
             [](const FilmWeights<F> &weights, const Spectrum<F> &x) { return weights.channels(x); });
    }
    void to_channels(const ShadowQueue<S> &free) const { to_channels(free.slot.at, free.n, arrays(free.contribution)); }
    template <class Column>
    static std::array<S *, SpectrumSize> arrays(const Column &column) {
        return {column[0], column[1], column[2]};
    }

private:
    const PathConfig &config_;
    const SlotColumns<S> &slots_;
};

template <class F>
void splat_connections(const Filter &filter, const ShadowQueue<ScalarOf<F>> &free, SplatFilm<ScalarOf<F>> &film,
                       SplatAxes<F> &axes) {
    const auto contribution = free.contribution;  // pointers that what is stored cannot change
    axes.for_places(filter, free.film_x.at, free.film_y.at, free.n, false, [&](size_t k, int lane) {
        typename SplatFilm<ScalarOf<F>>::Vector value{};
        for (int c = 0; c < SpectrumSize; ++c) value[c] = contribution[c][k];
        film.splat(axes.x, axes.y, lane, value);
    });
}

// The image's derivative along a tangent, of the connections of one level at a time: its sweeps give the derivatives
// of what they bring, component by component, and of their places.
template <class F>
class LightTangents {
    using S = ScalarOf<F>;

public:
    LightTangents(const RenderCall<S> &call, const DerivativeCall<S> &derivative)
        : call_(call), derivative_(derivative) {}

    void keep(int level, const ShadowQueue<S> &free) {
        if (size_t(level) >= levels_.size()) levels_.resize(size_t(level) + 1);
        Kept &kept = levels_[size_t(level)];
        auto copy = [&](auto &to, const auto *from) { to.assign(from, from + free.n); };
        copy(kept.x, free.film_x.at), copy(kept.y, free.film_y.at);
        copy(kept.slot, free.slot.at), copy(kept.position, free.position.at);
        for (int c = 0; c < SpectrumSize; ++c) copy(kept.value[c], free.contribution[c]);
    }

    void sweep(LightTile<F> &tile, size_t n, const ConnectionChannels<F> &channels, SplatFilm<S> &film) {
        GradientSink<F> sink = derivative_.template forward_sink<F>();
        const bool moves = derivative_.needs.geometry;
        for (size_t level = 0; level < levels_.size(); ++level) {
            Kept &kept = levels_[level];
            if (kept.slot.empty()) continue;
            const TapeColumns<S> &tape = tile.wavefront.tape[int(level)].columns;
            // what connections hand to the sweep: nothing, all of the spectrum, a component of it, or the place
            constexpr int Nothing = -1, All = -2;
            auto set_adjoints = [&](int what) {
                for (uint32_t at : kept.position) {
                    for (int c = 0; c < SpectrumSize; ++c)
                        tape.outgoing.emitted[c][at] = S(what == All || what == c ? 1 : 0);
                    tape.connection.x_bar[at] = S(what == PlaceX ? 1 : 0);
                    tape.connection.y_bar[at] = S(what == PlaceY ? 1 : 0);
                }
            };
            std::vector<S> d[SpectrumSize + 2];
            auto sweep_for = [&](int what, int component, std::vector<S> *to, int components) {
                set_adjoints(what);
                for (int c = 0; c < SpectrumSize; ++c) std::fill_n(tile.slots.radiance[c], n, S(0));
                sink.component = component;
                tile.sweep(sink);
                for (int c = component; c < component + components; ++c, ++to)
                    for (uint32_t slot : kept.slot) to->push_back(tile.slots.radiance[c][slot]);
            };
            if (moves) {
                for (int c = 0; c < call_.values; ++c) sweep_for(c, c, &d[c], 1);
                for (int place : {PlaceX, PlaceY}) sweep_for(place, 0, &d[place], 1);
            } else {
                sweep_for(All, 0, d, call_.values);
            }
            set_adjoints(Nothing);  // they count no more
            channels.to_channels(kept.slot.data(), kept.slot.size(), {d[0].data(), d[1].data(), d[2].data()});
            splat(kept, d, moves, film);
            kept.slot.clear();
        }
    }

private:
    static constexpr int PlaceX = SpectrumSize, PlaceY = SpectrumSize + 1;

    struct Kept {
        std::vector<S> x, y, value[SpectrumSize];
        std::vector<uint32_t> slot, position;
    };

    void splat(const Kept &kept, const std::vector<S> (&d)[SpectrumSize + 2], bool moves, SplatFilm<S> &film) {
        axes_.for_places(call_.filter, kept.x.data(), kept.y.data(), kept.x.size(), true, [&](size_t k, int lane) {
            typename SplatFilm<S>::Vector change{}, value{};
            for (int c = 0; c < call_.values; ++c) change[c] = d[c][k], value[c] = kept.value[c][k];
            film.splat(axes_.x, axes_.y, lane, change);
            if (moves) film.splat_motion(axes_.x, axes_.y, lane, d[PlaceX][k], d[PlaceY][k], value);
        });
    }

    const RenderCall<S> &call_;
    const DerivativeCall<S> &derivative_;
    std::vector<Kept> levels_;
    SplatAxes<F> axes_;
};

// Light paths, with what becomes of their connections.
template <class F>
struct SplattingTile {
    using S = ScalarOf<F>;
    LightTile<F> paths;
    SplatAxes<F> axes;
    std::optional<LightTangents<F>> tangents;
    ConnectionChannels<F> channels;
    RenderStats take_stats() { return paths.take_stats(); }

    SplattingTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : paths(call, capacity, derivative), channels(call, paths.slots) {
        if (derivative) tangents.emplace(call, *derivative);
    }
};

// Primal and, with a derivative, forward mode.
template <class F>
RenderStats splat_light(const RenderCall<ScalarOf<F>> &call, const DerivativeCall<ScalarOf<F>> *derivative,
                        ScalarOf<F> *image, FilmSums *sums) {
    using S = ScalarOf<F>;
    using Tile = SplattingTile<F>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = schedule_of_light(call);
        const size_t capacity = 512;
        // Enough for many threads, but few enough that adding up films is less work than tracing; not a matter of the
        // crop, whose pixels are to be those of the whole bit for bit.
        const size_t fitting = std::min<size_t>(64, std::max<size_t>(16, size_t(call.spp) / 4));
        const size_t film_bytes = 16 * (size_t(call.film_height) * size_t(call.film_width) + 1);
        const size_t affordable =
            std::max<size_t>(4, (size_t(1) << 30) / film_bytes);  // films that wait for an earlier one
        const size_t groups = std::min({schedule.n_items(), fitting, affordable});
        OrderedFilms<S> films(call.crop);
        auto make = [&](int) { return std::make_unique<Tile>(call, capacity, derivative); };
        run_tiles(groups, call, Assignment::Dynamic, stats, make, [&](Tile &tile, size_t group, int, auto &&stop) {
            auto film = std::make_unique<SplatFilm<S>>(call.crop);
            const size_t end = schedule.n_items() * (group + 1) / groups;
            auto visit = [&](int level, const ShadowQueue<S> &free) {
                tile.channels.to_channels(free);
                if (derivative)
                    tile.tangents->keep(level, free);
                else
                    splat_connections<F>(call.filter, free, *film, tile.axes);
            };
            for (size_t item = schedule.n_items() * group / groups; item < end && !stop(); ++item)
                for_batches(tile.paths.slots, call, schedule, item, capacity, stop,
                            [&](size_t n, const std::vector<Span> &) {
                                tile.paths.run(n, derivative != nullptr, stop, visit);
                                if (derivative) tile.tangents->sweep(tile.paths, n, tile.channels, *film);
                            });
            films.push(group, std::move(film));
        });
        if (stats.interrupted) return stats;
        const int values = call.values;
        if (sums) sums->begin(n_results(call) * size_t(values), call.spp);
        const LightScale<S> scale(call, sums ? sums->spp : call.spp);
        for_results(call, [&](size_t i, int row, int column) {
            const double s = scale(row, column);
            double total[SpectrumSize];
            for (int c = 0; c < values; ++c) total[c] = double(films.total.at(row, column)[c]);
            const double *p = sums ? sums->add(i * size_t(values), total, values) : total;
            for (int c = 0; c < values; ++c) image[i * size_t(values) + size_t(c)] = S(p[c] * s);
        });
    }
    return stats;
}

template <class F>
RenderStats reverse_light(const RenderCall<ScalarOf<F>> &call, DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    using Tile = SplattingTile<F>;
    using AdjointFilm = SplatFilm<S>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = schedule_of_light(call);
        const size_t capacity = 512;
        AdjointFilm adjoint(call.crop);
        const LightScale<S> scale(call, call.spp);
        const int values = call.values;
        for_results(call, [&](size_t i, int row, int column) {
            const double s = scale(row, column);
            for (int c = 0; c < values; ++c)
                adjoint.at(row, column)[c] += S(double(derivative.adjoint[i * size_t(values) + size_t(c)]) * s);
        });
        std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
        auto make = [&](int thread) {
            locals[size_t(thread)].allocate(derivative, thread);
            return std::make_unique<Tile>(call, capacity, &derivative);
        };
        run_tiles(
            schedule.n_items(), call, Assignment::Interleaved, stats, make,
            [&](Tile &tile, size_t item, int thread, auto &&stop) {
                SplatAxes<F> &axes = tile.axes;
                auto collect = [&](int number, const ShadowQueue<S> &free) {
                    const TapeColumns<S> &level = tile.paths.wavefront.tape[number].columns;
                    tile.channels.to_channels(free);
                    axes.for_places(call.filter, free.film_x.at, free.film_y.at, free.n, true, [&](size_t k, int lane) {
                        typename AdjointFilm::Vector sum, by_x, by_y;
                        adjoint.collect(axes.x, axes.y, lane, sum, by_x, by_y);
                        uint32_t at = free.position[k];
                        S x_bar(0), y_bar(0);
                        for (int c = 0; c < SpectrumSize; ++c) {
                            level.outgoing.emitted[c][at] = sum[c];
                            x_bar += by_x[c] * free.contribution[c][k], y_bar += by_y[c] * free.contribution[c][k];
                        }
                        level.connection.x_bar[at] = x_bar, level.connection.y_bar[at] = y_bar;
                    });
                    tile.channels.each(
                        free.slot.at, free.n, tile.channels.arrays(level.outgoing.emitted), free.position.at,
                        [](const FilmWeights<F> &weights, const Spectrum<F> &x) { return weights.pull(x); });
                };
                for_batches(tile.paths.slots, call, schedule, item, capacity, stop,
                            [&](size_t n, const std::vector<Span> &) {
                                tile.paths.run(n, true, stop, collect);
                                GradientSink<F> sink = locals[size_t(thread)].template sink<F>(derivative);
                                tile.paths.sweep(sink);
                            });
            });
        add_buffers(locals, derivative);
    }
    return stats;
}

}  // namespace

template <class S>
RenderStats trace_light(const RenderCall<S> &call, S *image, FilmSums *sums) {
    return splat_light<PacketOf<S>>(call, nullptr, image, sums);
}
template <class S>
RenderStats trace_light_forward(const RenderCall<S> &call, const DerivativeCall<S> &derivative, S *image) {
    return splat_light<PacketOf<S>>(call, &derivative, image, nullptr);
}
template <class S>
RenderStats trace_light_reverse(const RenderCall<S> &call, DerivativeCall<S> &derivative) {
    return reverse_light<PacketOf<S>>(call, derivative);
}

#define TR_INSTANTIATE(S)                                                                 \
    template RenderStats trace_light(const RenderCall<S> &, S *, FilmSums *);             \
    template RenderStats trace_light_reverse(const RenderCall<S> &, DerivativeCall<S> &); \
    template RenderStats trace_light_forward(const RenderCall<S> &, const DerivativeCall<S> &, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
