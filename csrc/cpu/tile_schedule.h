// What of a film is rendered, and in which order its samples are summed.
//
// Pixels belong to tiles, anchored to the film; the samples of a pixel to chunks. A tile and a chunk are a unit: its
// samples are summed into a block of their own, pixel by pixel in rows, sample by sample, and the blocks are added to
// the film in the order of the units. The order of all additions is therefore the same for any number of threads and
// for any crop or list of pixels of the film. An item is what a thread takes at once: so many whole units that a batch
// of paths is full.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "film.h"

namespace tr {

constexpr int TileSize = 16;        // pixels on a side
constexpr int64_t ChunkSize = 64;   // samples of a pixel
constexpr size_t BatchSize = 1024;  // paths that an item should have at least

struct Pixel {
    int32_t y, x;
};

// Part of a tile: the pixels in which samples are drawn, and a rectangle around the wanted ones that they reach.
struct Tile {
    Rect sampled, reached;
    const Pixel *list;  // those of `sampled` that count; null: all
    size_t n;
    const uint32_t *targets;  // the wanted pixels that are reached, by number; null: all of `reached`
    size_t n_targets;
    const uint32_t *counts = nullptr;  // samples of each pixel; null: the schedule's `spp`

    Pixel pixel(size_t i) const {
        if (list) return list[i];
        int w = sampled.width();
        return {sampled.y0 + int32_t(i) / w, sampled.x0 + int32_t(i) % w};
    }
};

// The units of an item: all chunks of some tiles, or some chunks of one tile. They are numbered tile by tile.
struct WorkItem {
    size_t tile, tiles;
    int64_t chunk, chunks;
    int64_t of;  // all chunks of these tiles
    size_t size() const { return tiles * size_t(chunks); }
    size_t tile_of(size_t unit) const { return tile + unit / size_t(chunks); }
    int64_t chunk_of(size_t unit) const { return chunk + int64_t(unit % size_t(chunks)); }
};

// Samples begin .. end of a pixel.
struct SampleRange {
    int64_t begin, end;
};

class TileSchedule {
public:
    // The rectangle `wanted`, samples being drawn in `window`; a sample reaches `reach` pixels.
    TileSchedule(const Rect &wanted, const Rect &window, int reach, int64_t spp);
    // A list of pixels of the film, in which one may occur twice. Memory and work go with its length.
    TileSchedule(const std::vector<Pixel> &wanted, const Rect &window, int reach, int64_t spp);

    // Gives every sampled pixel a number of samples of its own, tile by tile in the order of `Tile::pixel`.
    void allocate(std::vector<uint32_t> counts);

    int64_t spp() const { return spp_; }
    bool allocated() const { return !counts_.empty(); }
    size_t n_tiles() const { return is_list_ ? sampled_begin_.size() - 1 : size_t(rows_) * size_t(columns_); }
    size_t n_targets() const { return is_list_ ? wanted_.size() : area(rect_); }
    size_t n_results() const { return is_list_ ? results_.size() : area(rect_); }
    // The wanted pixel of a result: results are in the order in which they were asked for.
    size_t target_of(size_t result) const { return is_list_ ? results_[result] : result; }
    Pixel target(size_t i) const {
        if (is_list_) return wanted_[i];
        return {rect_.y0 + int32_t(i / size_t(rect_.width())), rect_.x0 + int32_t(i % size_t(rect_.width()))};
    }
    const Rect &rect() const { return rect_; }

    size_t n_items() const { return first_item_.empty() ? 0 : first_item_.back(); }
    WorkItem work_item(size_t item) const;
    Tile tile(size_t i) const;
    int64_t n_paths(size_t tile) const;
    // Of pixel i of the tile of a unit, those that belong to the unit. Chunks are of ChunkSize samples, or, where
    // pixels have numbers of their own, equal parts of all of them.
    SampleRange samples(const WorkItem &work, size_t unit, const Tile &tile, size_t i) const {
        int64_t chunk = work.chunk_of(unit);
        if (!tile.counts) return {chunk * ChunkSize, std::min(spp_, (chunk + 1) * ChunkSize)};
        int64_t n = tile.counts[i];
        return {n * chunk / work.of, n * (chunk + 1) / work.of};
    }

    // Calls f(number of the wanted pixel, row, column) for those that a tile reaches.
    template <class F>
    void for_targets(const Tile &tile, F &&f) const {
        if (tile.targets) {
            for (size_t i = 0; i < tile.n_targets; ++i) {
                Pixel p = wanted_[tile.targets[i]];
                f(size_t(tile.targets[i]), p.y, p.x);
            }
            return;
        }
        for (int y = tile.reached.y0; y < tile.reached.y1; ++y)
            for (int x = tile.reached.x0; x < tile.reached.x1; ++x)
                f(size_t(y - rect_.y0) * size_t(rect_.width()) + size_t(x - rect_.x0), y, x);
    }

private:
    static size_t area(const Rect &r) { return size_t(std::max(0, r.height())) * size_t(std::max(0, r.width())); }
    const uint32_t *counts(size_t tile) const { return counts_.empty() ? nullptr : &counts_[counts_begin_[tile]]; }
    int64_t n_chunks(size_t begin, size_t end) const;
    int64_t chunks_an_item(size_t begin, size_t end) const;
    Rect tile_rect(size_t i) const;
    size_t n_pixels(size_t tile) const;
    void make_items();

    bool is_list_;
    int64_t spp_;
    int reach_;
    Rect rect_{0, 0, 0, 0}, window_{0, 0, 0, 0};
    int y0_ = 0, x0_ = 0, rows_ = 0, columns_ = 0;  // the tiles of a rectangle
    // a list: distinct wanted pixels, the results they belong to, sampled pixels and reached ones by tile
    std::vector<Pixel> wanted_, sampled_;
    std::vector<uint32_t> results_, targets_;
    std::vector<size_t> sampled_begin_, targets_begin_;
    std::vector<Rect> sampled_rects_, reached_rects_;  // around them
    std::vector<uint32_t> counts_;                     // empty: all are spp_
    std::vector<size_t> counts_begin_;
    // groups, each a tile or several small ones: its first tile and its first item
    std::vector<size_t> first_item_;
    std::vector<uint32_t> first_tile_;
};

// Sums over the wanted pixels.
class Film {
public:
    Film(const TileSchedule &schedule, int channels)
        : schedule_(schedule), channels_(channels), sum_(schedule.n_targets() * size_t(channels), 0.0) {}

    const double *at(size_t target) const { return &sum_[target * size_t(channels_)]; }
    double *at(size_t target) { return &sum_[target * size_t(channels_)]; }
    int channels() const { return channels_; }
    const double *sums() const { return sum_.data(); }

    void add(const Tile &tile, const FilmBlock &block) {
        schedule_.for_targets(tile, [&](size_t target, int y, int x) {
            double *to = at(target);
            const double *from = block.at(y, x);
            for (int c = 0; c < channels_; ++c) to[c] += from[c];
        });
    }

private:
    const TileSchedule &schedule_;
    int channels_;
    std::vector<double> sum_;
};

}  // namespace tr
