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
    bool stack, tangent, segment, motion, connection, bent = false, stokes = false;
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
            add(columns.segment, groups.segment), add(columns.motion, groups.motion);
            add(columns.connection, groups.connection), add(columns.bent, groups.bent);
            add(columns.stokes, groups.stokes);
        });
    }

    size_t capacity() const { return capacity_; }

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

// What the first level of a block hands to the last one of the block before, which is not on the tape then: a level in
// its place, of which only those columns matter that a vertex writes into its parent's entry.
template <class S>
class BlockBoundary {
public:
    // An empty level of so many entries.
    const TapeColumns<S> &open(size_t entries, const TapeGroups &groups) {
        level_.reserve(entries, groups);
        entries_ = entries;
        for_handed(level_.columns, [&](auto *array) { std::memset(array, 0, entries_ * sizeof(*array)); });
        return level_.columns;
    }
    void hand_to(const TapeLevel<S> &level) const {
        const size_t n = std::min(entries_, level.capacity());
        std::vector<void *> to;
        for_handed(level.columns, [&](auto *array) { to.push_back(array); });
        size_t k = 0;
        for_handed(level_.columns, [&](const auto *array) { std::memcpy(to[k++], array, n * sizeof(*array)); });
    }

private:
    // The arrays of those columns.
    template <class Visit>
    static void for_handed(const TapeColumns<S> &columns, Visit &&visit) {
        columns.vertex.suffix.each(visit);
        columns.next.for_arrays(visit);
        if (columns.motion.rest_bar.x) columns.motion.rest_bar.each(visit), columns.motion.from_bar.each(visit);
    }

    TapeLevel<S> level_;
    size_t entries_ = 0;
};

template <class S>
class Tape {
public:
    // Levels of a block: as many as most paths have, so that few are traced twice.
    static constexpr int BlockLevels = 64;
    Checkpoints<S> checkpoints;
    std::vector<BlockBoundary<S>> boundaries;  // by component
    int first_level = 0;                       // number of the first one among all

    explicit Tape(const TapeGroups &groups) : boundaries(SpectrumSize), groups_(groups) {}

    int size() const { return n_; }
    TapeLevel<S> &operator[](int i) { return *levels_[size_t(i)]; }
    TapeLevel<S> &last() { return *levels_[size_t(n_ - 1)]; }
    const TapeGroups &groups() const { return groups_; }
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
