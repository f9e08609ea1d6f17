// Pieces of outlines as they are found, see core/boundary/outline_pieces.h.
#pragma once

#include <algorithm>
#include <vector>

#include "core/boundary/outline_pieces.h"

namespace tr {

inline LeafPiece leaf_piece(size_t leaf, const float (&lengths)[OutlineWide]) {
    LeafPiece r{uint32_t(leaf), {}};
    const float most = *std::max_element(lengths, lengths + OutlineWide), scale = 254 / std::max(most, 1e-30f);
    for (size_t k = 0; k < OutlineWide; ++k) r.share[k] = uint8_t(lengths[k] > 0 ? 1 + int32_t(lengths[k] * scale) : 0);
    return r;
}

struct OutlinePieces {
    std::vector<OutlinePiece> all;
    std::vector<double> cdf;  // lengths on the film in pixels, added up
    std::vector<LeafPiece> leaves;

    double total() const { return cdf.empty() ? 0 : cdf.back(); }
    OutlinePiecesView view() const { return {all.data(), cdf.data(), leaves.data(), uint32_t(all.size())}; }
};

}  // namespace tr
