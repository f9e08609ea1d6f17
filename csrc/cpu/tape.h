// The path tape of a batch. Long volumetric paths stay in nearly constant memory: the tape holds one block of levels at
// a time. Of every block only the queue at its beginning is kept, and of polarised light the rows for what arrives
// there; the sweep starts with the last block and traces the ones before it again, with the same random numbers, as it
// comes to them.
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
            add(columns.stokes, groups.stokes), add(columns.connected, groups.stokes && groups.connection);
        });
    }

    size_t capacity() const { return capacity_; }
    size_t entries() const { return ranges.empty() ? 0 : size_t(ranges.back().begin + ranges.back().count); }

private:
    Arena arena_;
    size_t capacity_ = 0;
};

// The arrays that hold the rows of polarised light.
template <class S, class Visit>
void for_rows(const TapeColumns<S> &columns, Visit &&visit) {
    const auto &s = columns.stokes;
    s.row_i.each(visit), s.row_q.each(visit), s.row_u.each(visit), s.row_v.each(visit), s.row_axis.each(visit);
}

// Queues at the beginnings of blocks, and rows there.
template <class S>
class Checkpoints {
public:
    void clear() { used_ = 0; }
    size_t size() const { return used_; }

    void save(const PathQueue<S> &queue) {
        if (used_ == saved_.size()) saved_.emplace_back();
        saved_[used_++].queue.put(queue.n, [&](auto &&visit) { queue.for_arrays(visit); });
    }
    void restore(size_t block, PathQueue<S> &queue) const {
        const Copy &from = saved_[block].queue;
        queue.n = uint32_t(from.n);
        from.get([&](auto &&visit) { queue.for_arrays(visit); });
    }

    // Of the last block, those that the level before it has; `run`: of several rows a path.
    void save_rows(size_t run, const TapeLevel<S> &level) {
        std::vector<Copy> &rows = saved_[used_ - 1].rows;
        if (rows.size() <= run) rows.resize(run + 1);
        rows[run].put(level.entries(), [&](auto &&visit) { for_rows(level.columns, visit); });
    }
    void restore_rows(size_t block, size_t run, const TapeColumns<S> &columns) const {
        saved_[block].rows[run].get([&](auto &&visit) { for_rows(columns, visit); });
    }

private:
    // The first n numbers of arrays, one after the other; `arrays` visits them.
    struct Copy {
        size_t n = 0;
        std::vector<char> bytes;

        template <class Arrays>
        void put(size_t count, Arrays &&arrays) {
            n = count;
            size_t size = 0;
            arrays([&](auto *array) { size += n * sizeof(*array); });
            bytes.resize(size);
            char *at = bytes.data();
            arrays([&](auto *array) {
                std::memcpy(at, array, n * sizeof(*array));
                at += n * sizeof(*array);
            });
        }
        template <class Arrays>
        void get(Arrays &&arrays) const {
            const char *at = bytes.data();
            arrays([&](auto *array) {
                std::memcpy(array, at, n * sizeof(*array));
                at += n * sizeof(*array);
            });
        }
    };
    struct Saved {
        Copy queue;
        std::vector<Copy> rows;
    };
    std::vector<Saved> saved_;
    size_t used_ = 0;
};

// What a vertex writes into its parent's entry: radiance, or the column of polarised light, and motion.
enum Handed : unsigned { HandedRadiance = 1, HandedMotion = 2, HandedAll = 3 };

// What the first level of a block hands to the last one of the block before, which is not on the tape then: a level in
// its place, of which only those columns matter, and rows.
template <class S>
class BlockBoundary {
public:
    // An empty level of so many entries.
    const TapeColumns<S> &open(size_t entries, const TapeGroups &groups) {
        level_.reserve(entries, groups);
        entries_ = entries;
        for_handed(level_.columns, HandedAll, [&](auto *array) { std::memset(array, 0, entries_ * sizeof(*array)); });
        return level_.columns;
    }
    void hand_to(const TapeLevel<S> &level, unsigned what = HandedAll) const {
        const size_t n = std::min(entries_, level.capacity());
        std::vector<void *> to;
        for_handed(level.columns, what, [&](auto *array) { to.push_back(array); });
        size_t k = 0;
        for_handed(level_.columns, what, [&](const auto *array) { std::memcpy(to[k++], array, n * sizeof(*array)); });
    }

private:
    // The arrays of those columns.
    template <class Visit>
    static void for_handed(const TapeColumns<S> &columns, unsigned what, Visit &&visit) {
        if (what & HandedRadiance) {
            columns.vertex.suffix.each(visit);
            const auto &s = columns.stokes;
            if (s.column_axis.x)
                s.column_q.each(visit), s.column_u.each(visit), s.column_v.each(visit), s.column_axis.each(visit);
        }
        if (!(what & HandedMotion)) return;
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
    std::vector<BlockBoundary<S>> boundaries;  // by component; of polarised light by run, see PathTile
    BlockBoundary<S> columns;                  // of polarised light
    int first_level = 0;                       // number of the first one among all
    int origin = 0;                            // ... and that of the first one of the paths

    explicit Tape(const TapeGroups &groups)
        : boundaries(size_t(groups.stokes ? 4 * SpectrumSize : SpectrumSize)), groups_(groups) {}

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

#define TR_ELSEWHERE(S) extern template struct TapeLevel<S>;
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
