// Arrays of zeros, from the allocator and from the system.
#include "cpu/zeros.h"
#include "harness.h"

namespace tr::testing {

TR_TEST(zeros) {
    const size_t large = LargeArray / sizeof(float);
    // once more of each: what was given back must not come again with its numbers
    for (size_t n :
         {size_t(0), size_t(1), size_t(1000), large - 1, large, large + 12345, size_t(1000), large + 12345}) {
        Zeros<float> first(n), other(std::move(first));
        float *p = other.data();
        CHECK(p != nullptr && first.data() == nullptr);
        if (n >= large) CHECK(uintptr_t(p) % LargePage == 0);
        size_t different = 0;
        for (size_t i = 0; i < n; ++i) {
            different += p[i] != 0;
            p[i] = 1;
        }
        CHECK(different == 0);
    }
}

// A wish about memory that somebody else has allocated: any address and size, what lies there stays.
TR_TEST(large_pages_keep_contents) {
    const size_t bytes = LargeArray + 3 * LargePage;
    Zeros<char> memory(bytes);
    memory.data()[77] = 3;
    memory.data()[bytes - 1] = 5;
    use_large_pages(memory.data() + 77, bytes - 77);
    use_large_pages(memory.data() + 77, 0);
    use_large_pages(nullptr, 0);
    CHECK(memory.data()[77] == 3 && memory.data()[bytes - 1] == 5);
}

}  // namespace tr::testing
