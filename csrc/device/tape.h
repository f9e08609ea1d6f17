// A level of the path tape in a device's memory has these groups of columns; the others are null.
#pragma once

#include "core/state/tape.h"

namespace tr {

// Groups besides those that all have: of scenes with stacks of BSDFs, with frames that follow the tangent; of
// derivatives by what moves; of paths through media; of light paths, and what forward mode has of these.
struct TapeParts {
    bool stacks, tangents, motion, media, light, splats;
};
constexpr TapeParts AllTapeParts{true, true, true, true, true, true};

// visit(array)
template <class Tape, class Visit>
void for_tape_arrays(Tape &tape, const TapeParts &parts, Visit &&visit) {
    tape.vertex.for_arrays(visit), tape.outgoing.for_arrays(visit), tape.scattering.for_arrays(visit);
    if (parts.stacks) tape.stack.for_arrays(visit);
    if (parts.tangents) tape.tangent.for_arrays(visit);
    if (parts.motion || parts.media || parts.light) tape.arrival.for_arrays(visit), tape.next.for_arrays(visit);
    if (parts.light) tape.connection.for_arrays(visit);
    if (parts.media) tape.segment.for_arrays(visit);
    if (parts.motion && parts.media) tape.motion.for_arrays(visit);
}

}  // namespace tr
