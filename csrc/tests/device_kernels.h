// Kernels that test launchers. Those of a card would not all be good ones.
#pragma once

#include "core/math/config.h"

namespace tr::testing {

struct AddOne {
    static constexpr const char *Name = "tr::testing::AddOne", *Header = "tests/device_kernels.h";
    float *numbers;
    TR_HD void operator()(uint32_t i) const { numbers[i] += 1; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(numbers);
    }
};

// In which order items come, of a device with one thread.
struct NoteOrder {
    static constexpr const char *Name = "tr::testing::NoteOrder", *Header = "tests/device_kernels.h";
    uint32_t *counter, *order;
    TR_HD void operator()(uint32_t i) const { order[(*counter)++] = i; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(counter), visit(order);
    }
};

struct WriteAt {
    static constexpr const char *Name = "tr::testing::WriteAt", *Header = "tests/device_kernels.h";
    float *numbers;
    int32_t where;
    TR_HD void operator()(uint32_t) const { numbers[where] = 0; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(numbers);
    }
};

}  // namespace tr::testing
