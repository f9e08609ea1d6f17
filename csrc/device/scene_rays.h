// Ray queries of a scene on the emulated device: a tree there that follows the scene's shapes.
#pragma once

#include <sys/types.h>

#include <memory>

#include "core/scene.h"
#include "device_tree.h"

namespace tr {

class SceneRays {
public:
    SceneRays();
    ~SceneRays();
    SceneRays(const SceneRays &) = delete;
    SceneRays &operator=(const SceneRays &) = delete;

    // What of a shape is not there yet, as users call it; null: nothing.
    static const char *missing(const ShapeInfo &shape);

    // Brings the tree up to date with the shapes, none of which may miss something. `version` is another number when
    // one of them has moved; faces stay what they are.
    template <class S>
    void update(const SceneView<S> &scene, uint64_t version);

    // As Accel's.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) { device_->tree.intersect(rays, hits, n); }
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) { device_->tree.occluded(rays, hit, n); }

    // How often the tree was made, and how often its boxes alone.
    uint64_t builds() const { return builds_; }
    uint64_t refits() const { return refits_; }

private:
    struct Device {
        std::unique_ptr<Launcher> launcher;
        DeviceTree tree;
        Device();
    };
    std::unique_ptr<Device> device_;
    pid_t process_;  // in which it was made
    Tree tree_;
    uint64_t version_ = 0, builds_ = 0, refits_ = 0;

    void leave_to_parent();
    void ensure_process();
};

}  // namespace tr
