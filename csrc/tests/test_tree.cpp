// Trees of boxes: hits against a loop over all items, Embree, and closed meshes; building, refitting, and the kernels.
#include <algorithm>
#include <cstring>
#include <random>

#include "accel/embree_library.h"
#include "device/device_tree.h"
#include "device/emulated.h"
#include "harness.h"

namespace tr::testing {

namespace {

#if defined(NDEBUG)
constexpr int Many = 10;  // times as many rays as where sanitizers count every step
#else
constexpr int Many = 1;
#endif

struct Mesh {
    std::vector<float> positions;
    std::vector<uint32_t> faces;

    uint32_t add(float x, float y, float z) {
        positions.insert(positions.end(), {x, y, z});
        return uint32_t(positions.size() / 3 - 1);
    }
    void add_to(std::vector<TreeItem> &items, uint32_t shape) const {
        for (uint32_t f = 0; 3 * f < faces.size(); ++f)
            items.push_back(triangle_item(shape, f, &positions[3 * faces[3 * f]], &positions[3 * faces[3 * f + 1]],
                                          &positions[3 * faces[3 * f + 2]]));
    }
};

struct Rays {
    std::vector<float> column[7];
    std::vector<uint32_t> shape, primitive;
    std::vector<float> t, b1, b2;

    void add(const float *o, const float *d, float length = INFINITY) {
        for (int k = 0; k < 3; ++k) column[k].push_back(o[k]), column[3 + k].push_back(d[k]);
        column[6].push_back(length);
    }
    size_t size() const { return column[0].size(); }
    RayBatch batch() const {
        return {{column[0].data(), column[1].data(), column[2].data()},
                {column[3].data(), column[4].data(), column[5].data()},
                column[6].data()};
    }
    RayTable table() const {
        RayTable r;
        for (int k = 0; k < 7; ++k) r.column[k] = column[k].data();
        return r;
    }
    HitBatch hits() {
        for (auto *whole : {&shape, &primitive}) whole->resize(size());
        for (auto *real : {&t, &b1, &b2}) real->resize(size());
        return {shape.data(), primitive.data(), t.data(), b1.data(), b2.data()};
    }
};

bool same(const TreeHit &a, const TreeHit &b) { return !std::memcmp(&a, &b, sizeof a); }

// The closest hit, from a loop over all items from the last to the first.
TreeHit loop(const TreeView &tree, const Rays &rays, uint32_t i) {
    const float o[] = {rays.column[0][i], rays.column[1][i], rays.column[2][i]},
                d[] = {rays.column[3][i], rays.column[4][i], rays.column[5][i]};
    const TreeRay ray(tree, o, d, rays.column[6][i]);
    TreeHit best{TreeHit::Miss, 0, rays.column[6][i], 0, 0};
    if (!ray.valid()) return best;
    for (uint32_t k = tree.n_items; k-- > 0;) ray.hit(tree, tree.items[k], best);
    return best;
}

// Hits in the tree are those of the loop, bit for bit; returns how many there are.
size_t check_against_loop(const Tree &tree, const Rays &rays) {
    size_t hits = 0, wrong = 0;
    for (uint32_t i = 0; i < rays.size(); ++i) {
        const TreeHit expected = loop(tree.view(), rays, i), found = trace<false>(tree.view(), rays.table(), i);
        const bool occluded = trace<true>(tree.view(), rays.table(), i).shape != TreeHit::Miss;
        wrong += !same(expected, found) || occluded != (expected.shape != TreeHit::Miss);
        hits += expected.shape != TreeHit::Miss;
    }
    CHECK(wrong == 0);
    return hits;
}

class Random {
public:
    explicit Random(uint32_t seed) : generator_(seed) {}
    float operator()(float from = -1, float to = 1) {
        return std::uniform_real_distribution<float>(from, to)(generator_);
    }
    uint32_t below(size_t n) { return uint32_t(generator_() % n); }

private:
    std::mt19937 generator_;
};

// What meshes have that were not made with care: equal faces, slivers, points and lines for faces, a flat grid whose
// edges meet, numbers of very different sizes.
Mesh degenerate_mesh(Random &random, float largest = 2) {
    Mesh mesh;
    for (int i = 0; i < 60; ++i) mesh.add(random(), random(), random());
    for (int i = 0; i < 40; ++i) {
        const uint32_t a = random.below(60), b = random.below(60), c = random.below(60);
        mesh.faces.insert(mesh.faces.end(), {a, b, c});
        if (i % 4 == 0) mesh.faces.insert(mesh.faces.end(), {b, c, a, c, b, a});  // the same, turned and mirrored
        if (i % 5 == 0) mesh.faces.insert(mesh.faces.end(), {a, a, b, c, c, c});
    }
    for (int i = 0; i < 10; ++i) {
        const uint32_t a = mesh.add(random(), random(), random()), b = mesh.add(random(), random(), random());
        const float *p = &mesh.positions[3 * a], *q = &mesh.positions[3 * b];
        const uint32_t c = mesh.add((p[0] + q[0]) / 2, (p[1] + q[1]) / 2, std::nextafter((p[2] + q[2]) / 2, 9.f));
        mesh.faces.insert(mesh.faces.end(), {a, b, c});
    }
    const auto first = uint32_t(mesh.positions.size() / 3);
    for (int i = 0; i < 36; ++i) mesh.add(float(i % 6) / 5, float(i / 6) / 5, 0.25f);
    for (uint32_t i = first; i < first + 29; ++i)
        if ((i - first) % 6 != 5) mesh.faces.insert(mesh.faces.end(), {i, i + 1, i + 6, i + 1, i + 7, i + 6});
    for (float scale : {1e-20f, 1e-6f, largest}) {
        const uint32_t a = mesh.add(scale, 0, 0), b = mesh.add(0, scale, 0), c = mesh.add(0, 0, scale);
        mesh.faces.insert(mesh.faces.end(), {a, b, c});
    }
    return mesh;
}

// Anywhere; along axes; at corners, at the middles of edges, from them; of all lengths; and some that are none.
Rays difficult_rays(const Mesh &mesh, Random &random, size_t n) {
    Rays rays;
    const size_t n_vertices = mesh.positions.size() / 3;
    for (size_t i = 0; i < n; ++i) {
        float o[] = {random(-2, 2), random(-2, 2), random(-2, 2)}, d[] = {random(), random(), random()};
        const float *p = &mesh.positions[3 * random.below(n_vertices)],
                    *q = &mesh.positions[3 * random.below(n_vertices)];
        const float length = i % 3 == 0 ? random(0, 2) : INFINITY;
        for (size_t k = 0; k < 3; ++k) {
            if (i % 7 == 1)
                d[k] = k == i % 3 ? (d[k] > 0 ? 1.f : -1.f) : 0.f, o[(k + 1) % 3] = k == 0 ? 0.4f : o[(k + 1) % 3];
            if (i % 7 == 2) d[k] = p[k] - o[k];
            if (i % 7 == 3) d[k] = (p[k] + q[k]) / 2 - o[k];
            if (i % 7 == 4) o[k] = p[k];
            if (i % 7 == 5 && k == i % 3) d[k] *= 1e-30f;
            if (i % 7 == 6) d[k] *= 1e-12f, o[k] *= 100;
        }
        rays.add(o, d, length);
    }
    const float o[] = {0, 0, -3}, d[] = {0, 0, 1}, bad[] = {0, NAN, 1}, none[] = {0, 0, 0}, far[] = {0, INFINITY, 0};
    rays.add(bad, d), rays.add(far, d), rays.add(o, bad), rays.add(o, none), rays.add(o, far);
    rays.add(o, d, -1), rays.add(o, d, NAN), rays.add(o, d, 0);
    return rays;
}

// A closed surface: a ball of n rings of 2 n corners, whose radii vary.
Mesh closed_mesh(uint32_t n, Random &random, double roughness = 0.3) {
    Mesh mesh;
    const uint32_t south = mesh.add(0, 0, -1);
    for (uint32_t i = 1; i < n; ++i)
        for (uint32_t j = 0; j < 2 * n; ++j) {
            const double theta = Pi * i / n, phi = Pi * j / n, r = 1 + roughness * double(random());
            mesh.add(float(r * std::sin(theta) * std::cos(phi)), float(r * std::sin(theta) * std::sin(phi)),
                     float(-r * std::cos(theta)));
        }
    const uint32_t north = mesh.add(0, 0, 1);
    auto at = [&](uint32_t i, uint32_t j) { return 1 + (i - 1) * 2 * n + j % (2 * n); };
    for (uint32_t j = 0; j < 2 * n; ++j) {
        mesh.faces.insert(mesh.faces.end(), {south, at(1, j + 1), at(1, j), north, at(n - 1, j), at(n - 1, j + 1)});
        for (uint32_t i = 1; i + 1 < n; ++i)
            mesh.faces.insert(mesh.faces.end(),
                              {at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i + 1, j)});
    }
    return mesh;
}

// The cube [-1, 1]^3 with n x n squares on a side: the boxes of neighbours touch in their edges.
Mesh closed_cube(uint32_t n) {
    Mesh mesh;
    auto place = [&](uint32_t i) { return float(-1 + 2.0 * i / n); };
    for (size_t side = 0; side < 6; ++side) {
        const auto first = uint32_t(mesh.positions.size() / 3);
        for (uint32_t i = 0; i <= n; ++i)
            for (uint32_t j = 0; j <= n; ++j) {
                float p[3];
                p[side / 2] = side % 2 ? 1.f : -1.f, p[(side / 2 + 1) % 3] = place(i), p[(side / 2 + 2) % 3] = place(j);
                mesh.add(p[0], p[1], p[2]);
                const uint32_t a = first + i * (n + 1) + j, b = a + 1, c = a + n + 1, d = c + 1;
                if (i < n && j < n) mesh.faces.insert(mesh.faces.end(), {a, b, d, a, d, c});
            }
    }
    return mesh;
}

Tree tree_of(const Mesh &mesh, int threads = 2) {
    Tree tree;
    mesh.add_to(tree.items, 3);
    tree.build(threads);
    return tree;
}

// Spheres, disks and cylinders of all sizes among the faces of a mesh.
Tree mixed_tree(const Mesh &mesh, Random &random) {
    Tree tree;
    mesh.add_to(tree.items, 0);
    tree.matrices.resize(31);
    for (uint32_t shape = 1; shape <= 30; ++shape) {
        const double s = 0.05 + 0.3 * std::abs(double(random())), inverse = 1 / s,
                     c[] = {double(random()), double(random()), double(random())};
        const double to_world[] = {0, s, 0, c[0], 0, 0, s, c[1], s, 0, 0, c[2]};
        tree.matrices[shape] = {
            {0, 0, inverse, -c[2] * inverse, inverse, 0, 0, -c[0] * inverse, 0, inverse, 0, -c[1] * inverse}};
        tree.items.push_back(quadric_item(shape, TreeKind(1 + shape % 3), to_world));
    }
    tree.build(2);
    return tree;
}

}  // namespace

TR_TEST(tree_hits_are_those_of_a_loop) {
    for (uint32_t seed = 1; seed <= 4; ++seed) {
        Random random(seed);
        const Mesh mesh = degenerate_mesh(random, seed == 4 ? 1e18f : 2.f);
        const Rays rays = difficult_rays(mesh, random, size_t(1500 * Many));
        CHECK(check_against_loop(tree_of(mesh), rays) > rays.size() / 4);
        CHECK(check_against_loop(mixed_tree(mesh, random), rays) > rays.size() / 4);
    }
}

TR_TEST(trees_of_next_to_nothing) {
    Random random(5);
    Mesh mesh;
    Tree none;
    none.build(2);
    for (int i = 0; i < 9; ++i) mesh.add(random(), random(), random());
    const Rays rays = difficult_rays(mesh, random, 500);
    CHECK(check_against_loop(none, rays) == 0);
    for (uint32_t n = 1; n <= 3; ++n) {
        mesh.faces.insert(mesh.faces.end(), {3 * n - 3, 3 * n - 2, 3 * n - 1});
        CHECK(check_against_loop(tree_of(mesh), rays) > 0);
    }
}

// Corners and inner points of these triangles are where distances, weights and sides are known.
TR_TEST(tree_hits_have_weights_and_distances) {
    Random random(6);
    size_t hits = 0;
    for (int i = 0; i < 2000; ++i) {
        Mesh mesh;
        for (int k = 0; k < 3; ++k) mesh.add(random(), random(), random());
        mesh.faces = {0, 1, 2};
        const float *p = mesh.positions.data();
        const double b1 = double(random(0, 1)), b2 = double(random(0, 1));
        double n[3], point[3], area = 0;
        for (int k = 0; k < 3; ++k) {
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            n[k] =
                double(p[3 + l] - p[l]) * double(p[6 + m] - p[m]) - double(p[3 + m] - p[m]) * double(p[6 + l] - p[l]);
            point[k] = double(p[k]) * (1 - b1 - b2) + double(p[3 + k]) * b1 + double(p[6 + k]) * b2;
            area += n[k] * n[k];
        }
        area = std::sqrt(area);
        const double side = std::min(1 - b1 - b2, std::min(b1, b2));
        if (area < 0.1 || std::abs(side) < 1e-3) continue;
        // from above the point, a little slanted
        float o[3], d[3];
        for (int k = 0; k < 3; ++k) {
            d[k] = float(-n[k] / area) + random(-0.3f, 0.3f);
            o[k] = float(point[k] - 2.5 * double(d[k]));
        }
        Rays rays;
        rays.add(o, d);
        const TreeHit hit = trace<false>(tree_of(mesh).view(), rays.table(), 0);
        CHECK((hit.shape == 3) == (side > 0));
        if (side < 0) continue;
        ++hits;
        CHECK_NEAR(hit.t, 2.5, 1e-4);
        CHECK_NEAR(hit.b1, b1, 1e-4);
        CHECK_NEAR(hit.b2, b2, 1e-4);
    }
    CHECK(hits > 500);
}

// Products of an edge's coordinates that are one number in single precision: which side the ray passes it on is known.
TR_TEST(edges_have_the_right_side) {
    const float e = 1.f / 8192, o[] = {0, 0, -1}, d[] = {0, 0, 1};
    Rays rays;
    rays.add(o, d);
    for (const float side : {-1.f, 1.f}) {
        Mesh mesh;
        mesh.add(side, -side, 0), mesh.add(1, 1 - e, 0), mesh.add(-1 - e, -1, 0);
        mesh.faces = {0, 1, 2};
        CHECK((trace<false>(tree_of(mesh).view(), rays.table(), 0).shape == 3) == (side < 0));
    }
}

TR_TEST(tree_hits_are_those_of_embree) {
    load_embree(embree_path());
    Random random(7);
    const Mesh mesh = closed_mesh(40, random);
    const Tree tree = tree_of(mesh);
    Accel accel;
    accel.set_mesh(3, mesh.positions.data(), mesh.positions.size() / 3, mesh.faces.data(), mesh.faces.size() / 3);
    accel.commit();
    Rays rays;
    for (int i = 0; i < 20000 * Many; ++i) {
        const float o[] = {random(-1.5, 1.5), random(-1.5, 1.5), random(-1.5, 1.5)},
                    d[] = {random(), random(), random()};
        rays.add(o, d, i % 3 ? INFINITY : random(0, 2));
    }
    accel.intersect(rays.batch(), rays.hits(), rays.size(), false);
    size_t hits = 0, other = 0;
    for (uint32_t i = 0; i < rays.size(); ++i) {
        const TreeHit found = trace<false>(tree.view(), rays.table(), i);
        hits += found.shape == 3;
        // beside an edge rounding decides, and where it is the silhouette, whether anything is hit
        if (found.shape != rays.shape[i] || (found.shape == 3 && found.primitive != rays.primitive[i])) {
            ++other;
            continue;
        }
        if (found.shape != 3) continue;
        CHECK_NEAR(found.t, rays.t[i], 1e-4 * (1 + double(found.t)));
        CHECK_NEAR(found.b1, rays.b1[i], 1e-2);
    }
    CHECK(hits > rays.size() / 4);
    CHECK(other < rays.size() / 20000);
}

TR_TEST(closed_meshes_do_not_leak) {
    enum Shape { Ball, Cube, Rod };
    for (const Shape kind : {Ball, Cube, Rod}) {
        Random random(8);
        Mesh mesh = kind == Ball ? closed_mesh(24, random) : closed_cube(kind == Cube ? 13 : 1);
        const float shift = kind == Ball ? 100.f : 0.7f;
        for (size_t i = 0; i < mesh.positions.size(); ++i) {
            float &x = mesh.positions[i];
            if (kind == Rod && i % 3 == 2) x *= 1e4f;  // corners are far, edges near
            x += shift;
        }
        const Tree tree = tree_of(mesh);
        const size_t n = size_t(60000 * Many), n_vertices = mesh.positions.size() / 3;
        size_t leaks = 0;
        Rays rays;
        for (size_t i = 0; i < n; ++i) {
            float o[3], d[3];
            const uint32_t *face = &mesh.faces[3 * random.below(mesh.faces.size() / 3)];
            const float *p = &mesh.positions[3 * (i % n_vertices)], *a = &mesh.positions[3 * face[0]],
                        *b = &mesh.positions[3 * face[1]];
            const float w = kind == Rod ? 0.5f + 1e-4f * random() : random(0, 1);
            for (int k = 0; k < 3; ++k) {
                o[k] = shift + random(-0.2f, 0.2f);
                if (i % 5 == 0) o[k] = shift;
                d[k] = i % 4 == 0   ? p[k] - o[k]                       // at corners
                       : i % 4 == 1 ? a[k] + w * (b[k] - a[k]) - o[k]   // at edges
                       : i % 4 == 2 ? random()                          // anywhere
                                    : float(int(random.below(3)) - 1);  // along axes and diagonals
            }
            if (d[0] == 0 && d[1] == 0 && d[2] == 0) d[0] = 1;
            rays.add(o, d);
        }
        for (uint32_t i = 0; i < n; ++i) leaks += trace<false>(tree.view(), rays.table(), i).shape == TreeHit::Miss;
        CHECK(leaks == 0);
    }
}

TR_TEST(refitted_trees_have_the_hits_of_new_ones) {
    Random random(9);
    Mesh mesh = closed_mesh(20, random);
    Tree tree = tree_of(mesh);
    for (float by : {0.01f, 0.03f, 0.8f}) {
        for (float &x : mesh.positions) x += by * random();
        std::vector<TreeItem> moved;
        mesh.add_to(moved, 3);
        for (TreeItem &item : tree.items) item = moved[item.primitive];
        const bool good = tree.refit();
        CHECK(good == (by < 0.5f));
        const Tree fresh = tree_of(mesh);
        CHECK(tree.cost >= fresh.cost * 0.9);
        for (int k = 0; k < 3; ++k) CHECK(tree.lower[k] == fresh.lower[k] && tree.upper[k] == fresh.upper[k]);
        const Rays rays = difficult_rays(mesh, random, 3000);
        for (uint32_t i = 0; i < rays.size(); ++i)
            CHECK(same(trace<false>(tree.view(), rays.table(), i), trace<false>(fresh.view(), rays.table(), i)));
    }
}

TR_TEST(trees_do_not_depend_on_threads) {
    Random random(10);
    const Mesh mesh = closed_mesh(90, random, 0.01);  // 32040 faces
    const Tree one = tree_of(mesh, 1), four = tree_of(mesh, 4);
    CHECK(one.nodes.size() == four.nodes.size() && one.nodes.size() > 5000);
    CHECK(!std::memcmp(one.nodes.data(), four.nodes.data(), one.nodes.size() * sizeof(TreeNode)));
    CHECK(!std::memcmp(one.items.data(), four.items.data(), one.items.size() * sizeof(TreeItem)));
    // a ray meets few of them
    CHECK(one.cost < 60);
}

// Each of these is far smaller than all before it together, so that the heuristic splits one off at a time.
TR_TEST(trees_of_bad_meshes_are_shallow) {
    Random random(11);
    Mesh mesh;
    float scale = 1;
    for (uint32_t i = 0; i < 3000; ++i) {
        for (int k = 0; k < 3; ++k) mesh.add(scale * random(0.5f, 1), scale * random(0.5f, 1), scale * random(0.5f, 1));
        mesh.faces.insert(mesh.faces.end(), {3 * i, 3 * i + 1, 3 * i + 2});
        scale = i % 100 == 99 ? 1 : scale * 0.4f;
        if (i % 3 == 0) mesh.faces.insert(mesh.faces.end(), {0, 1, 2});  // and a thousand times the same one
    }
    const Tree tree = tree_of(mesh);
    std::vector<int> depth(tree.nodes.size(), 1);
    int deepest = 0;
    for (size_t i = 0; i < tree.nodes.size(); ++i)
        for (int k = 0; k < 2; ++k)
            if (tree.nodes[i].count[k] == 0) deepest = std::max(deepest, depth[tree.nodes[i].child[k]] = depth[i] + 1);
    CHECK(deepest > 25 && deepest < TreeDepth);
    check_against_loop(tree, difficult_rays(mesh, random, 300));
}

TR_TEST(kernels_find_what_the_host_finds) {
    Random random(12);
    const Mesh mesh = degenerate_mesh(random);
    const Rays rays = difficult_rays(mesh, random, 1200);
    const Tree trees[] = {mixed_tree(mesh, random), tree_of(closed_mesh(9, random)), Tree{}};
    for (bool strict : {false, true})
        for (bool late : {false, true}) {
            const auto launcher = make_emulated({strict, late, 2});
            DeviceTree device(*launcher, 500);
            for (const Tree &tree : trees) {  // another one in the place of the last
                device.set(tree);
                Rays found = rays;
                std::vector<uint8_t> occluded(rays.size());
                device.intersect(rays.batch(), found.hits(), rays.size());
                device.occluded(rays.batch(), occluded.data(), rays.size());
                for (uint32_t i = 0; i < rays.size(); ++i) {
                    const TreeHit hit{found.shape[i], found.primitive[i], found.t[i], found.b1[i], found.b2[i]};
                    CHECK(same(hit, trace<false>(tree.view(), rays.table(), i)));
                    CHECK(occluded[i] == (hit.shape != TreeHit::Miss));
                }
            }
        }
}

}  // namespace tr::testing
