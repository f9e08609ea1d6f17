// Light paths, and their derivatives: as render_paths.cpp, but what a path brings may be anywhere on the film. The
// items of the schedule are divided into groups, as many whatever the number of threads; a group has a film of its own,
// and films are added, in double precision, in the order of their groups.
#include <array>
#include <optional>

#include "light_tile.h"
#include "render_response.h"
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

// What is splatted apart: radiance, or the components of Stokes vectors.
template <class S>
size_t n_parts(const RenderCall<S> &call) {
    return call.config.stokes ? 4 : 1;
}
template <class T, class S>
std::vector<SplatFilm<T>> empty_films(const RenderCall<S> &call) {
    return std::vector<SplatFilm<T>>(n_parts(call), SplatFilm<T>(call.crop));
}

// Sums up films in the order of their numbers, whoever finishes first.
template <class S>
class OrderedFilms {
public:
    using Films = std::vector<SplatFilm<S>>;
    explicit OrderedFilms(const RenderCall<S> &call) : total(empty_films<double>(call)) {}
    std::vector<SplatFilm<double>> total;

    void push(size_t number, Films films) {
        std::lock_guard<std::mutex> lock(mutex_);
        waiting_.emplace(number, std::move(films));
        for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(++next_)) {
            for (size_t p = 0; p < total.size(); ++p) total[p].add(it->second[p]);
            waiting_.erase(it);
        }
    }

private:
    std::mutex mutex_;
    std::map<size_t, Films> waiting_;
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
    template <class Column>
    static std::array<S *, SpectrumSize> arrays(const Column &column) {
        return {column[0], column[1], column[2]};
    }

private:
    const PathConfig &config_;
    const SlotColumns<S> &slots_;
};

// What the connections of a level bring to the film's channels, part by part.
template <class F>
class ConnectionParts {
    using S = ScalarOf<F>;

public:
    using Values = std::array<S *, SpectrumSize>;

    ConnectionParts(const RenderCall<S> &call, const SlotColumns<S> &slots) : channels(call, slots), call_(call) {}
    ConnectionChannels<F> channels;

    // Those on the tape: of polarised light what is brought, and then all of their adjoints.
    std::vector<SpectrumColumn<S>> columns(const TapeColumns<S> &level) const {
        if (!call_.config.stokes) return {level.outgoing.emitted};
        return {level.outgoing.emitted, level.connected.q, level.connected.u, level.connected.v};
    }
    // By connection; they hold until the next call. `level`: of the tape, null where none is recorded.
    const std::vector<Values> &brought(const TapeColumns<S> *level, const ShadowQueue<S> &free) {
        for (const Values &part : spectra(level, free)) channels.to_channels(free.slot.at, free.n, part);
        return values_;
    }
    // ... at the paths' wavelengths.
    const std::vector<Values> &spectra(const TapeColumns<S> *level, const ShadowQueue<S> &free) {
        values_.clear();
        if (!call_.config.stokes) {
            values_.push_back(channels.arrays(free.contribution));
        } else {
            numbers_.resize(n_parts(call_) * SpectrumSize);
            size_t k = 0;
            for (const SpectrumColumn<S> &column : columns(*level)) {
                Values &part = values_.emplace_back();
                for (int c = 0; c < SpectrumSize; ++c, ++k) {
                    numbers_[k].resize(free.n);
                    for (uint32_t i = 0; i < free.n; ++i) numbers_[k][i] = column[c][free.position[i]];
                    part[size_t(c)] = numbers_[k].data();
                }
            }
        }
        return values_;
    }

private:
    const RenderCall<S> &call_;
    std::vector<std::vector<S>> numbers_;
    std::vector<Values> values_;
};

template <class F, class Values>
void splat_connections(const Filter &filter, const ShadowQueue<ScalarOf<F>> &free, const std::vector<Values> &parts,
                       std::vector<SplatFilm<ScalarOf<F>>> &films, SplatAxes<F> &axes) {
    axes.for_places(filter, free.film_x.at, free.film_y.at, free.n, false, [&](size_t k, int lane) {
        for (size_t p = 0; p < parts.size(); ++p) {
            typename SplatFilm<ScalarOf<F>>::Vector value{};
            for (int c = 0; c < SpectrumSize; ++c) value[c] = parts[p][size_t(c)][k];
            films[p].splat(axes.x, axes.y, lane, value);
        }
    });
}

// The image's derivative along a tangent, of the connections of one level at a time: its sweeps give the derivatives
// of what they bring, part by part and component by component, and of their places.
template <class F>
class LightTangents {
    using S = ScalarOf<F>;
    using Numbers = std::array<std::vector<S>, SpectrumSize>;

public:
    LightTangents(const RenderCall<S> &call, const DerivativeCall<S> &derivative)
        : call_(call), derivative_(derivative) {}

    // Before its sweep a level hands on nothing.
    void keep(int level, const ShadowQueue<S> &free, const std::vector<typename ConnectionParts<F>::Values> &brought,
              const std::vector<SpectrumColumn<S>> &columns) {
        for (const SpectrumColumn<S> &column : columns)
            for (uint32_t k = 0; k < free.n; ++k)
                for (int c = 0; c < SpectrumSize; ++c) column[c][free.position[k]] = S(0);
        if (size_t(level) >= levels_.size()) levels_.resize(size_t(level) + 1);
        Kept &kept = levels_[size_t(level)];
        auto copy = [&](auto &to, const auto *from) { to.assign(from, from + free.n); };
        copy(kept.x, free.film_x.at), copy(kept.y, free.film_y.at);
        copy(kept.slot, free.slot.at), copy(kept.position, free.position.at);
        kept.value.resize(brought.size());
        for (size_t p = 0; p < brought.size(); ++p)
            for (size_t c = 0; c < SpectrumSize; ++c) copy(kept.value[p][c], brought[p][c]);
    }

    void sweep(LightTile<F> &tile, size_t n, const ConnectionParts<F> &parts, std::vector<SplatFilm<S>> &films) {
        GradientSink<F> sink = derivative_.template forward_sink<F>();
        const bool moves = derivative_.needs.geometry, apart = moves || (call_.config.stokes && tile.numbers());
        for (size_t level = 0; level < levels_.size(); ++level) {
            Kept &kept = levels_[level];
            if (kept.slot.empty()) continue;
            const TapeColumns<S> &tape = tile.wavefront.tape[int(level)].columns;
            const std::vector<SpectrumColumn<S>> columns = parts.columns(tape);
            // what connections hand to the sweep: of a part all of the spectrum or a component of it, or the place
            constexpr int Nothing = -1, All = -2;
            auto set_adjoints = [&](size_t part, int what) {
                for (uint32_t at : kept.position) {
                    for (size_t p = 0; p < columns.size(); ++p)
                        for (int c = 0; c < SpectrumSize; ++c)
                            columns[p][c][at] = S(p == part && (what == All || what == c) ? 1 : 0);
                    tape.connection.x_bar[at] = S(what == PlaceX ? 1 : 0);
                    tape.connection.y_bar[at] = S(what == PlaceY ? 1 : 0);
                }
            };
            auto sweep_for = [&](size_t part, int what, int component, std::vector<S> *to, int components) {
                set_adjoints(part, what);
                for (int c = 0; c < SpectrumSize; ++c) std::fill_n(tile.slots.radiance[c], n, S(0));
                sink.component = component;
                tile.sweep(sink);
                for (int c = component; c < component + components; ++c, ++to)
                    for (uint32_t slot : kept.slot) to->push_back(tile.slots.radiance[c][slot]);
            };
            std::vector<Numbers> change(columns.size());
            std::vector<S> place[2];
            for (size_t p = 0; p < columns.size(); ++p) {
                if (!apart) sweep_for(p, All, 0, change[p].data(), call_.values);
                for (int c = 0; apart && c < call_.values; ++c) sweep_for(p, c, c, &change[p][size_t(c)], 1);
            }
            if (moves) sweep_for(0, PlaceX, 0, &place[0], 1), sweep_for(0, PlaceY, 0, &place[1], 1);
            set_adjoints(0, Nothing);  // they count no more
            for (Numbers &d : change)
                parts.channels.to_channels(kept.slot.data(), kept.slot.size(), {d[0].data(), d[1].data(), d[2].data()});
            splat(kept, change, moves ? place : nullptr, films);
            kept.slot.clear();
        }
    }

private:
    static constexpr int PlaceX = SpectrumSize, PlaceY = SpectrumSize + 1;

    struct Kept {
        std::vector<S> x, y;
        std::vector<Numbers> value;
        std::vector<uint32_t> slot, position;
    };

    void splat(const Kept &kept, const std::vector<Numbers> &change, const std::vector<S> *place,
               std::vector<SplatFilm<S>> &films) {
        axes_.for_places(call_.filter, kept.x.data(), kept.y.data(), kept.x.size(), true, [&](size_t k, int lane) {
            for (size_t p = 0; p < films.size(); ++p) {
                typename SplatFilm<S>::Vector d{}, value{};
                for (size_t c = 0; c < size_t(call_.values); ++c)
                    d[c] = change[p][c][k], value[c] = kept.value[p][c][k];
                films[p].splat(axes_.x, axes_.y, lane, d);
                if (place) films[p].splat_motion(axes_.x, axes_.y, lane, place[0][k], place[1][k], value);
            }
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
    ConnectionParts<F> parts;
    RenderStats take_stats() { return paths.take_stats(); }

    SplattingTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : paths(call, capacity, derivative), parts(call, paths.slots) {
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
        const size_t film_bytes = 16 * n_parts(call) * (size_t(call.film_height) * size_t(call.film_width) + 1);
        const size_t affordable =
            std::max<size_t>(4, (size_t(1) << 30) / film_bytes);  // films that wait for an earlier one
        const size_t groups = std::min({schedule.n_items(), fitting, affordable});
        OrderedFilms<S> films(call);
        const bool recording = derivative || call.config.stokes;
        auto make = [&](int) { return std::make_unique<Tile>(call, capacity, derivative); };
        run_tiles(groups, call, Assignment::Dynamic, stats, make, [&](Tile &tile, size_t group, int, auto &&stop) {
            std::vector<SplatFilm<S>> own = empty_films<S>(call);
            const size_t end = schedule.n_items() * (group + 1) / groups;
            auto visit = [&](int level, const ShadowQueue<S> &free) {
                const TapeColumns<S> *tape = recording ? &tile.paths.wavefront.tape[level].columns : nullptr;
                const auto &brought = tile.parts.brought(tape, free);
                if (derivative)
                    tile.tangents->keep(level, free, brought, tile.parts.columns(*tape));
                else
                    splat_connections<F>(call.filter, free, brought, own, tile.axes);
            };
            for (size_t item = schedule.n_items() * group / groups; item < end && !stop(); ++item)
                for_batches(tile.paths.slots, call, schedule, item, capacity, stop,
                            [&](size_t n, const std::vector<Span> &) {
                                tile.paths.run(n, recording, stop, visit);
                                if (derivative) tile.tangents->sweep(tile.paths, n, tile.parts, own);
                            });
            films.push(group, std::move(own));
        });
        if (stats.interrupted) return stats;
        const int values = call.values, numbers = call.numbers();
        if (sums) sums->begin(n_results(call) * size_t(numbers), call.spp);
        const LightScale<S> scale(call, sums ? sums->spp : call.spp);
        for_results(call, [&](size_t i, int row, int column) {
            const double s = scale(row, column);
            double total[4 * SpectrumSize];
            for (size_t part = 0; part < films.total.size(); ++part)
                for (int c = 0; c < values; ++c)
                    total[int(part) * values + c] = double(films.total[part].at(row, column)[c]);
            const double *p = sums ? sums->add(i * size_t(numbers), total, numbers) : total;
            for (int c = 0; c < numbers; ++c) image[i * size_t(numbers) + size_t(c)] = S(p[c] * s);
        });
    }
    return stats;
}

// The gradient of an image's pixels as sums are splatted.
template <class S>
std::vector<SplatFilm<S>> adjoint_films(const RenderCall<S> &call, const S *adjoint) {
    std::vector<SplatFilm<S>> films = empty_films<S>(call);
    const LightScale<S> scale(call, call.spp);
    for_results(call, [&](size_t i, int row, int column) {
        const double s = scale(row, column);
        const S *from = adjoint + i * size_t(call.numbers());
        for (size_t p = 0; p < films.size(); ++p)
            for (int c = 0; c < call.values; ++c)
                films[p].at(row, column)[c] += S(double(from[int(p) * call.values + c]) * s);
    });
    return films;
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
        const std::vector<AdjointFilm> adjoint = adjoint_films(call, derivative.adjoint);
        std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
        auto make = [&](int thread) {
            locals[size_t(thread)].allocate(derivative, thread);
            return std::make_unique<Tile>(call, capacity, &derivative);
        };
        run_tiles(schedule.n_items(), call, Assignment::Interleaved, stats, make,
                  [&](Tile &tile, size_t item, int thread, auto &&stop) {
                      SplatAxes<F> &axes = tile.axes;
                      auto collect = [&](int number, const ShadowQueue<S> &free) {
                          const TapeColumns<S> &level = tile.paths.wavefront.tape[number].columns;
                          const auto &brought = tile.parts.brought(&level, free);
                          const auto columns = tile.parts.columns(level);
                          axes.for_places(call.filter, free.film_x.at, free.film_y.at, free.n, true,
                                          [&](size_t k, int lane) {
                                              uint32_t at = free.position[k];
                                              S x_bar(0), y_bar(0);
                                              for (size_t p = 0; p < columns.size(); ++p) {
                                                  typename AdjointFilm::Vector sum, by_x, by_y;
                                                  adjoint[p].collect(axes.x, axes.y, lane, sum, by_x, by_y);
                                                  for (int c = 0; c < SpectrumSize; ++c) {
                                                      const S value = brought[p][size_t(c)][k];
                                                      columns[p][c][at] = sum[c];
                                                      x_bar += by_x[c] * value, y_bar += by_y[c] * value;
                                                  }
                                              }
                                              level.connection.x_bar[at] = x_bar, level.connection.y_bar[at] = y_bar;
                                          });
                          for (const auto &column : columns)
                              tile.parts.channels.each(
                                  free.slot.at, free.n, tile.parts.channels.arrays(column), free.position.at,
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

// See render_response.h.
template <class F>
RenderStats light_responses(const RenderCall<ScalarOf<F>> &call, const ScalarOf<F> *given, double *gradient) {
    using S = ScalarOf<F>;
    using Tile = SplattingTile<F>;
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    const TileSchedule schedule = schedule_of_light(call);
    const size_t capacity = 512;
    const std::vector<SplatFilm<S>> adjoint = adjoint_films(call, given);
    std::vector<ResponseSums> sums{size_t(call.threads)};
    auto make = [&](int) { return std::make_unique<Tile>(call, capacity, nullptr); };
    run_tiles(
        schedule.n_items(), call, Assignment::Interleaved, stats, make,
        [&](Tile &tile, size_t item, int thread, auto &&stop) {
            const SlotColumns<S> &slots = tile.paths.slots;
            auto visit = [&](int level, const ShadowQueue<S> &free) {
                const bool recorded = call.config.stokes;
                const auto &spectra =
                    tile.parts.spectra(recorded ? &tile.paths.wavefront.tape[level].columns : nullptr, free);
                SplatAxes<F> &axes = tile.axes;
                axes.for_places(call.filter, free.film_x.at, free.film_y.at, free.n, true, [&](size_t k, int lane) {
                    const uint32_t slot = free.slot[k];
                    const auto chosen = chosen_wavelengths<S>(call.config, slots.pixel[slot], slots.sample[slot]);
                    for (size_t p = 0; p < spectra.size(); ++p) {
                        typename SplatFilm<S>::Vector sum, by_x, by_y;
                        adjoint[p].collect(axes.x, axes.y, lane, sum, by_x, by_y);
                        sums[size_t(thread)].add(
                            chosen, [&](int j) { return sum[j]; }, [&](int c) { return spectra[p][size_t(c)][k]; });
                    }
                });
            };
            for_batches(slots, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &) {
                tile.paths.run(n, call.config.stokes, stop, visit);
            });
        });
    for (const ResponseSums &part : sums) part.add_to(gradient);
    return stats;
}

}  // namespace

template <class S>
RenderStats trace_light_responses(const RenderCall<S> &call, const S *adjoint, double *gradient) {
    return light_responses<PacketOf<S>>(call, adjoint, gradient);
}
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

#define TR_INSTANTIATE(S)                                                                   \
    template RenderStats trace_light(const RenderCall<S> &, S *, FilmSums *);               \
    template RenderStats trace_light_responses(const RenderCall<S> &, const S *, double *); \
    template RenderStats trace_light_reverse(const RenderCall<S> &, DerivativeCall<S> &);   \
    template RenderStats trace_light_forward(const RenderCall<S> &, const DerivativeCall<S> &, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
