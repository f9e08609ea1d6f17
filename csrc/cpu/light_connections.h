// What becomes of light paths' connections: values by channel of the film, splats, and the derivative of splats along a
// tangent.
#pragma once

#include <array>

#include "light_film.h"
#include "light_tile.h"

namespace tr {

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

}  // namespace tr
