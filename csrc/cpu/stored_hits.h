// What the rays of a rendering hit, kept for the derivative of the same samples, which then traces nothing.
//
// A rendering and its derivative go through the same items, whose paths come in the same order; a path's hits are kept
// in the order of its queries. The derivative may cut batches otherwise, leave out paths whose adjoint is zero, and
// follow paths that the rendering gave up: rays for which nothing is kept are traced.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "accel/accel.h"

namespace tr {

// A hit as Embree returned it and, of the shadow ray that was sent from there, whether it met something.
struct StoredHit {
    static constexpr uint32_t ShapeBits = 30, NoShape = (1u << ShapeBits) - 1;  // a miss
    enum Shadow : uint32_t { None, Free, Occluded };

    uint32_t shape_and_shadow, primitive;
    float t, b1, b2;

    void set_shape(uint32_t shape) { shape_and_shadow = shape & NoShape; }
    uint32_t shape() const {
        uint32_t s = shape_and_shadow & NoShape;
        return s == NoShape ? Accel::Miss : s;
    }
    void set_shadow(bool occluded) { shape_and_shadow |= (occluded ? Occluded : Free) << ShapeBits; }
    Shadow shadow() const { return Shadow(shape_and_shadow >> ShapeBits); }
};

// Those of a batch, chain by chain: chain i is hits[begin[i]] .. hits[begin[i + 1]]. A path has as many chains as its
// first vertex is split into.
struct HitBlock {
    std::vector<uint32_t> begin;
    std::unique_ptr<StoredHit[]> hits;
    int64_t bytes() const {
        return begin.empty() ? 0 : int64_t(begin.size() * sizeof(begin[0]) + begin.back() * sizeof(StoredHit));
    }
};

// Those of a pass. What exceeds the limit, which holds for all passes that exist together, is not kept.
class StoredHits {
public:
    explicit StoredHits(int64_t limit) : limit_(limit) {}
    StoredHits(const StoredHits &) = delete;
    StoredHits &operator=(const StoredHits &) = delete;
    ~StoredHits() { in_use() -= bytes_; }

    // `batch`: paths of every block but the last one of an item.
    void prepare(size_t n_items, size_t batch) {
        if (n_items > size_t(limit_) / sizeof(items_[0]) || !reserve(int64_t(n_items * sizeof(items_[0])))) return;
        batch_ = batch;
        items_.resize(n_items);
    }
    bool wants_more() const { return !items_.empty() && !full_; }
    // The next batch of an item, by the thread that has the item; an empty block if it was not recorded.
    void keep(size_t item, HitBlock &&block) {
        if (items_.empty()) return;
        if (!reserve(block.bytes())) {
            full_ = true;
            block = {};
        }
        items_[item].push_back(std::move(block));
    }
    struct Chain {
        const StoredHit *next = nullptr, *end = nullptr;
    };
    // A chain of a path of an item.
    Chain chain(size_t item, size_t path, size_t splits, size_t split) const {
        if (items_.empty() || path / batch_ >= items_[item].size()) return {};
        const HitBlock &block = items_[item][path / batch_];
        size_t i = path % batch_ * splits + split;
        if (i + 1 >= block.begin.size()) return {};
        return {&block.hits[block.begin[i]], &block.hits[block.begin[i + 1]]};
    }
    int64_t bytes() const { return bytes_; }
    static std::atomic<int64_t> &in_use() {
        static std::atomic<int64_t> bytes{0};
        return bytes;
    }

private:
    bool reserve(int64_t more) {
        if (in_use().fetch_add(more) + more > limit_) {
            in_use() -= more;
            return false;
        }
        bytes_ += more;
        return true;
    }

    int64_t limit_;
    size_t batch_ = 1;
    std::atomic<int64_t> bytes_{0};
    std::atomic<bool> full_{false};
    std::vector<std::vector<HitBlock>> items_;
};

// The passes of a rendering.
class HitStore {
public:
    explicit HitStore(int64_t limit) : limit_(limit) {}
    // New, for the rendering; passes follow each other.
    StoredHits *add_pass() { return &passes_.emplace_back(limit_); }
    // For the derivative; null: there is none.
    const StoredHits *pass(size_t i) const { return i < passes_.size() ? &passes_[i] : nullptr; }

private:
    int64_t limit_;
    std::deque<StoredHits> passes_;
};

// Writes the hits of a batch down in the order of the queries; what comes out is sorted by path.
class HitRecorder {
public:
    bool on() const { return on_; }
    void begin(size_t n_paths, size_t splits) {
        on_ = true;
        n_ = 0, splits_ = splits, split_ = 0;
        n_chains_ = n_paths * splits;
        if (current_.size() < n_paths) current_.resize(n_paths);
    }
    void set_split(size_t split) { split_ = split; }

    // Before a query: moved(i) says of which rays it will be news.
    template <class Moved>
    void choose(size_t n, Moved &&moved) {
        if (n_ + n > MostHits) on_ = false;
        if (!on_) return;
        chosen_.clear();
        for (size_t i = 0; i < n; ++i)
            if (moved(i)) chosen_.push_back(uint32_t(i));
    }
    // After it: `slot` says for every ray which path it belongs to.
    void put(const uint32_t *slot, const HitBatch &from) {
        if (!on_) return;
        if (hits_.size() < n_ + chosen_.size()) {
            hits_.resize(2 * (n_ + chosen_.size()));
            chain_.resize(hits_.size());
        }
        for (uint32_t i : chosen_) {
            StoredHit &hit = hits_[n_];
            hit.set_shape(from.shape[i]);
            hit.primitive = from.primitive[i];
            hit.t = from.t[i], hit.b1 = from.b1[i], hit.b2 = from.b2[i];
            chain_[n_] = uint32_t(slot[i] * splits_ + split_);
            current_[slot[i]] = uint32_t(n_++);
        }
    }
    void put_shadows(const uint32_t *slot, const uint8_t *occluded, size_t n) {
        if (!on_) return;
        for (size_t k = 0; k < n; ++k) hits_[current_[slot[k]]].set_shadow(occluded[k] != 0);
    }

    // What was written down, or nothing if that became too much. The recorder is off afterwards.
    HitBlock finish() {
        HitBlock block;
        if (!on_) return block;
        on_ = false;
        block.begin.assign(n_chains_ + 1, 0);
        for (size_t i = 0; i < n_; ++i) ++block.begin[chain_[i] + 1];
        for (size_t c = 0; c < n_chains_; ++c) block.begin[c + 1] += block.begin[c];
        block.hits.reset(new StoredHit[n_]);
        to_.assign(block.begin.begin(), block.begin.end());
        for (size_t i = 0; i < n_; ++i) block.hits[to_[chain_[i]]++] = hits_[i];
        return block;
    }

private:
    static constexpr size_t MostHits = size_t(1) << 20;  // of a batch; paths may go on for ever
    bool on_ = false;
    size_t n_ = 0, splits_ = 1, split_ = 0, n_chains_ = 0;
    std::vector<StoredHit> hits_;
    std::vector<uint32_t> chain_, current_, chosen_, to_;  // current_: the latest hit of each path
};

// Answers the queries of a batch from what was kept.
class HitReplay {
public:
    bool on() const { return from_ != nullptr; }
    // Of an item the paths first .. first + n - 1. Null turns it off.
    void begin(const StoredHits *from, size_t item, size_t first, size_t n, size_t splits) {
        from_ = from;
        item_ = item, first_ = first, n_ = n, splits_ = splits;
        if (from) set_split(0);
    }
    void set_split(size_t split) {
        at_.resize(n_);
        for (size_t k = 0; k < n_; ++k) at_[k] = {from_->chain(item_, first_ + k, splits_, split), nullptr};
    }

    // Hits of n rays, of which moved(i) says whether they need a new one. Returns how many had to be traced.
    template <class Moved>
    size_t intersect(const Accel &accel, const RayBatch &rays, const uint32_t *slot, const HitBatch &to, size_t n,
                     bool coherent, Moved &&moved) {
        missing_.clear();
        for (size_t i = 0; i < n; ++i) {
            if (!moved(i)) continue;
            Path &path = at_[slot[i]];
            path.hit = path.chain.next < path.chain.end ? path.chain.next++ : nullptr;
            if (!path.hit) {
                missing_.push_back(uint32_t(i));
                continue;
            }
            to.shape[i] = path.hit->shape();
            to.primitive[i] = path.hit->primitive;
            to.t[i] = path.hit->t, to.b1[i] = path.hit->b1, to.b2[i] = path.hit->b2;
        }
        if (missing_.empty()) return 0;
        RayBatch some = rays_of_missing(rays);
        size_t m = missing_.size();
        for (std::vector<uint32_t> *v : {&shape_, &primitive_}) v->resize(m);
        for (std::vector<float> &v : found_) v.resize(m);
        HitBatch hits{shape_.data(), primitive_.data(), found_[0].data(), found_[1].data(), found_[2].data()};
        accel.intersect(some, hits, m, coherent);
        for (size_t j = 0; j < m; ++j) {
            size_t i = missing_[j];
            to.shape[i] = shape_[j], to.primitive[i] = primitive_[j];
            to.t[i] = found_[0][j], to.b1[i] = found_[1][j], to.b2[i] = found_[2][j];
        }
        return m;
    }
    // The same for the shadow rays from the latest hits.
    size_t occluded(const Accel &accel, const RayBatch &rays, const uint32_t *slot, uint8_t *to, size_t n) {
        missing_.clear();
        for (size_t k = 0; k < n; ++k) {
            const StoredHit *hit = at_[slot[k]].hit;
            if (hit && hit->shadow() != StoredHit::None)
                to[k] = hit->shadow() == StoredHit::Occluded;
            else
                missing_.push_back(uint32_t(k));
        }
        if (missing_.empty()) return 0;
        size_t m = missing_.size();
        RayBatch some = rays_of_missing(rays);
        found_occluded_.resize(m);
        accel.occluded(some, found_occluded_.data(), m);
        for (size_t j = 0; j < m; ++j) to[missing_[j]] = found_occluded_[j];
        return m;
    }

private:
    RayBatch rays_of_missing(const RayBatch &rays) {
        const float *from[7] = {rays.o[0], rays.o[1], rays.o[2], rays.d[0], rays.d[1], rays.d[2], rays.tmax};
        for (int k = 0; k < 7; ++k) {
            rays_[k].resize(missing_.size());
            for (size_t j = 0; j < missing_.size(); ++j) rays_[k][j] = from[k][missing_[j]];
        }
        return {{rays_[0].data(), rays_[1].data(), rays_[2].data()},
                {rays_[3].data(), rays_[4].data(), rays_[5].data()},
                rays_[6].data()};
    }

    struct Path {
        StoredHits::Chain chain;
        const StoredHit *hit;  // the latest one; null: it was traced
    };
    const StoredHits *from_ = nullptr;
    size_t item_ = 0, first_ = 0, n_ = 0, splits_ = 1;
    std::vector<Path> at_;
    std::vector<uint32_t> missing_, shape_, primitive_;
    std::vector<float> rays_[7], found_[3];
    std::vector<uint8_t> found_occluded_;
};

}  // namespace tr
