// What most files read first, compiled once an instruction set and put in front of every file (setup.py): with packets
// it takes as long as the rest of a small file. A file includes what it needs nevertheless, as device code and
// clang-tidy read it without this.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/math/lanes.h"
