#include "accel.h"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <stdexcept>
#include <vector>

#include "curves.h"
#include "embree_library.h"
#include "embree_queries.h"
#include "face_list.h"
#include "height_field.h"
#include "quadric.h"
#include "sdf_grid.h"
#include "tree_cost.h"

namespace tr {

namespace {

std::atomic<int> requested_width{0};

// The width of this build's packets, so that an instruction set can be tested by itself; the plain build takes what
// the processor has.
int default_width(int widest) {
#if defined(TR_PACKET_WIDTH) && TR_PACKET_WIDTH > 1
    return std::min(TR_PACKET_WIDTH, widest);
#else
    return widest;
#endif
}

struct Mesh {
    rtc::Geometry geometry = nullptr;
    float *positions = nullptr;  // Embree's buffers
    uint32_t *faces = nullptr;
    size_t n_vertices = 0, n_faces = 0;
    TreeCost cost;       // of this mesh's own tree
    bool listed = true;  // in the list of faces, until it is given to Embree
};

// A refitted tree is built again when its estimated cost has grown by this factor. On a mesh of 500000 triangles that
// was twisted, folded, made wavy and noisy, queries then took at most 1.3 times as long as in a new tree, and beyond it
// up to 3 times; building takes as long as 15 refits.
constexpr double LargestGrowth = 1.2;

// Triangles of a mesh that is listed beside larger ones: a box has 12.
constexpr size_t LargestListed = 12;

}  // namespace

struct Accel::Impl {
    std::shared_ptr<const EmbreeDevice> device = embree_device();
    pid_t process = getpid();
    rtc::Scene scene = nullptr, whole = nullptr;
    int width = 0;
    bool embree_only = false;  // a width was asked for
    const RayWalk *walk = nullptr;
    // Meshes of few faces, which are not in Embree's tree, and where everything else is.
    FaceList faces;
    Box rest;
    std::map<uint32_t, HeightField> fields;
    std::map<uint32_t, SdfGrid> grids;
    // Something that is neither in the list nor Embree's.
    bool beside() const { return !fields.empty() || !grids.empty(); }
    template <class Function>
    void for_beside(Function &&f) const {
        for (const auto &entry : fields) f(entry.second);
        for (const auto &entry : grids) f(entry.second);
    }
    // Unbuilt; one good tree for everything that stands still; one made in less time; a tree for each mesh.
    enum class Stage { Unbuilt, Still, Moved, Moving } stage = Stage::Unbuilt;
    bool hurry = false;  // the first build is a fast one, too
    Counters counters;
    std::map<uint32_t, Mesh> meshes;
    std::map<uint32_t, std::pair<rtc::Geometry, std::unique_ptr<Quadric>>> quadrics;
    std::map<uint32_t, Curve> curves;

    const rtc::Api &api() const { return device->api; }

    Impl() { open(); }

    void open() {
        scene = api().NewScene(device->handle);
        api().SetSceneBuildQuality(scene, rtc::BuildHigh);
        device->check("while making a scene");
        int asked = requested_width;
        embree_only = asked != 0;
        width = asked ? std::min(asked, device->widest_query) : default_width(device->widest_query);
    }

    // Embree's scene with the listed meshes, too.
    rtc::Scene with_all() {
        if (faces.size() == 0) return scene;
        if (!whole) {
            whole = api().NewScene(device->handle);
            api().SetSceneBuildQuality(whole, rtc::BuildHigh);
            for (auto &[shape, mesh] : meshes) api().AttachGeometryByID(whole, mesh.geometry, shape);
            for (auto &[shape, quadric] : quadrics) api().AttachGeometryByID(whole, quadric.first, shape);
            for (auto &[shape, curve] : curves) api().AttachGeometryByID(whole, curve.geometry, shape);
            api().CommitScene(whole);
            device->check("while building the acceleration structure");
        }
        return whole;
    }

    void release_whole() {
        if (whole) api().ReleaseScene(whole);
        whole = nullptr;
    }

    void close() {
        release_whole();
        for (auto &[shape, mesh] : meshes) api().ReleaseGeometry(mesh.geometry);
        for (auto &[shape, quadric] : quadrics) api().ReleaseGeometry(quadric.first);
        for (auto &[shape, curve] : curves) api().ReleaseGeometry(curve.geometry);
        if (scene) api().ReleaseScene(scene);
        scene = nullptr;
    }

    // After a fork queries go on working, but the parent's device has lost its threads and cannot build: geometry that
    // is to be changed moves to a device of this process. What the parent made is left where it is.
    void ensure_process() {
        if (process == getpid()) return;
        auto old_meshes = std::move(meshes);
        auto old_quadrics = std::move(quadrics);
        auto old_curves = std::move(curves);
        leave_to_parent(std::move(device), scene);
        whole = nullptr;
        meshes.clear();
        quadrics.clear();
        curves.clear();
        device = embree_device();
        process = getpid();
        stage = Stage::Unbuilt;
        hurry = true;
        open();
        for (auto &[shape, mesh] : old_meshes)
            set_mesh(shape, mesh.positions, mesh.n_vertices, mesh.faces, mesh.n_faces);
        for (auto &[shape, quadric] : old_quadrics) set_quadric(*quadric.second);
        for (auto &[shape, curve] : old_curves)
            set_curve(shape, curve.points, curve.n_points, curve.segments, curve.n_segments, curve.straight);
    }

    void set_mesh(uint32_t shape, const float *positions, size_t n_vertices, const uint32_t *faces, size_t n_faces) {
        auto found = meshes.find(shape);
        if (found == meshes.end()) {
            if (!faces) throw std::runtime_error("Accel::set_mesh: a new mesh without faces");
            found = meshes.emplace(shape, new_mesh(n_vertices, n_faces)).first;
            std::memcpy(found->second.faces, faces, n_faces * 12);
            if (stage != Stage::Unbuilt) attach(shape, found->second);
        }
        Mesh &mesh = found->second;
        if (mesh.n_vertices != n_vertices || mesh.n_faces != n_faces)
            throw std::runtime_error("Accel::set_mesh: the number of vertices or faces has changed");
        bool other_faces = faces && std::memcmp(mesh.faces, faces, n_faces * 12) != 0;
        if (other_faces) std::memcpy(mesh.faces, faces, n_faces * 12);
        std::memcpy(mesh.positions, positions, n_vertices * 12);
        if (stage != Stage::Unbuilt) {
            api().UpdateGeometryBuffer(mesh.geometry, rtc::BufferVertex, 0);
            bool again = other_faces;
            if (stage == Stage::Moving) {
                again = again || mesh.cost.growth(mesh.positions) > LargestGrowth;
                if (again) mesh.cost.reset(mesh.positions, mesh.faces, n_faces);
                ++(again ? counters.rebuilds : counters.refits);
            }
            // other indices are what Embree takes as a reason to build a mesh's tree again
            if (again) api().UpdateGeometryBuffer(mesh.geometry, rtc::BufferIndex, 0);
        }
        api().CommitGeometry(mesh.geometry);
        device->check("while setting a mesh");
    }

    Mesh new_mesh(size_t n_vertices, size_t n_faces) {
        Mesh mesh;
        mesh.geometry = api().NewGeometry(device->handle, rtc::GeometryTriangle);
        mesh.n_vertices = n_vertices;
        mesh.n_faces = n_faces;
        if (mesh.geometry) {
            mesh.positions = static_cast<float *>(
                api().SetNewGeometryBuffer(mesh.geometry, rtc::BufferVertex, 0, rtc::FormatFloat3, 12, n_vertices));
            mesh.faces = static_cast<uint32_t *>(
                api().SetNewGeometryBuffer(mesh.geometry, rtc::BufferIndex, 0, rtc::FormatUInt3, 12, n_faces));
            api().SetGeometryBuildQuality(mesh.geometry, rtc::BuildRefit);  // counts in Stage::Moving only
        }
        if (mesh.positions && mesh.faces) return mesh;
        if (mesh.geometry) api().ReleaseGeometry(mesh.geometry);
        device->check("while making a mesh");
        throw std::runtime_error("Embree has no memory for a mesh");
    }

    void commit(bool fast) {
        static constexpr rtc::BuildQuality quality[] = {rtc::BuildMedium, rtc::BuildHigh, rtc::BuildMedium,
                                                        rtc::BuildLow};
        Stage next = stage == Stage::Unbuilt ? (fast || hurry ? Stage::Moved : Stage::Still)
                     : stage == Stage::Still ? Stage::Moved
                                             : Stage::Moving;
        if (next != stage) {
            ++counters.builds;
            api().SetSceneBuildQuality(scene, quality[int(next)]);
            if (next == Stage::Moving) {
                api().SetSceneFlags(scene, rtc::SceneDynamic);  // keeps what refitting needs
                for (auto &[shape, mesh] : meshes) mesh.cost.reset(mesh.positions, mesh.faces, mesh.n_faces);
            }
        }
        if (stage == Stage::Unbuilt) choose_listed();
        release_whole();
        // whatever happens now, the next commit is not the first
        stage = next;
        api().CommitScene(scene);
        device->check("while building the acceleration structure");
        faces.clear();
        for (const auto &[shape, mesh] : meshes)
            if (mesh.listed) faces.add_mesh(shape, mesh.positions, mesh.faces, mesh.n_faces);
        rtc::Bounds box{{INFINITY, INFINITY, INFINITY}, 0, {-INFINITY, -INFINITY, -INFINITY}, 0};
        api().GetSceneBounds(scene, &box);
        std::copy_n(box.lower, 3, rest.lower);
        std::copy_n(box.upper, 3, rest.upper);
    }

    void attach(uint32_t shape, Mesh &mesh) {
        mesh.listed = false;
        api().AttachGeometryByID(scene, mesh.geometry, shape);
    }

    // Which meshes are in the list: all of a tiny scene, else the largest of those with few faces (walls, floors,
    // lamps), around which a tree has little to gain. The others are Embree's; who asks for a query width wants to see
    // Embree.
    void choose_listed() {
        std::vector<std::pair<float, uint32_t>> candidates;
        FaceList all;
        bool tiny = quadrics.empty() && curves.empty();
        for (const auto &[shape, mesh] : meshes) {
            tiny = tiny && mesh.n_faces <= 2 * FaceList::limit();
            if (tiny) {
                all.add_mesh(shape, mesh.positions, mesh.faces, mesh.n_faces);
                tiny = all.size() <= FaceList::limit();
            }
            if (mesh.n_faces > LargestListed) continue;
            FaceList own;
            own.add_mesh(shape, mesh.positions, mesh.faces, mesh.n_faces);
            candidates.push_back({own.bounds().half_area(), shape});
        }
        std::vector<uint32_t> chosen;
        if (!tiny) {
            std::sort(candidates.rbegin(), candidates.rend());
            FaceList some;
            for (const auto &[area, shape] : candidates) {
                const Mesh &mesh = meshes.at(shape);
                some.add_mesh(shape, mesh.positions, mesh.faces, mesh.n_faces);
                if (some.size() > FaceList::limit() / 4) break;
                chosen.push_back(shape);
            }
        }
        for (auto &[shape, mesh] : meshes) {
            bool listed = tiny || std::find(chosen.begin(), chosen.end(), shape) != chosen.end();
            if (embree_only || !listed) attach(shape, mesh);
        }
    }

    void set_curve(uint32_t shape, const float *points, size_t n_points, const uint32_t *segments, size_t n_segments,
                   bool straight) {
        auto found = curves.find(shape);
        if (found == curves.end()) {
            found = curves.emplace(shape, new_curve(*device, n_points, segments, n_segments, straight)).first;
            api().AttachGeometryByID(scene, found->second.geometry, shape);
        }
        set_curve_points(*device, found->second, points);
    }

    void set_quadric(const Quadric &values) {
        auto &[geometry, quadric] = quadrics[values.shape];
        if (!quadric) quadric = std::make_unique<Quadric>();
        *quadric = values;  // its address is what Embree's callbacks get
        if (!geometry) {
            geometry = api().NewGeometry(device->handle, rtc::GeometryUser);
            api().SetGeometryUserPrimitiveCount(geometry, 1);
            api().SetGeometryUserData(geometry, quadric.get());
            api().SetGeometryBoundsFunction(geometry, Quadric::on_bounds, quadric.get());
            api().SetGeometryIntersectFunction(geometry, Quadric::on_intersect);
            api().SetGeometryOccludedFunction(geometry, Quadric::on_occluded);
            api().AttachGeometryByID(scene, geometry, values.shape);
        }
        api().CommitGeometry(geometry);
        device->check("while setting a sphere, disk or cylinder");
    }

    // Embree's part of the scene
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n, bool coherent) const {
        intersect_embree(api(), scene, width, rays, hits, n, coherent);
    }
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
        occluded_embree(api(), scene, width, rays, hit, n);
    }

    ~Impl() {
        if (process == getpid())
            close();
        else
            leave_to_parent(std::move(device), scene);
    }
};

Accel::Accel() : impl_(std::make_unique<Impl>()) {}
Accel::~Accel() = default;
Accel::Accel(Accel &&) noexcept = default;
Accel &Accel::operator=(Accel &&) noexcept = default;

void Accel::set_mesh(uint32_t shape, const float *positions, size_t n_vertices, const uint32_t *faces, size_t n_faces) {
    impl_->ensure_process();
    impl_->set_mesh(shape, positions, n_vertices, faces, n_faces);
}

void Accel::set_quadric(uint32_t shape, QuadricKind kind, const float to_world[12], const float to_object[12]) {
    impl_->ensure_process();
    Quadric q;
    q.kind = kind;
    q.shape = shape;
    std::copy(to_world, to_world + 12, q.to_world);
    std::copy(to_object, to_object + 12, q.to_object);
    impl_->set_quadric(q);
}

void Accel::set_curve(uint32_t shape, const float *points, size_t n_points, const uint32_t *segments, size_t n_segments,
                      bool straight) {
    impl_->ensure_process();
    impl_->set_curve(shape, points, n_points, segments, n_segments, straight);
}

float Accel::set_heights(uint32_t shape, const float *heights, int rows, int columns, bool linear) {
    return impl_->fields[shape].set_heights(shape, heights, rows, columns, linear);
}
void Accel::place_heights(uint32_t shape, const float to_world[12], const float to_object[12]) {
    impl_->fields[shape].set_matrices(to_world, to_object);
}
void Accel::refer_heights(uint32_t shape, const float *heights) { impl_->fields.at(shape).refer(heights); }

SdfGrid &Accel::sdf_grid(uint32_t shape) { return impl_->grids[shape]; }

void Accel::commit(bool fast) {
    impl_->ensure_process();
    impl_->commit(fast);
}

const Accel::Counters &Accel::counters() const { return impl_->counters; }

EmbreeScene Accel::embree() const { return {&impl_->api(), impl_->with_all(), impl_->device->widest_query}; }

void Accel::bounds(float out[6]) const {
    const Box &listed = impl_->faces.bounds();
    for (int i = 0; i < 3; ++i) {
        out[i] = std::min(impl_->rest.lower[i], listed.lower[i]);
        out[3 + i] = std::max(impl_->rest.upper[i], listed.upper[i]);
        impl_->for_beside([&](const auto &one) {
            out[i] = std::min(out[i], one.bounds().lower[i]);
            out[3 + i] = std::max(out[3 + i], one.bounds().upper[i]);
        });
    }
}

namespace {

// Closest hits of what lies in a box, by `query`, for the rays that come near it; they replace hits behind them.
template <class Query>
void intersect_near(const Box &box, const RayBatch &rays, const HitBatch &hits, size_t n, Query &&query) {
    NearRays near;
    RayBatch until{{rays.o[0], rays.o[1], rays.o[2]}, {rays.d[0], rays.d[1], rays.d[2]}, hits.t};
    for (size_t begin = 0; begin < n; begin += NearRays::Capacity) {
        near.take(until, begin, n, nullptr, box);
        query(near);
        for (size_t k = 0; k < near.n; ++k) {
            if (near.shape[k] == Accel::Miss) continue;
            size_t i = near.index[k];
            hits.shape[i] = near.shape[k];
            hits.primitive[i] = near.primitive[k];
            hits.t[i] = near.t[k];
            hits.b1[i] = near.b1[k];
            hits.b2[i] = near.b2[k];
        }
    }
}

// The same for occlusion, of rays that are not yet.
template <class Query>
void occluded_near(const Box &box, const RayBatch &rays, uint8_t *hit, size_t n, Query &&query) {
    NearRays near;
    for (size_t begin = 0; begin < n; begin += NearRays::Capacity) {
        near.take(rays, begin, n, hit, box);
        query(near);
        for (size_t k = 0; k < near.n; ++k) hit[near.index[k]] = near.occluded[k];
    }
}

}  // namespace

void Accel::walk(const RayWalk *walk) { impl_->walk = walk; }

void Accel::intersect(const RayBatch &rays, const HitBatch &hits, size_t n, bool coherent) const {
    if (impl_->walk) return impl_->walk->intersect(rays, hits, n);
    // the list comes first also when it is empty and there is nothing but what is beside both: it marks misses
    if (impl_->faces.size() == 0 && (!impl_->beside() || !impl_->rest.empty())) {
        impl_->intersect(rays, hits, n, coherent);
    } else {
        impl_->faces.intersect(rays, hits, n);
        if (!impl_->rest.empty())
            intersect_near(impl_->rest, rays, hits, n,
                           [&](NearRays &near) { impl_->intersect(near.rays(), near.hits(), near.n, coherent); });
    }
    impl_->for_beside([&](const auto &one) {
        intersect_near(one.bounds(), rays, hits, n,
                       [&](NearRays &near) { one.intersect(near.rays(), near.hits(), near.n); });
    });
}

void Accel::occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
    if (impl_->walk) return impl_->walk->occluded(rays, hit, n);
    if (impl_->faces.size() == 0 && (!impl_->beside() || !impl_->rest.empty())) {
        impl_->occluded(rays, hit, n);
    } else {
        impl_->faces.occluded(rays, hit, n);
        if (!impl_->rest.empty())
            occluded_near(impl_->rest, rays, hit, n,
                          [&](NearRays &near) { impl_->occluded(near.rays(), near.occluded, near.n); });
    }
    impl_->for_beside([&](const auto &one) {
        occluded_near(one.bounds(), rays, hit, n,
                      [&](NearRays &near) { one.occluded(near.rays(), near.occluded, near.n); });
    });
}

void Accel::set_query_width(int width) {
    if (width != 0 && width != 1 && width != 4 && width != 8 && width != 16)
        throw std::invalid_argument("query width: expected 0, 1, 4, 8 or 16, got " + std::to_string(width));
    requested_width = width;
}

}  // namespace tr
