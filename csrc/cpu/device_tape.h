// The path tape of a batch in a device's memory, a level a vertex of all paths.
#pragma once

#include <deque>

#include "device/launcher.h"
#include "device/splat_kernels.h"
#include "device/tape.h"

namespace tr {

template <class S>
class DeviceTapeLevels {
public:
    struct Level {
        static constexpr int NoParents = -1;
        TapeColumns<S> tape{};
        KeptConnections<S> kept{};
        uint32_t *begin = nullptr, *total = nullptr;  // by kind: where its entries begin, and how many they are
        int parents = NoParents;                      // the level of the vertices before
        bool scatters = false;
        uint32_t room = 0;  // entries there may be

    private:
        friend class DeviceTapeLevels;
        DeviceArray<uint8_t> memory_;
        DeviceArray<uint32_t> ranges_;
    };

    // The launcher has to live longer.
    void begin(const TapeParts &parts) { parts_ = parts, n_ = 0; }
    // One more, of so many kinds. Memory of levels is kept for those that come after the next `begin`.
    Level &add(Launcher &launcher, int parents, bool scatters, uint32_t room, uint32_t kinds);
    int size() const { return n_; }
    Level &operator[](int i) { return levels_[size_t(i)]; }

    static size_t bytes_per_entry(const TapeParts &parts);

private:
    std::deque<Level> levels_;
    TapeParts parts_{};
    int n_ = 0;
};

}  // namespace tr
