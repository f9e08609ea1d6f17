// SHA-256 (FIPS 180-4), by which compiled kernels are found again.
#pragma once

#include <string>

namespace tr {

// 64 hexadecimal digits.
std::string sha256(const std::string &bytes);

}  // namespace tr
