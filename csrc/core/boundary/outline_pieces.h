// Pieces of outlines, from which one is chosen by its length where it is seen from.
#pragma once

#include "outline_tree.h"

namespace tr {

struct OutlinePiece {
    int32_t element;   // below zero: -1 - the number of a LeafPiece
    float begin, end;  // of its parameter
};

// Short edges of a leaf of the tree, whole, that are one among the pieces: a fine mesh with creases has millions. Their
// shares in its length are rounded, to numbers above zero.
struct LeafPiece {
    uint32_t leaf;
    uint8_t share[OutlineWide];

    TR_HD int sum() const {
        int r = 0;
        for (size_t k = 0; k < OutlineWide; ++k) r += share[k];
        return r;
    }
};

// A place on one: its element, parameter, and one over the density of both.
struct OutlinePlace {
    int32_t element;
    double s, inverse_density;
};

struct OutlinePiecesView {
    const OutlinePiece *all;
    const double *cdf;  // lengths, added up
    const LeafPiece *leaves;
    uint32_t n;

    TR_HD double total() const { return n == 0 ? 0 : cdf[n - 1]; }

    // For a number in [0, 1).
    TR_HD OutlinePlace choose(double number, const OutlineTreeView &tree) const {
        const double at = number * total();
        uint32_t found = 0, count = n;  // the first one that ends beyond it
        while (count > 0) {
            const uint32_t half = count / 2;
            if (cdf[found + half] > at)
                count = half;
            else
                found += half + 1, count -= half + 1;
        }
        found = std::min(found, n - 1);
        const double before = found > 0 ? cdf[found - 1] : 0, mass = cdf[found] - before,
                     left = std::min(std::max((at - before) / mass, 0.0), 1 - 0x1p-53);
        const OutlinePiece &piece = all[found];
        if (piece.element < 0) return choose(leaves[-1 - piece.element], left, total() / mass, tree);
        const double length = double(piece.end) - double(piece.begin);
        return {piece.element, piece.begin + length * left, total() * length / mass};
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(all), visit(cdf), visit(leaves);
    }

private:
    TR_HD static OutlinePlace choose(const LeafPiece &piece, double number, double inverse_density,
                                     const OutlineTreeView &tree) {
        const int sum = piece.sum();
        double left = std::min(number * sum, sum - 0x1p-40);  // below it, rounded or not
        size_t k = 0;
        for (; left >= piece.share[k]; ++k) left -= piece.share[k];
        return {tree.index(piece.leaf, k), left / piece.share[k], inverse_density * sum / piece.share[k]};
    }
};

}  // namespace tr
