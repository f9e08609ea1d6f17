// Places in an order that keeps close ones together, along the curve of Morton, "A Computer Oriented Geodetic Data Base
// and a New Technique in File Sequencing" (1966).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace tr {

// The order of n < 2^31 places (n, 3). It is a function of these alone: places in one cell of 2048^3 go by their
// numbers, and what is not finite goes first.
std::vector<int32_t> morton_order(const float *places, size_t n, int threads);

}  // namespace tr
