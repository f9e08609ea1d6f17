#include "scene_rays.h"

#include <unistd.h>

#include <algorithm>
#include <stdexcept>
#include <thread>

#include "accel/height_ranges.h"
#include "accel/sdf_blocks.h"
#include "core/shape/heightfield.h"
#include "core/shape/sdfgrid.h"
#include "emulated.h"

namespace tr {

namespace {

template <class S>
TreeItem face_item(const SceneView<S> &scene, uint32_t shape, uint32_t face) {
    const uint32_t *corners = scene.faces + (size_t(scene.shapes[shape].face_offset) + face) * 3;
    float p[3][3];
    for (int c = 0; c < 3; ++c)
        for (size_t k = 0; k < 3; ++k) p[c][k] = float(scene.vertices[size_t(corners[c]) * VertexRow<S>::Size + k]);
    return triangle_item(shape, face, p[0], p[1], p[2]);
}

// In single precision, as Embree's callbacks have them: hits are the same.
template <class S>
void single_matrix(const S *from, double *to) {
    for (int k = 0; k < 12; ++k) to[k] = double(float(from[k]));
}

template <class S>
TreeItem curved_item(const SceneView<S> &scene, const Tree &tree, uint32_t shape) {
    const int32_t flags = scene.shapes[shape].flags;
    double to_world[12];
    single_matrix(scene.shape_matrices + 24 * size_t(shape), to_world);
    if (flags & IsHeightField) return field_item(shape, tree.fields[shape].range, to_world);
    if (flags & IsSdfGrid) return grid_item(shape, tree.grids[shape], to_world);
    return quadric_item(shape,
                        flags & IsSphere     ? TreeKind::Sphere
                        : flags & IsCylinder ? TreeKind::Cylinder
                                             : TreeKind::Disk,
                        to_world);
}

// Tables of the height fields and grids of distances, in single precision, and all that they refer to.
template <class S>
void set_tables(const SceneView<S> &scene, Tree &tree) {
    struct Begin {
        size_t values, fine, coarse, empty;
    };
    std::vector<Begin> begin(size_t(scene.n_shapes));
    tree.fields.clear(), tree.grids.clear(), tree.values.clear(), tree.ranges.clear(), tree.empty.clear();
    const auto append = [&](const S *values, size_t n) {
        tree.values.insert(tree.values.end(), values, values + n);
        return tree.values.data() + (tree.values.size() - n);
    };
    for (uint32_t shape = 0; shape < uint32_t(scene.n_shapes); ++shape) {
        const int32_t flags = scene.shapes[shape].flags;
        begin[shape] = {tree.values.size(), tree.ranges.size(), 0, tree.empty.size()};
        if (flags & IsHeightField) {
            const HeightView<S> field(scene, shape);
            const float *heights = append(field.data, size_t(field.rows) * size_t(field.columns));
            HeightRanges ranges;
            ranges.set(heights, field.rows, field.columns);
            tree.ranges.insert(tree.ranges.end(), ranges.fine().begin(), ranges.fine().end());
            begin[shape].coarse = tree.ranges.size();
            tree.ranges.insert(tree.ranges.end(), ranges.coarse().begin(), ranges.coarse().end());
            tree.fields.resize(size_t(scene.n_shapes));
            tree.fields[shape] = ranges.table(nullptr, field.rows, field.columns, field.linear);
        } else if (flags & IsSdfGrid) {
            const SdfGridView<S> grid(scene, shape);
            const float *values = append(grid.data, size_t(grid.stride[2]) * size_t(grid.cells[2] + 1));
            SdfBlocks blocks;
            blocks.set(values, {grid.cells[0] + 1, grid.cells[1] + 1, grid.cells[2] + 1});
            tree.empty.insert(tree.empty.end(), blocks.empty().begin(), blocks.empty().end());
            tree.grids.resize(size_t(scene.n_shapes));
            tree.grids[shape] = blocks.table();
        }
    }
    // once none of them is moved any more
    for (uint32_t shape = 0; shape < uint32_t(scene.n_shapes); ++shape) {
        const Begin &at = begin[shape];
        if (scene.shapes[shape].flags & IsHeightField) {
            HeightTable &field = tree.fields[shape];
            field.heights = tree.values.data() + at.values;
            field.fine = tree.ranges.data() + at.fine, field.coarse = tree.ranges.data() + at.coarse;
        } else if (scene.shapes[shape].flags & IsSdfGrid) {
            tree.grids[shape].values = tree.values.data() + at.values;
            tree.grids[shape].empty = tree.empty.data() + at.empty;
        }
    }
}

}  // namespace

SceneRays::Device::Device(std::unique_ptr<Launcher> made) : launcher(std::move(made)), tree(*launcher) {}

SceneRays::SceneRays() : emulated_(true), device_(std::make_unique<Device>(make_emulated())), process_(getpid()) {}

SceneRays::SceneRays(MakeLauncher make, int ordinal)
    : emulated_(false), device_(std::make_unique<Device>(make(ordinal))), process_(getpid()) {}

SceneRays::~SceneRays() {
    if (process_ != getpid()) leave_to_parent();
}

// After a fork the parent's device has lost its thread, and cannot even be taken down: it is left where it is.
void SceneRays::leave_to_parent() { [[maybe_unused]] const Device *left = device_.release(); }

void SceneRays::ensure_process() {
    if (process_ == getpid()) return;
    if (!emulated_)
        throw std::runtime_error(
            "device: a card cannot be used by a process that was forked from one that has used it; "
            "start it by the method spawn");
    leave_to_parent();
    device_ = std::make_unique<Device>(make_emulated());
    process_ = getpid();
    if (version_ != 0) device_->tree.set(tree_);
}

const char *SceneRays::missing(const ShapeInfo &shape) {
    if (shape.flags & IsCurve) return shape.flags & IsStraight ? "a linearcurve" : "a bsplinecurve";
    return nullptr;
}

template <class S>
void SceneRays::update(const SceneView<S> &scene, uint64_t version) {
    ensure_process();
    if (version == version_) return;
    const bool first = version_ == 0;
    version_ = 0;  // until it is done
    tree_.matrices.resize(size_t(scene.n_shapes));
    set_tables(scene, tree_);
    if (first) tree_.items.clear();
    for (uint32_t shape = 0; shape < uint32_t(scene.n_shapes); ++shape) {
        const ShapeInfo &info = scene.shapes[shape];
        const bool curved = info.flags & IsCurved;
        shapes_.shape_flags |= info.flags;
        if (curved) single_matrix(scene.shape_matrices + 24 * size_t(shape) + 12, tree_.matrices[shape].to_object);
        if (!first) continue;
        if (curved)
            tree_.items.push_back(curved_item(scene, tree_, shape));
        else
            for (uint32_t f = 0; f < uint32_t(info.n_faces); ++f) tree_.items.push_back(face_item(scene, shape, f));
    }
    if (!first)
        for (TreeItem &item : tree_.items)
            item = item.kind == TreeKind::Triangle ? face_item(scene, item.shape, item.primitive)
                                                   : curved_item(scene, tree_, item.shape);
    if (first || !tree_.refit()) {
        tree_.build(int(std::max(1u, std::thread::hardware_concurrency())));
        ++builds_;
    } else {
        ++refits_;
    }
    device_->tree.set(tree_);
    version_ = version;
}

template void SceneRays::update(const SceneView<float> &, uint64_t);
template void SceneRays::update(const SceneView<double> &, uint64_t);

}  // namespace tr
