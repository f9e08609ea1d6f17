#include "device_tree.h"

#include <algorithm>

namespace tr {

static_assert(TreeHit::Miss == Accel::Miss);

void DeviceTree::set(const Tree &tree) {
    nodes_.upload(launcher_, tree.nodes.data(), tree.nodes.size());
    items_.upload(launcher_, tree.items.data(), tree.items.size());
    matrices_.upload(launcher_, tree.matrices.data(), tree.matrices.size());
    values_.upload(launcher_, tree.values.data(), tree.values.size());
    ranges_.upload(launcher_, tree.ranges.data(), tree.ranges.size());
    empty_.upload(launcher_, tree.empty.data(), tree.empty.size());
    std::vector<HeightTable> fields = tree.fields;
    for (HeightTable &field : fields) {
        if (!field.heights) continue;
        field.heights = values_.get() + (field.heights - tree.values.data());
        field.fine = ranges_.get() + (field.fine - tree.ranges.data());
        field.coarse = ranges_.get() + (field.coarse - tree.ranges.data());
    }
    fields_.upload(launcher_, fields.data(), fields.size());
    std::vector<SdfTable> grids = tree.grids;
    for (SdfTable &grid : grids) {
        if (!grid.values) continue;
        grid.values = values_.get() + (grid.values - tree.values.data());
        grid.empty = empty_.get() + (grid.empty - tree.empty.data());
    }
    grids_.upload(launcher_, grids.data(), grids.size());
    launcher_.synchronize();
    view_ = tree.view();
    view_.nodes = nodes_.get(), view_.items = items_.get(), view_.matrices = matrices_.get();
    view_.fields = fields_.get(), view_.grids = grids_.get();
}

RayTable DeviceTree::upload(const RayBatch &rays, size_t begin, size_t n) {
    const float *from[] = {rays.o[0], rays.o[1], rays.o[2], rays.d[0], rays.d[1], rays.d[2], rays.tmax};
    for (auto &column : rays_) column.reserve(launcher_, n);
    RayTable table;
    for (int k = 0; k < 7; ++k) {
        rays_[k].upload(launcher_, from[k] + begin, n);
        table.column[k] = rays_[k].get();
    }
    return table;
}

void DeviceTree::intersect(const RayBatch &rays, const HitBatch &hits, size_t n) {
    for (size_t begin = 0; begin < n; begin += batch_size_) {
        const size_t count = std::min(batch_size_, n - begin);
        for (auto *column : {&shape_, &primitive_}) column->reserve(launcher_, count);
        for (auto &column : found_) column.reserve(launcher_, count);
        const RayTable table = upload(rays, begin, count);
        launcher_.run(IntersectRays{view_, table, shape_.get(), primitive_.get(), found_[0].get(), found_[1].get(),
                                    found_[2].get()},
                      uint32_t(count));
        shape_.download(hits.shape + begin, count);
        primitive_.download(hits.primitive + begin, count);
        found_[0].download(hits.t + begin, count);
        found_[1].download(hits.b1 + begin, count);
        found_[2].download(hits.b2 + begin, count);
    }
}

void DeviceTree::occluded(const RayBatch &rays, uint8_t *hit, size_t n) {
    for (size_t begin = 0; begin < n; begin += batch_size_) {
        const size_t count = std::min(batch_size_, n - begin);
        hit_.reserve(launcher_, count);
        const RayTable table = upload(rays, begin, count);
        launcher_.run(OccludeRays{view_, table, hit_.get()}, uint32_t(count));
        hit_.download(hit + begin, count);
    }
}

}  // namespace tr
