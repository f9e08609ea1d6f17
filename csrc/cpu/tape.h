// The path tape of a batch. Long volumetric paths stay in nearly constant memory: the tape holds one block of levels at
// a time. Of every block only the queue at its beginning is kept; the sweep starts with the last block and traces the
// ones before it again, with the same random numbers, as it comes to them.
#pragma once

#include <cstring>
#include <vector>

#include "arena.h"
#include "core/state/tape.h"

namespace tr {

// Entries of one kind, see core/integrator/classify.h.
struct KindRange {
    int kind;
    uint32_t begin, count;
};

// Groups of columns besides those that all tapes have.
struct TapeGroups {
    bool stack, tangent, segment, connection;
};

template <class S>
struct TapeLevel {
    static constexpr int NoParent = -1, InBlockBefore = -2;
    TapeColumns<S> columns;
    std::vector<KindRange> ranges;
    int parent_level = NoParent;
    bool scatters = false;

    void reserve(size_t n, const TapeGroups &groups) {
        if (n <= capacity_) return;
        capacity_ = n;
        arena_.declare([&](Arena &arena) {
            auto add = [&](auto &of, bool wanted) {
                if (wanted) of.for_arrays([&](auto *&array) { arena.array(array, n); });
            };
            add(columns.vertex, true), add(columns.outgoing, true), add(columns.scattering, true);
            add(columns.arrival, true), add(columns.next, true);
            add(columns.stack, groups.stack), add(columns.tangent, groups.tangent);
            add(columns.segment, groups.segment), add(columns.connection, groups.connection);
        });
    }

private:
    Arena arena_;
    size_t capacity_ = 0;
};

// Queues at the beginnings of blocks.
template <class S>
class Checkpoints {
public:
    void clear() { used_ = 0; }
    size_t size() const { return used_; }

    void save(const PathQueue<S> &queue) {
        if (used_ == saved_.size()) saved_.emplace_back();
        Saved &to = saved_[used_++];
        to.n = queue.n;
        size_t size = 0;
        queue.for_arrays([&](auto *array) { size += to.n * sizeof(*array); });
        to.bytes.resize(size);
        char *at = to.bytes.data();
        queue.for_arrays([&](auto *array) {
            std::memcpy(at, array, to.n * sizeof(*array));
            at += to.n * sizeof(*array);
        });
    }
    void restore(size_t block, PathQueue<S> &queue) const {
        const Saved &from = saved_[block];
        queue.n = from.n;
        const char *at = from.bytes.data();
        queue.for_arrays([&](auto *array) {
            std::memcpy(array, at, from.n * sizeof(*array));
            at += from.n * sizeof(*array);
        });
    }

private:
    struct Saved {
        uint32_t n;
        std::vector<char> bytes;
    };
    std::vector<Saved> saved_;
    size_t used_ = 0;
};

// What the first level of a block hands to the last one of the block before.
template <class S>
struct BlockBoundary {
    std::vector<uint32_t> parent;
    std::vector<S> radiance[SpectrumSize];

    void clear() {
        parent.clear();
        for (auto &r : radiance) r.clear();
    }
    template <class F>
    void keep(const uint32_t *parents, const Spectrum<F> &r, size_t n) {
        size_t before = parent.size();
        parent.insert(parent.end(), parents, parents + n);
        alignas(64) S v[size_t(Lanes<F>::Width)];
        for (int c = 0; c < SpectrumSize; ++c) {
            store(&v[0], r[c]);
            radiance[c].insert(radiance[c].begin() + ptrdiff_t(before), v, v + n);
        }
    }
    void hand_to(const TapeLevel<S> &level) const {
        for (int c = 0; c < SpectrumSize; ++c)
            for (size_t i = 0; i < parent.size(); ++i) level.columns.vertex.suffix[c][parent[i]] = radiance[c][i];
    }
};

template <class S>
class Tape {
public:
    // Levels of a block: as many as most paths have, so that few are traced twice.
    static constexpr int BlockLevels = 64;
    Checkpoints<S> checkpoints;
    BlockBoundary<S> boundary;
    int first_level = 0;  // number of the first one among all

    explicit Tape(const TapeGroups &groups) : groups_(groups) {}

    int size() const { return n_; }
    TapeLevel<S> &operator[](int i) { return *levels_[size_t(i)]; }
    TapeLevel<S> &last() { return *levels_[size_t(n_ - 1)]; }
    void reserve_last(size_t entries) { last().reserve(entries, groups_); }
    void begin_block(int level) { first_level = level, n_ = 0; }
    // A level without entries yet: how many there are is known once hits are grouped.
    TapeLevel<S> &add(int parent_level, bool scatters) {
        if (size_t(n_) == levels_.size()) levels_.push_back(std::make_unique<TapeLevel<S>>());
        TapeLevel<S> &level = *levels_[size_t(n_++)];
        level.parent_level = parent_level;
        level.scatters = scatters;
        return level;
    }

private:
    TapeGroups groups_;
    std::vector<std::unique_ptr<TapeLevel<S>>> levels_;
    int n_ = 0;
};

}  // namespace tr
