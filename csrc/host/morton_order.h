// Places in an order that keeps close ones together, along the curve of Morton, "A Computer Oriented Geodetic Data Base
// and a New Technique in File Sequencing" (1966).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace tr {

// What is there: its middle, and its size.
struct Extent {
    float middle[3], size;
};

// The order of n < 2^31 things: large ones first, so that few groups of neighbours are wide, in steps of a factor of
// 16; then by their cells of 1024^3, and in these by number. A function of these alone. What is not finite is anywhere.
std::vector<int32_t> morton_order(const Extent *things, size_t n, int threads);

}  // namespace tr
