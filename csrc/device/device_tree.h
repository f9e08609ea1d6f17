// A tree in a device's memory, and batches of rays that are traced there and come back.
#pragma once

#include "accel/accel.h"
#include "launcher.h"
#include "ray_kernels.h"
#include "tree_build.h"

namespace tr {

class DeviceTree {
public:
    // The launcher has to live longer. `batch_size`: rays of a launch, at most.
    explicit DeviceTree(Launcher &launcher, size_t batch_size = size_t(1) << 20)
        : launcher_(launcher), batch_size_(batch_size) {}

    // Copies a tree there.
    void set(const Tree &tree);

    // The one that was copied last.
    const TreeView &view() const { return view_; }

    // As Accel's.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n);
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n);

private:
    Launcher &launcher_;
    size_t batch_size_;
    TreeView view_{};
    DeviceArray<TreeNode> nodes_;
    DeviceArray<TreeItem> items_;
    DeviceArray<TreeMatrix> matrices_;
    DeviceArray<HeightTable> fields_;
    DeviceArray<SdfTable> grids_;
    DeviceArray<float> values_;
    DeviceArray<HeightRange> ranges_;
    DeviceArray<uint32_t> empty_;
    DeviceArray<float> rays_[7], found_[3];
    DeviceArray<uint32_t> shape_, primitive_;
    DeviceArray<uint8_t> hit_;

    RayTable upload(const RayBatch &rays, size_t begin, size_t n);
};

}  // namespace tr
