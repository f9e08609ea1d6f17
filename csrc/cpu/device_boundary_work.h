// What one call of DeviceBoundary is about: for its own files alone.
#pragma once

#include <memory>

#include "device_boundary.h"

namespace tr {

constexpr bool is_of_camera(BoundaryPart part) {
    return part == BoundaryPart::Silhouettes || part == BoundaryPart::Outputs;
}

template <class S>
struct DeviceBoundary<S>::Work {
    std::unique_ptr<const LightPathCall<S>> light_path;  // to whose call and scene all else refers
    const RenderCall<S> &call;
    const BoundaryCall<S> &boundary;
    std::unique_ptr<const RenderCall<S>> path_call;  // of samples' paths, to which `paths` and `ends` refer
    DeviceCall<S> paths, ends, light;
    BoundaryView<S> view;
    uint32_t smooth = 0;  // kinds of BSDFs with smooth lobes, a bit each
    LightList lights{};
    ShadowChoice choice{};
    BoundaryFilm<S> film{};
    uint32_t batch = 0, group = 0;     // samples of a batch at most, and of those that work together
    uint64_t first = 0;                // sample of a batch, of the call
    std::vector<double> place, value;  // what was told of all samples so far

    const BoundaryPart &part() const { return boundary.part; }
    bool of_camera() const { return is_of_camera(part()); }
    bool of_lights() const {
        return part() == BoundaryPart::Shadows || part() == BoundaryPart::Pilot || part() == BoundaryPart::Pieces;
    }
    // Whether vertices of paths see edges, too.
    bool deep() const {
        const int depth = call.config.max_depth;
        return part() == BoundaryPart::Shadows && (depth < 0 || depth > 2);
    }
    bool has_paths() const { return part() == BoundaryPart::Reflections || deep(); }
    uint32_t n_groups(uint32_t n) const { return (n + group - 1) / group; }
    // Outlines that n samples have room for.
    uint32_t room(uint32_t n) const { return n_groups(n) * room_of(group); }

    BoundaryStage<S> stage(uint64_t *traced) const {
        return {light.stage.scene, path_call->config, view, light.tree, boundary.first + first, traced};
    }
    // Of paths that see light.
    BatchParts light_parts() const { return {call.config.volumetric, false}; }
    BoundaryGradients<S> gradients(const DerivativePlaces<S> &to) const {
        return {light.stage.scene, path_call->config, paths.stage.needs, to};
    }
};

template <class S>
template <class Visit>
void DeviceBoundary<S>::for_smooth(const Work &work, DeviceTile<S> &tile, Visit &&visit) {
    for (int l = 0; l < tile.levels().size(); ++l) {
        const TapeLevel &level = tile.levels()[l];
        for (const int32_t kind : work.paths.kinds)
            if (level.scatters && kind < MissKind && (work.smooth >> kind & 1u)) visit(level, l, kind);
    }
}

template <class S>
template <class Add>
void DeviceBoundary<S>::hand_on(const Work &work, const SlotColumns<S> &slots, uint32_t n, DerivativePlaces<S> to,
                                Add &&add) {
    if (to.forward) {
        for (int c = 0; c < SpectrumSize; ++c) clear(launcher_, slots.radiance[c], n);
        for (to.component = 0; to.component < work.call.values; ++to.component) add(to);
        return;
    }
    hand_back(to, add);
}

template <class S>
template <class Add>
void DeviceBoundary<S>::hand_back(DerivativePlaces<S> to, Add &&add) {
    to.measures = to.fixed;
    add(to);
    if (!to.fixed) return;
    to.measures = false;
    add(to);
    derivative_.settle(launcher_);
}

}  // namespace tr
