// What the kernels of paths and of their derivatives work on.
#pragma once

#include "core/integrator/light.h"
#include "kernel_name.h"
#include "knowledge.h"
#include "tape.h"

namespace tr {

// By slot: how many values were left out because they are not finite, and what brought the first one.
struct LostColumns {
    uint32_t *count, *culprit, *index;
    uint64_t *total;  // of all slots

    TR_HD void add(uint32_t slot, const Diagnostics &found) const {
        accumulate(total, found.non_finite);
        if (count[slot] == 0) culprit[slot] = uint32_t(found.culprit), index[slot] = uint32_t(found.index);
        count[slot] += uint32_t(found.non_finite);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(count), visit(culprit), visit(index), visit(total);
    }
};

// What all kernels of a rendering have: the scene, the settings, the samples. Tables lie in the device's memory.
template <class S>
struct PathStage {
    SceneView<S> scene;
    PathConfig config;
    SlotColumns<S> slots;
    LostColumns lost;
    S width, height;  // of the film
    // of a derivative: what it asks for, the level of the tape that vertices are on, see PathContext
    GradientNeeds needs{};
    TapeColumns<S> tape{};
    TR_RECORDED(records) = false;
    bool bsdfs_alone = false;

    // Calls f with the context of a path.
    template <class Do>
    TR_HD void with_context(uint32_t slot, Do &&f) const {
        Diagnostics found;
        f(PathContext<S>{scene, config, slots, found, &needs, records ? &tape : nullptr, false, nullptr, bsdfs_alone});
        if (found.non_finite != 0) lost.add(slot, found);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        scene.for_pointers(visit), slots.for_arrays(visit), lost.for_pointers(visit);
        visit(slots.lens.x), visit(slots.lens.y), visit(needs.bsdfs), visit(needs.variables);
        visit(needs.boxes);
        for_tape_arrays(tape, AllTapeParts, visit);
    }
};

// Of kernels of light paths: what the host has found of the sensor, which they all have in common.
template <class S>
struct LightView {
    Pinhole<S> camera{0, 0};
    int32_t meter = -1;

    TR_HD LightSensor<S> sensor(const PathStage<S> &stage) const {
        return {stage.scene.sensors[stage.config.sensor], camera, meter};
    }
};

}  // namespace tr
