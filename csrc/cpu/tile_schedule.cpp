#include "tile_schedule.h"

#include <numeric>
#include <stdexcept>
#include <utility>

namespace tr {

namespace {

int floor_div(int a, int b) { return (a >= 0 ? a : a - b + 1) / b; }

Rect grown(const Rect &r, int by) { return {r.y0 - by, r.x0 - by, r.y1 + by, r.x1 + by}; }

// Sorts by tile, by row, by column.
struct Key {
    int32_t tile_y, tile_x, y, x;
    uint32_t index;
    bool operator<(const Key &o) const {
        if (tile_y != o.tile_y) return tile_y < o.tile_y;
        if (tile_x != o.tile_x) return tile_x < o.tile_x;
        if (y != o.y) return y < o.y;
        return x < o.x;
    }
    bool same_tile(const Key &o) const { return tile_y == o.tile_y && tile_x == o.tile_x; }
    bool same_pixel(const Key &o) const { return y == o.y && x == o.x; }
};

Key key_of(int y, int x, size_t index) {
    return {floor_div(y, TileSize), floor_div(x, TileSize), y, x, uint32_t(index)};
}

}  // namespace

TileSchedule::TileSchedule(const Rect &wanted, const Rect &window, int reach, int64_t spp)
    : is_list_(false),
      spp_(spp),
      reach_(reach),
      rect_(wanted),
      // samples that reach no wanted pixel are not drawn
      window_(intersect(window, grown(wanted, reach))) {
    y0_ = floor_div(window_.y0, TileSize), x0_ = floor_div(window_.x0, TileSize);
    rows_ = window_.height() > 0 ? floor_div(window_.y1 - 1, TileSize) - y0_ + 1 : 0;
    columns_ = window_.width() > 0 ? floor_div(window_.x1 - 1, TileSize) - x0_ + 1 : 0;
    make_items();
}

TileSchedule::TileSchedule(const std::vector<Pixel> &wanted, const Rect &window, int reach, int64_t spp)
    : is_list_(true), spp_(spp), reach_(reach), window_(window) {
    if (wanted.size() >= (size_t(1) << 32)) throw std::invalid_argument("pixels: more than 2**32");
    std::vector<Key> keys;
    keys.reserve(wanted.size());
    for (size_t i = 0; i < wanted.size(); ++i) keys.push_back(key_of(wanted[i].y, wanted[i].x, i));
    std::sort(keys.begin(), keys.end());
    results_.resize(wanted.size());
    for (size_t i = 0; i < keys.size(); ++i) {
        if (i == 0 || !keys[i].same_pixel(keys[i - 1])) wanted_.push_back({keys[i].y, keys[i].x});
        results_[keys[i].index] = uint32_t(wanted_.size() - 1);
    }
    // what is sampled: all pixels within reach of a wanted one, tile by tile
    auto reached = [&](Pixel p) { return intersect(window, grown({p.y, p.x, p.y + 1, p.x + 1}, reach)); };
    keys.clear();
    for (size_t i = 0; i < wanted_.size(); ++i) {
        Rect r = reached(wanted_[i]);
        if (r.height() <= 0 || r.width() <= 0) continue;
        for (int y = floor_div(r.y0, TileSize); y <= floor_div(r.y1 - 1, TileSize); ++y)
            for (int x = floor_div(r.x0, TileSize); x <= floor_div(r.x1 - 1, TileSize); ++x)
                keys.push_back({y, x, 0, 0, uint32_t(i)});
    }
    std::stable_sort(keys.begin(), keys.end());
    for (size_t begin = 0, end = 0; begin < keys.size(); begin = end) {
        sampled_begin_.push_back(sampled_.size());
        targets_begin_.push_back(targets_.size());
        int y0 = keys[begin].tile_y * TileSize, x0 = keys[begin].tile_x * TileSize;
        bool sampled[TileSize][TileSize] = {};
        for (; end < keys.size() && keys[end].same_tile(keys[begin]); ++end) {
            targets_.push_back(keys[end].index);
            Rect r = intersect(reached(wanted_[keys[end].index]), {y0, x0, y0 + TileSize, x0 + TileSize});
            for (int y = r.y0; y < r.y1; ++y) std::fill_n(&sampled[y - y0][r.x0 - x0], size_t(r.width()), true);
        }
        for (int y = 0; y < TileSize; ++y)
            for (int x = 0; x < TileSize; ++x)
                if (sampled[y][x]) sampled_.push_back({y0 + y, x0 + x});
    }
    sampled_begin_.push_back(sampled_.size());
    targets_begin_.push_back(targets_.size());
    make_items();
}

Rect TileSchedule::tile_rect(size_t i) const {
    int y = (y0_ + int(i / size_t(columns_))) * TileSize, x = (x0_ + int(i % size_t(columns_))) * TileSize;
    return intersect(window_, {y, x, y + TileSize, x + TileSize});
}

size_t TileSchedule::n_pixels(size_t i) const {
    return is_list_ ? sampled_begin_[i + 1] - sampled_begin_[i] : area(tile_rect(i));
}

Tile TileSchedule::tile(size_t i) const {
    if (!is_list_) {
        Rect sampled = tile_rect(i);
        return {sampled, intersect(rect_, grown(sampled, reach_)), nullptr, area(sampled), nullptr, 0, counts(i)};
    }
    Tile t{};
    t.counts = counts(i);
    t.list = sampled_.data() + sampled_begin_[i], t.n = sampled_begin_[i + 1] - sampled_begin_[i];
    t.targets = targets_.data() + targets_begin_[i], t.n_targets = targets_begin_[i + 1] - targets_begin_[i];
    auto around = [](Rect &r, Pixel p, bool first) {
        Rect q{p.y, p.x, p.y + 1, p.x + 1};
        r = first ? q : Rect{std::min(r.y0, q.y0), std::min(r.x0, q.x0), std::max(r.y1, q.y1), std::max(r.x1, q.x1)};
    };
    for (size_t k = 0; k < t.n; ++k) around(t.sampled, t.list[k], k == 0);
    for (size_t k = 0; k < t.n_targets; ++k) around(t.reached, wanted_[t.targets[k]], k == 0);
    return t;
}

void TileSchedule::allocate(std::vector<uint32_t> counts) {
    counts_begin_.clear();
    size_t n = 0;
    for (size_t i = 0; i < n_tiles(); ++i) {
        counts_begin_.push_back(n);
        n += n_pixels(i);
    }
    if (counts.size() != n) throw std::invalid_argument("allocate: one count a sampled pixel is needed");
    counts_ = std::move(counts);
    make_items();
}

int64_t TileSchedule::n_paths(size_t i) const {
    if (counts_.empty()) return int64_t(n_pixels(i)) * spp_;
    const uint32_t *first = counts(i);
    return std::accumulate(first, first + n_pixels(i), int64_t(0));
}

// Small tiles are put together; of a large one an item takes some chunks.
void TileSchedule::make_items() {
    const int64_t enough = int64_t(BatchSize);
    size_t n = n_tiles();
    first_item_.assign(1, 0);
    first_tile_.clear();
    for (size_t begin = 0, end = 0; begin < n; begin = end) {
        int64_t paths = 0;
        for (; end < n; ++end) {
            // tiles without samples count as well: blocks of an item's tiles are in memory together
            int64_t more = std::max(n_paths(end), int64_t(n_pixels(end)));
            if (end > begin && paths + more > enough) break;
            paths += more;
        }
        int64_t some = chunks_an_item(begin, end);
        first_tile_.push_back(uint32_t(begin));
        first_item_.push_back(first_item_.back() + size_t((n_chunks(begin, end) + some - 1) / some));
    }
    first_tile_.push_back(uint32_t(n));
}

// Of the tiles of a group. With numbers of their own the pixels of a tile may differ in them by orders of magnitude;
// every chunk has its share of each, so that all chunks are about as large as they are otherwise.
int64_t TileSchedule::n_chunks(size_t begin, size_t end) const {
    if (counts_.empty()) return (spp_ + ChunkSize - 1) / ChunkSize;
    if (end - begin > 1) return 1;
    int64_t full = int64_t(n_pixels(begin)) * ChunkSize;
    return std::max<int64_t>(1, (n_paths(begin) + full - 1) / full);
}

int64_t TileSchedule::chunks_an_item(size_t begin, size_t end) const {
    if (end - begin > 1) return n_chunks(begin, end);
    return std::max<int64_t>(1, int64_t(BatchSize) / (int64_t(n_pixels(begin)) * ChunkSize));
}

WorkItem TileSchedule::work_item(size_t item) const {
    size_t group = size_t(std::upper_bound(first_item_.begin(), first_item_.end(), item) - first_item_.begin()) - 1;
    size_t begin = first_tile_[group], end = first_tile_[group + 1];
    int64_t some = chunks_an_item(begin, end), chunk = int64_t(item - first_item_[group]) * some;
    int64_t all = n_chunks(begin, end);
    return {begin, end - begin, chunk, std::min(some, all - chunk), all};
}

}  // namespace tr
