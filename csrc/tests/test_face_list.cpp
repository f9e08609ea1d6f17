// Few faces tested without a tree, beside Embree's answers about the same scene.
#include <random>

#include "accel/accel.h"
#include "accel/embree_library.h"
#include "core/math/rows.h"
#include "harness.h"

namespace tr::testing {

namespace {

struct TestMesh {
    std::vector<float> positions;
    std::vector<uint32_t> faces;
};

// Six parallelograms; the two triangles of each begin at any of their corners.
TestMesh skewed_box(std::mt19937 &generator, float size, float x, float y, float z) {
    std::uniform_real_distribution<float> uniform(-1, 1);
    float origin[3] = {x, y, z}, edge[3][3];
    for (int a = 0; a < 3; ++a)
        for (int k = 0; k < 3; ++k) edge[a][k] = size * ((a == k ? 1.f : 0.f) + 0.2f * uniform(generator));
    TestMesh mesh;
    for (int axis = 0; axis < 3; ++axis)
        for (int side = 0; side < 2; ++side) {
            const float *u = edge[(axis + 1) % 3], *v = edge[(axis + 2) % 3];
            auto first = uint32_t(mesh.positions.size() / 3);
            for (int corner = 0; corner < 4; ++corner)
                for (int k = 0; k < 3; ++k)
                    mesh.positions.push_back(origin[k] + (side ? edge[axis][k] : 0.f) +
                                             (corner == 1 || corner == 2 ? u[k] : 0.f) + (corner >= 2 ? v[k] : 0.f));
            const uint32_t halves[2][3] = {{0, 1, 2}, {0, 2, 3}};
            for (const auto &half : halves) {
                uint32_t turn = generator() % 3;
                for (uint32_t k = 0; k < 3; ++k) mesh.faces.push_back(first + half[(k + turn) % 3]);
            }
        }
    return mesh;
}

TestMesh wavy_sheet(std::mt19937 &generator, uint32_t side, float z) {
    std::uniform_real_distribution<float> uniform(-0.1f, 0.1f);
    TestMesh mesh;
    for (uint32_t i = 0; i < side * side; ++i)
        for (float x : {float(i % side) * 2 / float(side - 1) - 1, float(i / side) * 2 / float(side - 1) - 1,
                        z + uniform(generator)})
            mesh.positions.push_back(x);
    for (uint32_t i = 0; i + side < side * side; ++i)
        if (i % side + 1 < side)
            mesh.faces.insert(mesh.faces.end(), {i, i + 1, i + side, i + 1, i + side + 1, i + side});
    return mesh;
}

struct Answers {
    std::vector<uint32_t> shape, primitive;
    std::vector<float> t, b1, b2;
    std::vector<uint8_t> occluded;
};

Answers ask(const std::vector<TestMesh> &meshes, const RayBatch &rays, size_t n, int width, float (&box)[6]) {
    Accel::set_query_width(width);
    Accel accel;
    for (size_t m = 0; m < meshes.size(); ++m)
        accel.set_mesh(uint32_t(m), meshes[m].positions.data(), meshes[m].positions.size() / 3, meshes[m].faces.data(),
                       meshes[m].faces.size() / 3);
    accel.commit();
    Accel::set_query_width(0);
    accel.bounds(box);
    Answers a;
    a.shape.resize(n), a.primitive.resize(n), a.t.resize(n), a.b1.resize(n), a.b2.resize(n), a.occluded.resize(n);
    accel.intersect(rays, {a.shape.data(), a.primitive.data(), a.t.data(), a.b1.data(), a.b2.data()}, n, false);
    accel.occluded(rays, a.occluded.data(), n);
    return a;
}

// Rays that pass edges are decided by rounding: at most this part of them may differ.
void compare(const std::vector<TestMesh> &meshes, size_t at_least) {
    load_embree(embree_path());
    std::mt19937 generator(5);
    std::uniform_real_distribution<float> uniform(-1, 1);
    const size_t n = 20011;
    std::vector<float> columns[7];
    for (size_t i = 0; i < n; ++i) {
        for (int k = 0; k < 6; ++k) columns[k].push_back(uniform(generator) * (k < 3 ? 2.f : 1.f));
        columns[6].push_back(i % 3 ? INFINITY : 1.f);
        if (i % 5 == 0) columns[3 + i % 3][i] = 0;  // along a plane of coordinates
    }
    RayBatch rays{{columns[0].data(), columns[1].data(), columns[2].data()},
                  {columns[3].data(), columns[4].data(), columns[5].data()},
                  columns[6].data()};
    float box[2][6];
    Answers ours = ask(meshes, rays, n, 0, box[0]), embree = ask(meshes, rays, n, 4, box[1]);
    for (int k = 0; k < 6; ++k) CHECK_NEAR(box[0][k], box[1][k], 1e-6);
    size_t different = 0, hits = 0, shadows = 0;
    for (size_t i = 0; i < n; ++i) {
        bool same = ours.shape[i] == embree.shape[i] && ours.primitive[i] == embree.primitive[i];
        different += !same || ours.occluded[i] != embree.occluded[i];
        shadows += ours.occluded[i];
        if (!same) continue;
        if (ours.shape[i] == Accel::Miss) {
            CHECK(ours.t[i] == columns[6][i]);
            continue;
        }
        ++hits;
        CHECK_NEAR(ours.t[i], embree.t[i], 1e-4 * (1 + embree.t[i]));
        CHECK_NEAR(ours.b1[i], embree.b1[i], 1e-3);
        CHECK_NEAR(ours.b2[i], embree.b2[i], 1e-3);
        CHECK(ours.b1[i] >= 0 && ours.b2[i] >= 0 && ours.b1[i] + ours.b2[i] <= 1.00001f);
    }
    CHECK(different <= n / 2000);
    CHECK(hits >= at_least && shadows >= at_least);
}

}  // namespace

TR_TEST(a_tiny_scene_answers_like_embree) {
    std::mt19937 generator(3);
    std::vector<TestMesh> meshes;
    for (int i = 0; i < 2; ++i) meshes.push_back(skewed_box(generator, 0.6f, float(i) - 1, 0.3f, -0.5f));
    meshes.push_back({{-2, -1, -2, 2, -1, -2, 0, -1.5f, 2}, {0, 1, 2}});                      // a triangle
    meshes.push_back({{0, 0, 0, 1, 1, 1, 2, 2, 2, NAN, 0, 0, 0, 1, 0, 1, 0, 0}, {0, 1, 2}});  // no area
    compare(meshes, 2000);
}

// Few enough for packets of any width.
TR_TEST(a_box_answers_like_embree) {
    std::mt19937 generator(8);
    compare({skewed_box(generator, 1.f, -0.5f, -0.5f, -0.5f)}, 500);
}

TR_TEST(large_faces_beside_a_mesh_answer_like_embree) {
    std::mt19937 generator(4);
    std::vector<TestMesh> meshes;
    meshes.push_back(wavy_sheet(generator, 20, 0.5f));
    for (int i = 0; i < 4; ++i) meshes.push_back(skewed_box(generator, 0.1f, 0.2f * float(i), 0, 0));
    meshes.push_back({{-3, -1, -3, 3, -1, -3, 3, -1, 3, -3, -1, 3}, {0, 1, 2, 0, 2, 3}});  // floor
    compare(meshes, 4000);
}

TR_TEST(what_a_ray_begins_on_is_not_hit) {
    load_embree(embree_path());
    std::vector<TestMesh> wall{{{-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0}, {0, 1, 2, 0, 2, 3}}};
    const float x[] = {0.1f, 0.1f, 0.1f, 0.1f, 0.1f, -3}, y[] = {0.2f, 0.2f, 0.2f, 0.2f, 0.2f, 0.2f}, z[6] = {};
    const float dx[] = {0, 0, 1, 1, 1, 1}, dy[6] = {}, dz[] = {1, -1, 0, 1e-39f, 1e-30f, 0};
    const float tmax[] = {INFINITY, 5, INFINITY, INFINITY, INFINITY, INFINITY};
    for (int width : {0, 4}) {
        float box[6];
        Answers a = ask(wall, {{x, y, z}, {dx, dy, dz}, tmax}, 6, width, box);
        for (size_t i = 0; i < 6; ++i) CHECK(a.shape[i] == Accel::Miss && a.t[i] == tmax[i] && a.occluded[i] == 0);
    }
}

// The fourth corner of a face of 128 units in the last place is off by 7 of them.
TR_TEST(what_rounding_makes_of_a_small_face_is_its_shape) {
    load_embree(embree_path());
    const float unit = 1.f / 16384, at = 1000, side = at + 128 * unit;
    std::vector<TestMesh> face{{{at, at, 0, side, at, 0, side + 7 * unit, side, 0, at, side, 0}, {0, 1, 2, 0, 2, 3}}};
    const float x[] = {side + 3 * unit, side + 9 * unit}, y[] = {side - 8 * unit, side - 8 * unit}, z[] = {1, 1};
    const float dx[2] = {}, dz[] = {-1, -1}, tmax[] = {9, 9};
    for (int width : {0, 4}) {
        float box[6];
        Answers a = ask(face, {{x, y, z}, {dx, dx, dz}, tmax}, 2, width, box);
        CHECK(a.shape[0] == 0 && a.occluded[0] == 1);
        CHECK(a.shape[1] == Accel::Miss && a.occluded[1] == 0);
    }
}

TR_TEST(listed_meshes_move) {
    load_embree(embree_path());
    std::mt19937 generator(6);
    TestMesh sheet = wavy_sheet(generator, 20, 9);
    float wall[] = {-9, -9, 0, 9, -9, 0, 9, 9, 0, -9, 9, 0};
    const uint32_t faces[] = {0, 1, 2, 0, 2, 3};
    Accel accel;
    accel.set_mesh(0, sheet.positions.data(), 400, sheet.faces.data(), sheet.faces.size() / 3);
    accel.set_mesh(1, wall, 4, faces, 2);
    accel.commit();
    for (float z : {0.f, 2.f, 5.f}) {
        for (int i = 2; i < 12; i += 3) wall[i] = z;
        accel.set_mesh(1, wall, 4, nullptr, 2);
        accel.commit();
        float x = 0.3f, start = -1, zero = 0, one = 1, far = INFINITY, t, b1, b2;
        uint32_t shape, primitive;
        accel.intersect({{&x, &zero, &start}, {&zero, &zero, &one}, &far}, {&shape, &primitive, &t, &b1, &b2}, 1, true);
        CHECK(shape == 1);
        CHECK_NEAR(t, 1 + z, 1e-5);
    }
}

#if TR_HAS_PACKETS
// Of every number of columns, at the end of a table behind which nothing may be read, with idle lanes.
template <int N>
static void check_rows() {
    using F = FloatPacket;
    constexpr uint32_t W = uint32_t(Lanes<F>::Width), rows = 5;
    std::vector<float> table(rows * N);
    for (size_t i = 0; i < table.size(); ++i) table[i] = float(i) + 0.5f;
    for (uint32_t lanes = 1; lanes <= W; ++lanes) {
        auto active = mask<F>(lane_index<F>() < UIntOf<F>(lanes));
        UIntOf<F> row = lane_index<F>() * 7u, index = (row - row / rows * rows) * uint32_t(N);
        F some[N], few[N], same[N];
        gather_rows<F>(table.data(), select(mask<UIntOf<F>>(active), index, UIntOf<F>(1000000000u)), active, some);
        gather_few_rows<F>(table.data(), index, active, few);
        gather_few_rows<F>(table.data(), UIntOf<F>((rows - 1) * N), active, same);
        for (uint32_t i = 0; i < lanes; ++i)
            for (int k = 0; k < N; ++k) {
                float expected = table[lane(index, int(i)) + uint32_t(k)];
                CHECK(lane(some[k], int(i)) == expected && lane(few[k], int(i)) == expected);
                CHECK(lane(same[k], int(i)) == table[(rows - 1) * N + uint32_t(k)]);
            }
    }
}

TR_TEST(rows_of_tables_are_what_single_numbers_are) {
    check_rows<1>();
    check_rows<2>();
    check_rows<3>();
    check_rows<4>();
}

TR_TEST(near_entries_are_picked) {
    using F = FloatPacket;
    constexpr uint32_t W = uint32_t(Lanes<F>::Width);
    std::vector<float> column(2 * W);
    for (uint32_t i = 0; i < 2 * W; ++i) column[i] = float(i);
    UIntOf<F> offset = lane_index<F>() * 2u + (lane_index<F>() & 1u);
    F picked = pick<F>(column.data(), offset);
    for (uint32_t i = 0; i < W; ++i) CHECK(lane(picked, int(i)) == float(2 * i + (i & 1)));
}
#endif

}  // namespace tr::testing
