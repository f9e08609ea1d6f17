// A stable counting sort by small keys: entries of key 0, then those of key 1, ..., each in their order; those of a
// negative key are left out. Three launches: items of the first and the third are chunks of entries, of the second
// keys.
#pragma once

#include "core/math/config.h"

namespace tr {

struct SortTable {
    static constexpr uint32_t Chunk = 256, MostKinds = 64;

    const int32_t *key;       // of entry i
    const uint32_t *from;     // what is sorted; null: i itself
    const uint32_t *n;        // how many entries
    uint32_t *counts;         // (kinds, chunks), for the sort alone
    uint32_t *begin, *total;  // by key: where its entries begin, and how many they are
    uint32_t *to, *n_to;      // the result, of all keys
    uint32_t kinds, chunks;

    // Calls f(i) for the entries of a chunk.
    template <class Do>
    TR_HD void each(uint32_t chunk, Do &&f) const {
        const uint32_t first = chunk * Chunk, last = *n < first + Chunk ? *n : first + Chunk;
        for (uint32_t i = first; i < last; ++i)
            if (key[i] >= 0) f(i);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(key), visit(from), visit(n), visit(counts), visit(begin), visit(total), visit(to), visit(n_to);
    }
};

struct CountKeys {
    static constexpr const char *Name = "tr::CountKeys", *Header = "device/sort_kernels.h";
    SortTable table;

    TR_HD void operator()(uint32_t chunk) const {
        for (uint32_t k = 0; k < table.kinds; ++k) table.counts[k * table.chunks + chunk] = 0;
        table.each(chunk, [&](uint32_t i) { ++table.counts[uint32_t(table.key[i]) * table.chunks + chunk]; });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        table.for_pointers(visit);
    }
};

// Makes the counts of a key sums over the chunks before.
struct SumKeys {
    static constexpr const char *Name = "tr::SumKeys", *Header = "device/sort_kernels.h";
    SortTable table;

    TR_HD void operator()(uint32_t key) const {
        uint32_t sum = 0, *counts = table.counts + key * table.chunks;
        for (uint32_t chunk = 0; chunk < table.chunks; ++chunk) {
            const uint32_t count = counts[chunk];
            counts[chunk] = sum;
            sum += count;
        }
        table.total[key] = sum;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        table.for_pointers(visit);
    }
};

struct PlaceKeys {
    static constexpr const char *Name = "tr::PlaceKeys", *Header = "device/sort_kernels.h";
    SortTable table;

    TR_HD void operator()(uint32_t chunk) const {
        uint32_t next[SortTable::MostKinds], begin = 0;
        for (uint32_t k = 0; k < table.kinds; ++k) {
            next[k] = begin + table.counts[k * table.chunks + chunk];
            if (chunk == 0) table.begin[k] = begin;
            begin += table.total[k];
        }
        if (chunk == 0) *table.n_to = begin;
        table.each(chunk, [&](uint32_t i) { table.to[next[table.key[i]]++] = table.from ? table.from[i] : i; });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        table.for_pointers(visit);
    }
};

}  // namespace tr
