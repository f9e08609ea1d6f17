// Pieces of outlines, from which one is chosen by its length where it is seen from.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

#include "host/outline_tree.h"

namespace tr {

struct OutlinePiece {
    int32_t element;   // below zero: -1 - the number of a LeafPiece
    float begin, end;  // of its parameter
};

// Short edges of a leaf of the tree, whole, that are one among the pieces: a fine mesh with creases has millions. Their
// shares in its length are rounded, to numbers above zero.
struct LeafPiece {
    static constexpr size_t Wide = OutlineTree::Wide;
    uint32_t leaf;
    uint8_t share[Wide];

    LeafPiece(size_t number, const float (&lengths)[Wide]) : leaf(uint32_t(number)) {
        const float most = *std::max_element(lengths, lengths + Wide), scale = 254 / std::max(most, 1e-30f);
        for (size_t k = 0; k < Wide; ++k) share[k] = uint8_t(lengths[k] > 0 ? 1 + int32_t(lengths[k] * scale) : 0);
    }
    int sum() const { return std::accumulate(share, share + Wide, 0); }
};

struct OutlinePieces {
    std::vector<OutlinePiece> all;
    std::vector<double> cdf;  // lengths on the film in pixels, added up
    std::vector<LeafPiece> leaves;

    double total() const { return cdf.empty() ? 0 : cdf.back(); }

    // A place on one, for a number in [0, 1): its element, parameter, and one over the density of both.
    struct Place {
        int32_t element;
        double s, inverse_density;
    };
    Place choose(double number, const OutlineTree &tree) const {
        const double *begin = cdf.data(), *end = begin + cdf.size(), at = number * total(),
                     *found = std::min(std::upper_bound(begin, end, at), end - 1);
        const double before = found > begin ? found[-1] : 0, mass = *found - before,
                     left = std::clamp((at - before) / mass, 0.0, 1 - 0x1p-53);
        const OutlinePiece &piece = all[size_t(found - begin)];
        if (piece.element < 0) return choose(leaves[size_t(-1 - piece.element)], left, total() / mass, tree);
        const double length = double(piece.end) - double(piece.begin);
        return {piece.element, piece.begin + length * left, total() * length / mass};
    }

private:
    static Place choose(const LeafPiece &piece, double number, double inverse_density, const OutlineTree &tree) {
        const int sum = piece.sum();
        double left = std::min(number * sum, sum - 0x1p-40);  // below it, rounded or not
        size_t k = 0;
        for (; left >= piece.share[k]; ++k) left -= piece.share[k];
        return {tree.index(piece.leaf, k), left / piece.share[k], inverse_density * sum / piece.share[k]};
    }
};

}  // namespace tr
