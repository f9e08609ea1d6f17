// What the reverse sweep sums up, and the tangents of geometry that the forward sweep reads.
#pragma once

#include <cstddef>
#include <vector>

#include "parallel.h"

namespace tr {

// Numbers in the gradients of the scene's vertex arrays; 0 where none is wanted.
struct GeometrySizes {
    size_t positions = 0, normals = 0, texcoords = 0;
};

// The block of small parameters, followed by the matrices of curved shapes (12 numbers a shape); the vertex arrays.
template <class T>
struct GeometryArrays {
    std::vector<T> constants, positions, normals, texcoords;

    void reset(size_t n_constants, const GeometrySizes &sizes) {
        constants.assign(n_constants, T(0));
        positions.assign(sizes.positions, T(0));
        normals.assign(sizes.normals, T(0));
        texcoords.assign(sizes.texcoords, T(0));
    }
    void add(const GeometryArrays &other, int threads) {
        add(constants, other.constants, threads);
        add(positions, other.positions, threads);
        add(normals, other.normals, threads);
        add(texcoords, other.texcoords, threads);
    }

private:
    static void add(std::vector<T> &to, const std::vector<T> &from, int threads) {
        for_ranges(to.size(), threads, [&](size_t begin, size_t end, int) {
            for (size_t i = begin; i < end; ++i) to[i] += from[i];
        });
    }
};

using GradientSums = GeometryArrays<double>;

}  // namespace tr
