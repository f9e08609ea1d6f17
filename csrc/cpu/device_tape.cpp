#include "device_tape.h"

namespace tr {

namespace {

template <class Level, class Visit>
void for_arrays(Level &level, const TapeParts &parts, Visit &&visit) {
    for_tape_arrays(level.tape, parts, visit);
    if (parts.splats) level.kept.for_arrays(visit);
}

size_t n_arrays(const TapeParts &parts) {
    size_t n = 0;
    const DeviceTapeLevels::Level none;
    for_arrays(none, parts, [&](const auto *) { ++n; });
    return n;
}

}  // namespace

size_t DeviceTapeLevels::bytes_per_entry(const TapeParts &parts) { return n_arrays(parts) * sizeof(uint32_t); }

DeviceTapeLevels::Level &DeviceTapeLevels::add(Launcher &launcher, int parents, bool scatters, uint32_t room,
                                               uint32_t kinds) {
    if (size_t(n_) == levels_.size()) levels_.emplace_back();
    Level &level = levels_[size_t(n_++)];
    level.parents = parents, level.scatters = scatters, level.room = room;
    const size_t aligned = (size_t(room) + 63) / 64 * 64;  // arrays begin at lines of the memory
    level.memory_.reserve(launcher, aligned * n_arrays(parts_));
    level.tape = {}, level.kept = {};
    uint32_t *at = level.memory_.get();
    for_arrays(level, parts_, [&](auto *&array) {
        static_assert(sizeof(*array) == sizeof(uint32_t));
        array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(at);
        at += aligned;
    });
    level.ranges_.reserve(launcher, 2 * size_t(kinds));
    level.begin = level.ranges_.get(), level.total = level.begin + kinds;
    return level;
}

}  // namespace tr
