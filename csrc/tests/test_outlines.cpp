// Outlines: which edges there are, how often the tree chooses each, and where cameras see points.
#include <algorithm>
#include <array>
#include <random>

#include "accel/embree_library.h"
#include "core/boundary/outline_choice.h"
#include "core/boundary/outline_rims.h"
#include "core/sensor/camera.h"
#include "cpu/outline_pieces.h"
#include "host/morton_order.h"
#include "host/outline_set.h"
#include "scene_builder.h"

namespace tr::testing {

namespace {

template <class S>
void add_mesh(SceneBuilder<S> &b, std::vector<S> vertices, std::vector<int32_t> faces, std::vector<S> normals) {
    const int64_t n = int64_t(vertices.size() / 3);
    b.indices.push_back(std::move(faces));
    Fields fields = {{"vertices", b.param({n, 3}, std::move(vertices))},
                     {"faces", int64_t(b.indices.size()) - 1},
                     {"bsdf", b.diffuse(1, 1, 1)}};
    if (!normals.empty()) fields.emplace_back("normals", b.param({n, 3}, std::move(normals)));
    b.add("shape", "mesh", fields);
}

// A cube of 8 vertices, or of 24 with those of each side apart; its faces are wound outwards.
template <class S>
void add_cube(SceneBuilder<S> &b, bool apart) {
    const int32_t sides[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
    std::vector<S> vertices;
    std::vector<int32_t> faces;
    auto corner = [&](int32_t i) {
        for (int k = 0; k < 3; ++k) vertices.push_back(S(i >> k & 1));
    };
    if (!apart)
        for (int32_t i = 0; i < 8; ++i) corner(i);
    for (const auto &side : sides) {
        const int32_t first = int32_t(vertices.size() / 3);
        for (int32_t i = 0; i < 4 && apart; ++i) corner(side[i]);
        for (int i : {0, 1, 2, 0, 2, 3}) faces.push_back(apart ? first + i : side[i]);
    }
    add_mesh(b, std::move(vertices), std::move(faces), {});
}

// A waved field of n x n vertices, above the square from 0 to 1, with its faces row by row or anyhow.
template <class S>
void add_waves(SceneBuilder<S> &b, int32_t n, bool in_order) {
    std::vector<S> vertices;
    std::vector<std::array<int32_t, 3>> found;
    for (int32_t i = 0; i < n * n; ++i) {
        const S x = S(i % n) / S(n - 1), y = S(i / n) / S(n - 1);
        for (S c : {x, y, S(0.05) * std::sin(20 * x) * std::cos(17 * y)}) vertices.push_back(c);
        if (i % n == n - 1 || i / n == n - 1) continue;
        found.push_back({i, i + 1, i + n}), found.push_back({i + 1, i + n + 1, i + n});
    }
    std::mt19937 random(13);
    if (!in_order) std::shuffle(found.begin(), found.end(), random);
    std::vector<int32_t> faces;
    for (const auto &face : found) faces.insert(faces.end(), face.begin(), face.end());
    std::vector<S> normals(vertices.size());  // rounded ones: edges are no creases
    for (size_t i = 2; i < normals.size(); i += 3) normals[i] = 1;
    add_mesh(b, std::move(vertices), std::move(faces), std::move(normals));
}

}  // namespace

TR_TEST(edges_of_a_cube) {
    load_embree(embree_path());
    for (bool apart : {false, true}) {
        SceneBuilder<float> b(3);
        add_cube(b, apart);
        b.camera(0, 0, -5, 50);
        SceneData<float> scene;
        b.build(scene);
        OutlineSet set;
        const uint8_t moves[1] = {1};
        CHECK(!set.update(scene.view(), moves, scene.geometry_version(), 2, [] { return true; }));
        CHECK(set.update(scene.view(), moves, scene.geometry_version(), 2, [] { return false; }));
        CHECK(set.n_edges() == 18 && set.size() == 18);
        int sharp = 0, split = 0;
        for (size_t i = 0; i < set.size(); ++i) {
            const OutlineElement e = set.element(scene.view(), i);
            CHECK(e.index == int32_t(i) && e.moves == (e.weight > 0) && set.table().count(i) == 2);
            sharp += e.bend > 0.5f, split += set.table().is_split(size_t(e.index));
            CHECK((e.weight > 0) == (e.bend > 0.5f));  // not the diagonals of its sides
            const Vec3<float> middle = (e.a + e.b) * 0.5f - Vec3<float>{0.5f, 0.5f, 0.5f};
            if (e.bend > 0.5f) CHECK(dot(e.n0, middle) > 0 && dot(e.n1, middle) > 0);
        }
        CHECK(sharp == 12 && split == (apart ? 12 : 0));
        // of a cube seen from the middle of a side, and from where three are seen
        for (auto [x, least] : {std::pair(0.5f, size_t(4)), std::pair(-1.f, size_t(6))}) {
            size_t n = 0;
            const Vec3<float> from{x, x, -1};
            for (size_t leaf = 0; leaf < set.tree().n_leaves(); ++leaf)
                set.tree().if_outlines(leaf, from, false, 0, false, [&](const auto &elements, const auto &) {
                    for (size_t k = 0; k < OutlineTree::Wide; ++k) {
                        const OutlineElement e = element_of(elements, k);
                        n += e.weight > 0 && (dot(e.n0, e.a - from) > 0) != (dot(e.n1, e.a - from) > 0);
                    }
                });
            CHECK(n == least);
        }
        if (!apart) continue;
        for (int k = 0; k < 12; ++k) b.values[0][size_t(k)] -= 1;  // one of its sides goes away
        scene.update(b.addresses(), std::vector<uint8_t>(b.values.size(), 1));
        CHECK(set.update(scene.view(), moves, scene.geometry_version(), 2, nullptr));
        CHECK(set.n_edges() == 22);
    }
}

// Many edges are rounded, and share leaves as they follow each other, or by their places if that puts far ones
// together.
TR_TEST(edges_of_a_large_mesh_in_any_order) {
    load_embree(embree_path());
    constexpr int32_t n = 160;
    size_t seen[2];
    for (bool in_order : {false, true}) {
        SceneBuilder<float> b(3);
        add_waves(b, n, in_order);
        b.camera(0, 0, -5, 50);
        SceneData<float> scene;
        b.build(scene);
        OutlineSet set;
        const uint8_t moves[1] = {1};
        CHECK(set.update(scene.view(), moves, scene.geometry_version(), 2, nullptr));
        CHECK(set.n_edges() == size_t(2 * n * (n - 1) + (n - 1) * (n - 1)));
        const OutlineTree &tree = set.tree();
        std::vector<int> times(set.n_edges());
        std::vector<bool> offered(set.n_edges());
        const Vec3<float> from{0.3f, -2, 0.2f};
        for (size_t leaf = 0; leaf < tree.n_leaves(); ++leaf) {
            for (size_t k = 0; k < OutlineTree::Wide; ++k)
                if (tree.index(leaf, k) >= 0) ++times[size_t(tree.index(leaf, k))];
            tree.if_outlines(leaf, from, false, 0, false, [&](const auto &, const auto &) {
                for (size_t k = 0; k < OutlineTree::Wide; ++k)
                    if (tree.index(leaf, k) >= 0) offered[size_t(tree.index(leaf, k))] = true;
            });
        }
        CHECK(std::all_of(times.begin(), times.end(), [](int x) { return x == 1; }));
        size_t &outlines = seen[in_order];
        outlines = 0;
        for (size_t i = 0; i < set.n_edges(); ++i) {
            const OutlineElement e = set.element(scene.view(), i);
            CHECK((e.kind == OutlineElement::Always) == (set.table().count(i) == 1));
            const float s0 = dot(e.n0, e.a - from), s1 = dot(e.n1, e.a - from);
            if (set.table().count(i) != 1 && (s0 > 0) == (s1 > 0)) continue;
            ++outlines;
            CHECK(offered[i]);
        }
        // leaves are small whatever the order is: from above few may have outlines, those at the border
        size_t from_above = 0;
        for (size_t leaf = 0; leaf < tree.n_leaves(); ++leaf)
            tree.if_outlines(leaf, {0.5f, 0.5f, 1}, false, 0, false, [&](const auto &, const auto &) { ++from_above; });
        CHECK(from_above > 0 && from_above < tree.n_leaves() / 4);
    }
    CHECK(seen[0] == seen[1] && seen[0] > 4 * size_t(n - 1));
}

// Of numbers spread evenly the sum of one over the density, by element, is the length of its parameter's interval.
TR_TEST(pieces_are_chosen_with_their_density) {
    constexpr size_t n = 40, rounds = 100000;
    OutlineTree tree;
    tree.resize(n, 0);
    std::vector<OutlineElement> all(n);
    for (size_t i = 0; i < n; ++i) all[i].weight = 1, all[i].index = int32_t(i);
    for (size_t leaf = 0; leaf < tree.n_leaves(); ++leaf) {
        const size_t begin = OutlineTree::Wide * leaf;
        tree.set(leaf, &all[begin], std::min(OutlineTree::Wide, n - begin));
    }
    OutlinePieces pieces;
    std::vector<double> expected(n);
    auto append = [&](const OutlinePiece &piece, double length) {
        pieces.all.push_back(piece), pieces.cdf.push_back(pieces.total() + length);
    };
    append({7, 0.25f, 0.5f}, 0.3), append({7, 0.75f, 1}, 0.1), expected[7] = 0.5;
    float lengths[OutlineTree::Wide] = {0, 2, 1e-9f, 0.5f, 0, 0, 0, 3};
    pieces.leaves.push_back(leaf_piece(1, lengths));
    append({-1, 0, 1}, 2), append({3, 0, 1}, 0.2), expected[3] = 1;
    float last[OutlineTree::Wide] = {0, 0, 0, 0, 0, 0, 0, 1};
    pieces.leaves.push_back(leaf_piece(2, last));
    append({-2, 0, 1}, 0.4);
    for (size_t i : {17, 18, 19, 23, 39}) expected[i] = 1;
    std::vector<double> sum(n), places(n);
    for (size_t k = 0; k < rounds; ++k) {
        const OutlinePlace at = pieces.view().choose((double(k) + 0.5) / rounds, tree.view());
        CHECK(at.element >= 0 && size_t(at.element) < n && at.s >= 0 && at.s < 1 && at.inverse_density > 0);
        sum[size_t(at.element)] += at.inverse_density / rounds;
        places[size_t(at.element)] += at.s * at.inverse_density / rounds;
    }
    for (size_t i = 0; i < n; ++i) {
        CHECK_NEAR(sum[i], expected[i], 5e-3);  // the least one has a share of 1 / 1500 of the numbers
        const double middle = i == 7 ? (0.375 + 0.875) / 2 : 0.5;
        CHECK_NEAR(places[i], middle * expected[i], 5e-3);
    }
    CHECK(pieces.view().choose(0, tree.view()).element == 7);
    CHECK(pieces.view().choose(1 - 0x1p-53, tree.view()).element == 39);
}

// The sum over choices of one over the density of an element is the length of its parameter's interval, which is 1.
TR_TEST(the_tree_chooses_with_its_density) {
    constexpr size_t n = 300;
    constexpr int rounds = 100000;
    std::mt19937 random(3);
    std::uniform_real_distribution<float> u(-1, 1);
    auto vector = [&] { return Vec3<float>{u(random), u(random), u(random)}; };
    for (int trial = 0; trial < 4; ++trial) {
        const bool parallel = trial & 1, rounded = trial & 2;
        OutlineAnchor from{};
        from.p = {0, 0, parallel ? 1.f : 1.5f}, from.n = from.axis = {0, 0, 1};
        from.ng = {0.2f, 0, 0.98f};  // everything is above its horizon, too
        from.still = 0.3f, from.k = 20, from.share = parallel ? 0.f : 0.5f, from.parallel = parallel, from.own = -1;
        std::vector<OutlineElement> all(n);
        for (size_t i = 0; i < n; ++i) {
            OutlineElement &e = all[i];
            e.a = vector() + Vec3<float>{0, 0, 3}, e.b = e.a + vector() * 0.2f;
            e.n0 = e.n1 = {0, 0, 0};
            e.weight = 0.5f + 0.25f * (u(random) + 1), e.bend = 1;
            e.kind = i % 10 == 0 ? OutlineElement::Round : OutlineElement::Always;
            if (i % 10 == 0) e.b = {0.1f, 0, 0};
            e.shape = int32_t(i), e.index = int32_t(i), e.moves = i % 3 != 0;
            if (!rounded) continue;
            // no curves, but edges between faces that just hide each other
            e.kind = i % 10 == 1 ? OutlineElement::Crease : OutlineElement::Edge;
            if (i % 10 == 0) e.b = e.a + vector() * 0.2f;
            const Vec3<float> towards = parallel ? from.p : e.a - from.p;
            while (norm(cross(normalize(e.b - e.a), normalize(towards))) < 0.2f)  // seen end-on
                e.b = e.a + vector() * 0.2f;
            const Vec3<float> side = normalize(cross(e.b - e.a, towards));
            const Vec3<float> across = normalize(cross(side, e.b - e.a));
            e.n0 = normalize(side + across * 4e-6f), e.n1 = normalize(side - across * 4e-6f), e.bend = 1e-8f;
        }
        OutlineTree tree;
        tree.resize(rounded ? 0 : n, rounded ? n : 0);
        for (size_t leaf = 0; leaf < tree.n_leaves(); ++leaf) {
            const size_t begin = OutlineTree::Wide * leaf;
            tree.set(leaf, &all[begin], std::min(OutlineTree::Wide, n - begin));
        }
        tree.build(2);
        std::vector<double> sum(n), squares(n);
        constexpr int at_once = 4;
        for (int r = 0; r < rounds; r += at_once) {
            OutlineChoice choices[at_once];
            choose_outlines(tree.view(), from, uint64_t(r) * 0xD1342543DE82EF95ull + uint64_t(parallel),
                            parallel ? 2 : 8, choices, at_once);
            for (const OutlineChoice &c : choices) {
                CHECK(c.element >= 0 && c.s >= 0 && c.s < 1);
                sum[size_t(c.element)] += c.inverse_density,
                    squares[size_t(c.element)] += double(c.inverse_density) * c.inverse_density;
            }
        }
        double all_of_them = 0;
        for (size_t i = 0; i < n; ++i) {
            const double mean = sum[i] / rounds, deviation = std::sqrt((squares[i] / rounds - mean * mean) / rounds);
            CHECK_NEAR(mean, 1.0, 5.5 * deviation);  // of 1200 one is beyond with a probability of 5e-5
            all_of_them += mean;
        }
        CHECK_NEAR(all_of_them / double(n), 1.0, 0.02);
    }
}

TR_TEST(a_camera_sees_points_of_a_ray_where_it_begins) {
    load_embree(embree_path());
    using S = double;
    SceneBuilder<S> b(3);
    add_cube(b, false);
    const int64_t turned = b.param({4, 4}, {0.6, 0, 0.8, 1, 0, 1, 0, 2, -0.8, 0, 0.6, 3, 0, 0, 0, 1});
    const Fields common = {{"to_world", turned}, {"near_clip", b.number(0.1)}, {"far_clip", b.number(100)}};
    Fields film = common;
    film.insert(film.end(), {{"x_fov", b.number(70)},
                             {"principal_point_offset_x", b.number(0.1)},
                             {"principal_point_offset_y", b.number(-0.05)},
                             {"pixel_aspect", b.number(1.2)}});
    auto with = [](Fields fields, const Fields &more) {
        fields.insert(fields.end(), more.begin(), more.end());
        return fields;
    };
    b.add("sensor", "perspective", film);
    b.add("sensor", "perspective", with(film, {{"distortion", b.param({8}, {-0.1, 0.02, 0.01, -0.01, 0, 0, 0, 0})}}));
    b.add("sensor", "thinlens", with(film, {{"aperture_radius", b.number(0.2)}, {"focus_distance", b.number(4)}}));
    b.add("sensor", "orthographic", common);
    b.add("sensor", "fisheye",
          with(film, {{"distortion", b.param({4}, {0.01, -0.002, 0, 0})}, {"max_angle", b.number(120)}}));
    b.add("sensor", "panorama", common);
    SceneData<S> scene;
    b.build(scene);
    const S width = 40, height = 30;
    std::mt19937 random(5);
    std::uniform_real_distribution<S> u(0, 1);
    for (int32_t i = 0; i < scene.view().n_sensors; ++i) {
        const Record &sensor = scene.view().sensors[i];
        for (int k = 0; k < 100; ++k) {
            CameraSample<S> at{u(random) * width, u(random) * height, u(random), u(random)};
            const CameraRay<S> ray = camera_ray<S>(scene.view(), sensor, at, width, height);
            CHECK(ray.exists);
            CameraSample<S> found = at;
            found.x = found.y = -1;
            const Vec3<S> p = ray.ray.o + ray.ray.d * (1 + 5 * u(random));
            CHECK(film_place<S>(scene.view(), sensor, p, width, height, found));
            CHECK_NEAR(found.x, at.x, 1e-9);
            CHECK_NEAR(found.y, at.y, 1e-9);
        }
    }
}

// Rims of random triangles: places, derivatives by the parameter, and how they move where normals do.
TR_TEST(rims_of_normals) {
    using S = double;
    using V = Vec3<S>;
    std::mt19937 random(11);
    std::uniform_real_distribution<S> u(-1, 1);
    const uint32_t faces[3] = {0, 1, 2};
    VertexRow<S> rows[3];
    SceneView<S> scene{};
    scene.vertices = rows[0].p, scene.faces = faces;
    int found = 0, twice = 0;
    for (int k = 0; k < 20000; ++k) {
        const V around{u(random), u(random), u(random)}, origin{S(0.3), S(-0.2), S(1.2)};
        S by[3][3];
        for (size_t i = 0; i < 3; ++i) {
            const S n[3] = {around.x, around.y, around.z};
            for (size_t c = 0; c < 3; ++c)
                rows[i].p[c] = u(random), rows[i].n[c] = n[c] + S(0.8) * u(random), by[i][c] = u(random);
        }
        const bool parallel = k % 2 == 1;
        const V from = parallel ? V{S(0.1), S(0.2), S(-0.97)} : origin;
        const Rim<S> rim(scene, 0, from, parallel);
        const S s = S(0.5) + S(0.49) * u(random), h = 1e-6;
        const RimPoint<S> at = rim.at(s);
        if (!at.valid) continue;
        CHECK(rim.possible(0));
        const auto normals_turn = [&](S by_much) {
            for (size_t i = 0; i < 3; ++i)
                for (size_t c = 0; c < 3; ++c) rows[i].n[c] += by_much * by[i][c];
        };
        CHECK_NEAR(dot(at.N, at.w), S(0), 1e-12);
        V turned{0, 0, 0}, place{0, 0, 0};
        for (size_t i = 0; i < 3; ++i) {
            CHECK(at.b[i] >= 0);
            turned = turned + V{by[i][0], by[i][1], by[i][2]} * at.b[i];
            place = place + V{rows[i].p[0], rows[i].p[1], rows[i].p[2]} * at.b[i];
        }
        CHECK_NEAR(max_abs(place - at.p), S(0), 1e-12);
        const RimPoint<S> next = rim.at(s + h), last = rim.at(s - h);
        normals_turn(h);
        const RimPoint<S> after = Rim<S>(scene, 0, from, parallel).at(s);
        normals_turn(-2 * h);
        const RimPoint<S> before = Rim<S>(scene, 0, from, parallel).at(s);
        // near where a line touches the rim, or where it goes through a corner, differences are of no use
        if (!next.valid || !last.valid || !after.valid || !before.valid) continue;
        const S size = 1 + max_abs(at.along) + max_abs(at.slope);
        if (size > 20) continue;
        CHECK_NEAR(max_abs((next.p - last.p) * (1 / (2 * h)) - at.along), S(0), 1e-4 * size * size);
        CHECK_NEAR(max_abs((after.p - before.p) * (1 / (2 * h)) + at.slope * dot(at.w, turned)), S(0),
                   1e-4 * size * size);
        ++found;
        const auto g = [&](size_t i) {
            const V n{rows[i].n[0], rows[i].n[1], rows[i].n[2]}, p{rows[i].p[0], rows[i].p[1], rows[i].p[2]};
            return dot(n, parallel ? -from : from - p) > 0;
        };
        twice += g(0) == g(1) && g(1) == g(2);
    }
    CHECK(found > 1000);
    CHECK(twice > 10);  // of rims that meet a line two times
}

TR_TEST(the_order_is_a_function_of_places_alone) {
    std::mt19937 random(7);
    std::uniform_real_distribution<float> u(0, 1);
    std::vector<Extent> things(30000);
    for (size_t i = 0; i < things.size(); ++i)
        things[i] = {{u(random), u(random), u(random)}, i % 100 == 3 ? 0.2f : i % 100 == 4 ? 0.01f : 0.001f};
    const std::vector<int32_t> order = morton_order(things.data(), things.size(), 1);
    CHECK(order == morton_order(things.data(), things.size(), 3));
    std::vector<int32_t> sorted = order;
    std::sort(sorted.begin(), sorted.end());
    double apart = 0;
    for (size_t i = 0; i < order.size(); ++i) {
        CHECK(sorted[i] == int32_t(i));
        if (i == 0) continue;
        const Extent &a = things[size_t(order[i - 1])], &b = things[size_t(order[i])];
        CHECK(a.size >= b.size);  // large ones first
        for (size_t k = 0; k < 3; ++k) apart += double(std::fabs(a.middle[k] - b.middle[k])) / double(order.size());
    }
    CHECK(apart < 0.1);  // 1 without an order
}

}  // namespace tr::testing
