// A stable counting sort by small keys: entries of key 0, then those of key 1, ..., each in their order; those of a
// negative key are left out. Three launches: blocks of the first and the third have a chunk of entries each, of the
// second a key.
#pragma once

#include "block.h"
#include "core/math/lanes.h"

namespace tr {

struct SortTable {
    static constexpr uint32_t Rounds = 4, Chunk = Rounds * BlockSize, MostKinds = 32, Warp = 32;

    const int32_t *key;       // of entry i
    const uint32_t *from;     // what is sorted; null: i itself
    const uint32_t *n;        // how many entries there are, over `each`
    uint32_t *counts;         // (kinds, chunks), for the sort alone
    uint32_t *begin, *total;  // by key: where its entries begin, and how many they are
    uint32_t *to, *n_to;      // the result, of all keys
    uint32_t each, kinds, chunks;

    // The key of an entry; -1: there is none.
    TR_HD int32_t key_of(uint32_t i) const { return i < each * *n ? key[i] : -1; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(key), visit(from), visit(n), visit(counts), visit(begin), visit(total), visit(to), visit(n_to);
    }
};

struct CountKeys {
    static constexpr const char *Name = "tr::CountKeys", *Header = "device/sort_kernels.h";
    struct Shared {
        uint32_t count[SortTable::MostKinds];
    };
    SortTable table;

    TR_HD void operator()(const Block<Shared> &block, uint32_t chunk) const {
        uint32_t *count = block.shared.count;
        block.each([&](uint32_t t) {
            if (t < table.kinds) count[t] = 0;
        });
        block.each([&](uint32_t t) {
            for (uint32_t round = 0; round < SortTable::Rounds; ++round) {
                const int32_t key = table.key_of(chunk * SortTable::Chunk + round * BlockSize + t);
                if (key >= 0) accumulate(&count[key], 1u);
            }
        });
        block.each([&](uint32_t t) {
            if (t < table.kinds) table.counts[t * table.chunks + chunk] = count[t];
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        table.for_pointers(visit);
    }
};

// Makes the counts of a key sums over the chunks before.
struct SumKeys {
    static constexpr const char *Name = "tr::SumKeys", *Header = "device/sort_kernels.h";
    struct Shared {
        uint32_t sum[2][BlockSize], before;
    };
    SortTable table;

    TR_HD void operator()(const Block<Shared> &block, uint32_t key) const {
        Shared &s = block.shared;
        uint32_t *counts = table.counts + key * table.chunks;
        block.each([&](uint32_t t) {
            if (t == 0) s.before = 0;
        });
        for (uint32_t first = 0; first < table.chunks; first += BlockSize) {
            const auto count_of = [&](uint32_t t) { return first + t < table.chunks ? counts[first + t] : 0u; };
            block.each([&](uint32_t t) { s.sum[0][t] = count_of(t); });
            // Hillis and Steele, "Data Parallel Algorithms", CACM 29(12), 1986
            int of = 0;
            for (uint32_t step = 1; step < BlockSize; step *= 2, of = 1 - of)
                block.each(
                    [&](uint32_t t) { s.sum[1 - of][t] = s.sum[of][t] + (t >= step ? s.sum[of][t - step] : 0u); });
            block.each([&](uint32_t t) {
                if (first + t < table.chunks) counts[first + t] = s.before + s.sum[of][t] - count_of(t);
            });
            block.each([&](uint32_t t) {
                if (t == 0) s.before += s.sum[of][BlockSize - 1];
            });
        }
        block.each([&](uint32_t t) {
            if (t == 0) table.total[key] = s.before;
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        table.for_pointers(visit);
    }
};

struct PlaceKeys {
    static constexpr const char *Name = "tr::PlaceKeys", *Header = "device/sort_kernels.h";
    static constexpr uint32_t Warp = SortTable::Warp, Warps = BlockSize / Warp, Kinds = SortTable::MostKinds;
    static_assert(Warps * Kinds <= BlockSize, "a thread clears one of these");
    struct Shared {
        uint32_t next[Kinds];          // by key: the place of the next entry
        uint32_t found[Warps][Kinds];  // of a round
        int32_t key[BlockSize];
        uint32_t rank[BlockSize];  // among entries of the key in a warp
    };
    SortTable table;

    TR_HD void operator()(const Block<Shared> &block, uint32_t chunk) const {
        Shared &s = block.shared;
        block.each([&](uint32_t t) {
            if (t >= table.kinds) return;
            uint32_t begin = 0;
            for (uint32_t k = 0; k < t; ++k) begin += table.total[k];
            s.next[t] = begin + table.counts[t * table.chunks + chunk];
            if (chunk != 0) return;
            table.begin[t] = begin;
            if (t + 1 == table.kinds) *table.n_to = begin + table.total[t];
        });
        for (uint32_t round = 0; round < SortTable::Rounds; ++round) {
            const uint32_t first = chunk * SortTable::Chunk + round * BlockSize;
            block.each([&](uint32_t t) {
                (&s.found[0][0])[t] = 0;
                s.key[t] = table.key_of(first + t);
            });
            block.each([&](uint32_t t) { count_in_warp(s, t); });
            block.each([&](uint32_t t) {
                const int32_t key = s.key[t];
                if (key < 0) return;
                uint32_t at = s.next[key] + s.rank[t];
                for (uint32_t w = 0; w < t / Warp; ++w) at += s.found[w][key];
                table.to[at] = table.from ? table.from[first + t] : first + t;
            });
            block.each([&](uint32_t t) {
                if (t >= table.kinds) return;
                for (uint32_t w = 0; w < Warps; ++w) s.next[t] += s.found[w][t];
            });
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        table.for_pointers(visit);
    }

private:
    // The rank of a thread's entry; the last one of its key says how many there are.
    TR_HD static void count_in_warp(Shared &s, uint32_t t) {
        const int32_t key = s.key[t];
        if (key < 0) return;
        const uint32_t warp = t / Warp, lane = t % Warp;
        uint32_t before = 0, after = 0;
        for (uint32_t k = 0; k < Warp; ++k) {
            const bool same = s.key[warp * Warp + k] == key;
            before += same && k < lane, after += same && k > lane;
        }
        s.rank[t] = before;
        if (after == 0) s.found[warp][key] = before + 1;
    }
};

}  // namespace tr
