// Long paths in nearly constant memory: the tape holds one block of levels at a time. Of every block only the front at
// its beginning is kept; the sweep starts with the last block and traces the ones before it again, with the same random
// numbers, as it comes to them.
#pragma once

#include "tape.h"

namespace tr {

// Levels of a block: as many as most paths have, so that few are traced twice.
constexpr int BlockLevels = 64;

template <class S, int C>
class Checkpoints {
public:
    void clear() { used_ = 0; }
    size_t size() const { return used_; }

    void save(const Front<S, C> &front) {
        if (used_ == saved_.size()) saved_.emplace_back();
        Saved &to = saved_[used_++];
        to.n = front.n;
        to.bytes.resize(front.n * sizeof(S) * Front<S, C>::Columns);
        char *at = to.bytes.data();
        front.for_columns([&](auto *column) {
            std::memcpy(at, column, front.n * sizeof(*column));
            at += front.n * sizeof(*column);
        });
    }
    void restore(size_t block, Front<S, C> &front) const {
        const Saved &from = saved_[block];
        front.n = from.n;
        const char *at = from.bytes.data();
        front.for_columns([&](auto *column) {
            std::memcpy(column, at, front.n * sizeof(*column));
            at += front.n * sizeof(*column);
        });
    }

private:
    struct Saved {
        size_t n;
        std::vector<char> bytes;
    };
    std::vector<Saved> saved_;
    size_t used_ = 0;
};

// What the first level of a block hands to the last one of the block before.
template <class S, int C>
struct BlockBoundary {
    std::vector<uint32_t> parent;
    std::vector<S> radiance[C];

    void clear() {
        parent.clear();
        for (auto &r : radiance) r.clear();
    }
    void hand_to(TapeLevel<S, C> &level) const {
        for (int c = 0; c < C; ++c)
            for (size_t i = 0; i < parent.size(); ++i) level.suffix[c][parent[i]] = radiance[c][i];
    }
};

}  // namespace tr
