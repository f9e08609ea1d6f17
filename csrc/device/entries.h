// Entries of queues that a launch works on, and what is left of one.
#pragma once

#include "core/math/config.h"

namespace tr {

// In their order, and how many these are.
struct EntryList {
    uint32_t *entry, *n;

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(entry), visit(n);
    }
};

// In lists of what is left; -1: nothing.
constexpr int32_t Kept = 0, Gone = -1;

}  // namespace tr
