// What a device has of a scene: a tree that follows the scene's shapes, ray queries in it, and more.
#pragma once

#include <sys/types.h>

#include <memory>

#include "core/scene.h"
#include "device_tree.h"

namespace tr {

class SceneRays {
public:
    using MakeLauncher = std::unique_ptr<Launcher> (*)(int ordinal);
    // On the emulated device; or on the device of this number that is made so, and lost to processes that are forked.
    SceneRays();
    SceneRays(MakeLauncher make, int ordinal);
    ~SceneRays();
    SceneRays(const SceneRays &) = delete;
    SceneRays &operator=(const SceneRays &) = delete;

    // What of a shape is not there yet, as users call it; null: nothing.
    static const char *missing(const ShapeInfo &shape);

    // Brings the tree up to date with the shapes, none of which may miss something. `version` is another number when
    // one of them has moved; faces stay what they are.
    template <class S>
    void update(const SceneView<S> &scene, uint64_t version);

    // See Launcher.
    void use_stream(uintptr_t stream) {
        ensure_process();
        device_->launcher->use_stream(stream);
    }

    // As Accel's.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) {
        device_->launcher->know(shapes_);
        device_->tree.intersect(rays, hits, n);
    }
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) {
        device_->launcher->know(shapes_);
        device_->tree.occluded(rays, hit, n);
    }

    // The tree in the host's memory, until the next update.
    const Tree &tree() const { return tree_; }
    // ... and on the device, with its launcher and whatever else is there, a T that is made of the launcher: until the
    // next update, which leaves a device behind in the process that it belongs to.
    const TreeView &device_tree() const { return device_->tree.view(); }
    template <class T>
    T &resident() {
        if (!device_->resident) device_->resident = std::make_shared<T>(*device_->launcher);
        return *static_cast<T *>(device_->resident.get());
    }

    // How often the tree was made, and how often its boxes alone.
    uint64_t builds() const { return builds_; }
    uint64_t refits() const { return refits_; }

private:
    struct Device {
        std::unique_ptr<Launcher> launcher;
        DeviceTree tree;
        std::shared_ptr<void> resident;
        explicit Device(std::unique_ptr<Launcher> launcher);
    };
    const bool emulated_;
    std::unique_ptr<Device> device_;
    pid_t process_;  // in which it was made
    Tree tree_;
    SceneFacts shapes_;  // what kernels of rays have to know
    uint64_t version_ = 0, builds_ = 0, refits_ = 0;

    void leave_to_parent();
    void ensure_process();
};

}  // namespace tr
