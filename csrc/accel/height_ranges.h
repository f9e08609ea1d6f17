// The ranges of a height field's control values, which tell rays where they have nothing to look for.
#pragma once

#include <vector>

#include "core/shape/height_walk.h"

namespace tr {

class HeightRanges {
public:
    void set(const float *heights, int rows, int columns);
    // The field as tables; the ranges stay in use until they are set again.
    HeightTable table(const float *heights, int rows, int columns, bool linear) const;
    const std::vector<HeightRange> &fine() const { return fine_.ranges; }
    const std::vector<HeightRange> &coarse() const { return coarse_.ranges; }

private:
    struct Level {
        int columns = 0, rows = 0;
        std::vector<HeightRange> ranges;
    };
    Level fine_, coarse_;
    HeightRange all_{};
};

// Around a field, in the world; a matrix of 3 rows of 4.
void height_box(const float to_world[12], const HeightRange &range, float lower[3], float upper[3]);

}  // namespace tr
