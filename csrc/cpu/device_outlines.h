// The outlines of a scene in a device's memory.
#pragma once

#include <vector>

#include "boundary_call.h"
#include "device/launcher.h"

namespace tr {

class DeviceOutlines {
public:
    // As they are now; tables are copied when they are others than those of the last time.
    OutlineTable table(Launcher &launcher, const OutlineSet &set);
    OutlinePiecesView pieces(Launcher &launcher, const OutlinePieces &given);
    // By emitter, see ShadowChoice.
    const OutlinePiecesView *shadows(Launcher &launcher, const ShadowPieces &given);

private:
    struct Pieces {
        DeviceArray<OutlinePiece> all;
        DeviceArray<double> cdf;
        DeviceArray<LeafPiece> leaves;

        OutlinePiecesView upload(Launcher &launcher, const OutlinePieces &given);
    };
    uint64_t revision_ = 0;  // of what is there
    OutlineTable table_{};
    DeviceArray<uint32_t> corners_, begin_;
    DeviceArray<OutlineEnds> around_;
    DeviceArray<OutlineMesh> meshes_;
    DeviceArray<OutlineCurve> curves_;
    DeviceArray<uint8_t> moving_;
    DeviceArray<OutlineLeaf> exact_;
    DeviceArray<RoundedLeaf> rounded_;
    std::vector<DeviceArray<OutlineNodes>> levels_;
    Pieces pieces_;
    std::vector<Pieces> shadows_;
    DeviceArray<OutlinePiecesView> views_;
};

}  // namespace tr
