#include "device_tape.h"

namespace tr {

namespace {

template <class Level, class Visit>
void for_arrays(Level &level, const TapeParts &parts, Visit &&visit) {
    for_tape_arrays(level.tape, parts, visit);
    if (parts.splats) level.kept.for_arrays(visit);
}

}  // namespace

template <class S>
size_t DeviceTapeLevels<S>::bytes_per_entry(const TapeParts &parts) {
    size_t bytes = 0;
    const Level none;
    for_arrays(none, parts, [&](const auto *array) { bytes += sizeof(*array); });
    return bytes;
}

template <class S>
typename DeviceTapeLevels<S>::Level &DeviceTapeLevels<S>::add(Launcher &launcher, int parents, bool scatters,
                                                              uint32_t room, uint32_t kinds) {
    if (size_t(n_) == levels_.size()) levels_.emplace_back();
    Level &level = levels_[size_t(n_++)];
    level.parents = parents, level.scatters = scatters, level.room = room;
    const size_t aligned = (size_t(room) + 63) / 64 * 64;  // arrays begin at lines of the memory
    level.memory_.reserve(launcher, aligned * bytes_per_entry(parts_));
    level.tape = {}, level.kept = {};
    uint8_t *at = level.memory_.get();
    for_arrays(level, parts_, [&](auto *&array) {
        array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(at);
        at += aligned * sizeof(*array);
    });
    level.ranges_.reserve(launcher, 2 * size_t(kinds));
    level.begin = level.ranges_.get(), level.total = level.begin + kinds;
    return level;
}

template class DeviceTapeLevels<float>;
template class DeviceTapeLevels<double>;

}  // namespace tr
