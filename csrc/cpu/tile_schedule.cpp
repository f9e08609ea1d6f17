#include "tile_schedule.h"

#include <numeric>
#include <stdexcept>
#include <utility>

namespace tr {

namespace {

int floor_div(int a, int b) { return (a >= 0 ? a : a - b + 1) / b; }

Rect grown(const Rect &r, int by) { return {r.y0 - by, r.x0 - by, r.y1 + by, r.x1 + by}; }

// The tiles that hold some pixels, numbered row by row.
struct TileNumbers {
    int y0, x0;
    uint64_t columns, rows;

    explicit TileNumbers(const Rect &r)
        : y0(floor_div(r.y0, TileSize)),
          x0(floor_div(r.x0, TileSize)),
          columns(uint64_t(floor_div(r.x1 - 1, TileSize) - x0 + 1)),
          rows(uint64_t(floor_div(r.y1 - 1, TileSize) - y0 + 1)) {}
    uint64_t number(int tile_y, int tile_x) const { return uint64_t(tile_y - y0) * columns + uint64_t(tile_x - x0); }
    // Pixels have numbers in the order of tiles, of rows in them, of columns in these.
    uint64_t pixel(Pixel p) const {
        const int ty = floor_div(p.y, TileSize), tx = floor_div(p.x, TileSize);
        const int in_tile = (p.y - ty * TileSize) * TileSize + (p.x - tx * TileSize);
        return number(ty, tx) * (TileSize * TileSize) + uint64_t(in_tile);
    }
    // The pixel in the upper left corner of a tile.
    Pixel corner(uint64_t tile) const {
        return {(y0 + int(tile / columns)) * TileSize, (x0 + int(tile % columns)) * TileSize};
    }
};

// A number that is sorted by, and an index below it.
using Key = uint64_t;
Key key_of(uint64_t number, size_t index) { return number << 32 | index; }
uint64_t number_of(Key key) { return key >> 32; }
uint32_t index_of(Key key) { return uint32_t(key); }

// Sorts by number, stably, digit by digit from the last one: lists of pixels are as long as images.
void sort_keys(std::vector<Key> &keys) {
    if (std::is_sorted(keys.begin(), keys.end())) return;
    constexpr int Bits = 11;
    const Key most = *std::max_element(keys.begin(), keys.end());
    std::vector<Key> other(keys.size());
    for (int shift = 32; shift < 64 && most >> shift; shift += Bits) {
        auto digit = [&](Key k) { return size_t(k >> shift) & ((size_t(1) << Bits) - 1); };
        std::vector<size_t> begin((size_t(1) << Bits) + 1);
        for (Key k : keys) ++begin[digit(k) + 1];
        std::partial_sum(begin.begin(), begin.end(), begin.begin());
        for (Key k : keys) other[begin[digit(k)]++] = k;
        keys.swap(other);
    }
}

Rect united(const Rect &a, const Rect &b) {
    return {std::min(a.y0, b.y0), std::min(a.x0, b.x0), std::max(a.y1, b.y1), std::max(a.x1, b.x1)};
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
    auto square = [](Pixel p) { return Rect{p.y, p.x, p.y + 1, p.x + 1}; };
    Rect bounds = wanted.empty() ? Rect{0, 0, 1, 1} : square(wanted[0]);
    for (const Pixel &p : wanted) bounds = united(bounds, square(p));
    const TileNumbers pixels(bounds), tiles(grown(bounds, reach));
    if (pixels.columns * pixels.rows > uint64_t(1) << 24) throw std::invalid_argument("pixels: too far apart");
    std::vector<Key> keys(wanted.size());
    for (size_t i = 0; i < wanted.size(); ++i) keys[i] = key_of(pixels.pixel(wanted[i]), i);
    sort_keys(keys);
    results_.resize(wanted.size());
    wanted_.resize(wanted.size());
    size_t n = 0;  // distinct ones
    for (size_t i = 0; i < keys.size(); ++i) {
        if (i == 0 || number_of(keys[i]) != number_of(keys[i - 1])) wanted_[n++] = wanted[index_of(keys[i])];
        results_[index_of(keys[i])] = uint32_t(n - 1);
    }
    wanted_.resize(n);
    // what is sampled: all pixels within reach of a wanted one, tile by tile
    auto reached = [&](Pixel p) { return intersect(window, grown(square(p), reach)); };
    keys.clear();
    for (size_t i = 0; i < n; ++i) {
        const Rect r = reached(wanted_[i]);
        if (r.height() <= 0 || r.width() <= 0) continue;
        for (int y = floor_div(r.y0, TileSize); y <= floor_div(r.y1 - 1, TileSize); ++y)
            for (int x = floor_div(r.x0, TileSize); x <= floor_div(r.x1 - 1, TileSize); ++x)
                keys.push_back(key_of(tiles.number(y, x), i));
    }
    sort_keys(keys);
    targets_.resize(keys.size());
    sampled_.reserve(n);
    for (size_t begin = 0, end = 0; begin < keys.size(); begin = end) {
        sampled_begin_.push_back(sampled_.size());
        targets_begin_.push_back(begin);
        const auto [y0, x0] = tiles.corner(number_of(keys[begin]));
        const Rect tile{y0, x0, y0 + TileSize, x0 + TileSize};
        uint32_t sampled[TileSize] = {};  // of each row, a bit a column
        Rect inside{tile.y1, tile.x1, y0, x0};
        Rect around = square(wanted_[index_of(keys[begin])]);
        for (; end < keys.size() && number_of(keys[end]) == number_of(keys[begin]); ++end) {
            targets_[end] = index_of(keys[end]);
            const Pixel p = wanted_[targets_[end]];
            const Rect r = intersect(reached(p), tile);
            const uint32_t columns = ((1u << r.width()) - 1) << (r.x0 - x0);
            for (int y = r.y0; y < r.y1; ++y) sampled[y - y0] |= columns;
            inside = united(inside, r);
            around = united(around, square(p));
        }
        for (int y = inside.y0; y < inside.y1; ++y)
            for (uint32_t row = sampled[y - y0], x = 0; row >> x; ++x)
                if (row >> x & 1) sampled_.push_back({y, x0 + int(x)});
        sampled_rects_.push_back(inside);
        reached_rects_.push_back(around);
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
    t.sampled = sampled_rects_[i], t.reached = reached_rects_[i];
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
