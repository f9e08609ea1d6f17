// `volume`: a volume, looked up where the surface is in the world.
#pragma once

#include "../volume/volume.h"

namespace tr {

struct VolumeTexture {
    enum { VolumeIndex };
    static constexpr Field fields[] = {
        {"volume", Kind::Volume, 0.75, -INFINITY, INFINITY, "interior", "looked up at the point's place in the world"},
    };
    static constexpr Model model = {
        "texture", "volume", "A volume, looked up where the surface is in the world.", fields, 1, 0, "VolumeTexture"};
};

}  // namespace tr
