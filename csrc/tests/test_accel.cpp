// Ray queries against a plain loop over all triangles, at every query width.
#include <random>

#include "accel/accel.h"
#include "accel/embree_library.h"
#include "core/math/vector.h"
#include "core/shape/quadric_hit.h"
#include "harness.h"

namespace tr::testing {

using V = Vec3<double>;

struct Soup {
    std::vector<float> positions;
    std::vector<uint32_t> faces;

    V vertex(uint32_t i) const { return {positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]}; }
};

// Distance along the ray to triangle f, or infinity; `edge`: so near to an edge that rounding may decide.
static double distance_to(const Soup &soup, size_t f, const V &o, const V &d, bool &edge) {
    V p = soup.vertex(soup.faces[3 * f]), e1 = soup.vertex(soup.faces[3 * f + 1]) - p,
      e2 = soup.vertex(soup.faces[3 * f + 2]) - p;
    V q = cross(d, e2), s = o - p, r = cross(s, e1);
    double determinant = dot(e1, q), u = dot(s, q) / determinant, v = dot(d, r) / determinant,
           t = dot(e2, r) / determinant;
    double inside = std::min(std::min(u, v), 1 - u - v);
    edge = edge || (std::abs(inside) < 1e-4 && t > 0) || std::abs(t) < 1e-4;
    return inside >= 0 && t > 0 ? t : INFINITY;
}

TR_TEST(queries_match_a_loop_over_all_triangles) {
    load_embree(embree_path());
    std::mt19937 generator(1);
    std::uniform_real_distribution<float> uniform(-1, 1);
    Soup soup;
    for (int i = 0; i < 90; ++i) soup.faces.push_back(uint32_t(i));
    for (int i = 0; i < 270; ++i) soup.positions.push_back(uniform(generator));
    const size_t n = 1003;  // not a multiple of any width
    std::vector<float> columns[7], t(n), b1(n), b2(n);
    for (size_t i = 0; i < n; ++i) {
        for (int k = 0; k < 6; ++k) columns[k].push_back(uniform(generator) * (k < 3 ? 2 : 1));
        columns[6].push_back(i % 3 ? INFINITY : 1.f);
    }
    RayBatch rays{{columns[0].data(), columns[1].data(), columns[2].data()},
                  {columns[3].data(), columns[4].data(), columns[5].data()},
                  columns[6].data()};
    std::vector<uint32_t> shape(n), primitive(n);
    std::vector<uint8_t> occluded(n);
    for (int width : {1, 4, 8, 16, 0}) {
        Accel::set_query_width(width);
        Accel accel;
        accel.set_mesh(7, soup.positions.data(), 90, soup.faces.data(), 30);
        accel.commit();
        accel.intersect(rays, {shape.data(), primitive.data(), t.data(), b1.data(), b2.data()}, n, width == 8);
        accel.occluded(rays, occluded.data(), n);
        size_t hits = 0;
        for (size_t i = 0; i < n; ++i) {
            V o{columns[0][i], columns[1][i], columns[2][i]}, d{columns[3][i], columns[4][i], columns[5][i]};
            double nearest = INFINITY;
            size_t which = 0;
            bool edge = false;
            for (size_t f = 0; f < 30; ++f) {
                double distance = distance_to(soup, f, o, d, edge);
                if (distance < nearest) nearest = distance, which = f;
            }
            if (edge || std::abs(nearest - columns[6][i]) < 1e-3) continue;
            bool hit = nearest < columns[6][i];
            CHECK((shape[i] == 7) == hit && (hit || shape[i] == Accel::Miss));
            CHECK(bool(occluded[i]) == hit);
            if (!hit) continue;
            ++hits;
            CHECK(primitive[i] == which);
            CHECK_NEAR(t[i], nearest, 1e-4 * (1 + nearest));
            V p = soup.vertex(soup.faces[3 * which]) * (1. - double(b1[i]) - double(b2[i])) +
                  soup.vertex(soup.faces[3 * which + 1]) * double(b1[i]) +
                  soup.vertex(soup.faces[3 * which + 2]) * double(b2[i]);
            CHECK_NEAR(max_abs(p - (o + d * nearest)), 0, 1e-4);
        }
        CHECK(hits > 100);
    }
}

TR_TEST(queries_hit_spheres_and_disks) {
    load_embree(embree_path());
    const float to_world[12] = {2, 0, 0, 1, 0, 2, 0, 0, 0, 0, 2, 0},
                to_object[12] = {0.5, 0, 0, -0.5, 0, 0.5, 0, 0, 0, 0, 0.5, 0};
    Accel accel;
    accel.set_quadric(0, QuadricKind::Sphere, to_world, to_object);
    const float identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, -5};
    const float back[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5};
    accel.set_quadric(1, QuadricKind::Disk, identity, back);
    accel.commit();
    float ox[] = {1, 1, 4, 0.5f}, oy[] = {0, 0, 0, 0.5f}, oz[] = {-4, 0, -4, -9}, zero[] = {0, 0, 0, 0},
          dz[] = {1, 2, 1, 1};
    float tmax[] = {INFINITY, INFINITY, INFINITY, INFINITY}, t[4], b1[4], b2[4];
    uint32_t shape[4], primitive[4];
    accel.intersect({{ox, oy, oz}, {zero, zero, dz}, tmax}, {shape, primitive, t, b1, b2}, 4, false);
    const uint32_t expected[] = {0, 0, Accel::Miss, 1};
    const float distance[] = {2, 1, INFINITY, 4};  // the second starts inside, with a direction of length 2
    for (int i = 0; i < 4; ++i) {
        CHECK(shape[i] == expected[i]);
        if (expected[i] != Accel::Miss) CHECK_NEAR(t[i], distance[i], 1e-5);
    }
    float box[6];
    accel.bounds(box);
    CHECK(box[0] <= -1 && box[3] >= 3 && box[2] <= -5 && box[5] >= 2);
}

TR_TEST(quadrics_are_hit_alike_in_full_and_in_sparse_packets) {
    load_embree(embree_path());
    std::mt19937 generator(3);
    std::uniform_real_distribution<float> uniform(-1, 1);
    const size_t n = 2005, shapes = 12;
    float to_world[shapes][12], to_object[shapes][12];
    double matrix[shapes][12];
    for (size_t s = 0; s < shapes; ++s) {
        const float size = 0.4f + 0.4f * std::abs(uniform(generator));
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 4; ++k) {
                const float place = uniform(generator);
                to_world[s][4 * i + k] = k == 3 ? place : i == k ? size : 0;
                to_object[s][4 * i + k] = k == 3 ? -place / size : i == k ? 1 / size : 0;
            }
        std::copy_n(to_object[s], 12, matrix[s]);
    }
    const QuadricKind kinds[] = {QuadricKind::Sphere, QuadricKind::Disk, QuadricKind::Cylinder};
    std::vector<float> columns[7], t(n), b1(n), b2(n);
    for (size_t i = 0; i < n; ++i) {
        for (int k = 0; k < 6; ++k) columns[k].push_back(uniform(generator) * (k < 3 ? 2 : 1));
        // in one half of the rays there is one in ten that is a ray at all
        columns[6].push_back(i < n / 2 && i % 10 ? -1.f : i % 3 ? INFINITY : 1.f);
    }
    const RayBatch rays{{columns[0].data(), columns[1].data(), columns[2].data()},
                        {columns[3].data(), columns[4].data(), columns[5].data()},
                        columns[6].data()};
    std::vector<uint32_t> shape(n), primitive(n);
    std::vector<uint8_t> occluded(n);
    std::vector<float> alone;
    for (int width : {1, 4, 8, 16}) {
        Accel::set_query_width(width);
        Accel accel;
        for (uint32_t s = 0; s < shapes; ++s) accel.set_quadric(s, kinds[s % 3], to_world[s], to_object[s]);
        accel.commit();
        accel.intersect(rays, {shape.data(), primitive.data(), t.data(), b1.data(), b2.data()}, n, width == 8);
        accel.occluded(rays, occluded.data(), n);
        if (width == 1) alone = t;
        CHECK(t == alone);  // the same bits, whatever other rays there are in a packet
        size_t hits[3] = {};
        for (size_t i = 0; i < n; ++i) {
            const float o[3] = {columns[0][i], columns[1][i], columns[2][i]};
            const float d[3] = {columns[3][i], columns[4][i], columns[5][i]};
            float nearest = columns[6][i];
            uint32_t which = Accel::Miss;
            for (uint32_t s = 0; s < shapes; ++s) {
                const UnitRay ray(matrix[s], o, d);
                const float found = s % 3 == 0   ? first_sphere_hit(ray, 0, nearest)
                                    : s % 3 == 1 ? first_disk_hit(ray, 0, nearest)
                                                 : first_cylinder_hit(ray, 0, nearest);
                if (found >= 0) nearest = found, which = s;
            }
            CHECK(shape[i] == which && bool(occluded[i]) == (which != Accel::Miss));
            if (which == Accel::Miss) continue;
            ++hits[which % 3];
            CHECK_NEAR(t[i], nearest, 1e-6 * nearest);
        }
        for (size_t each : hits) CHECK(each > 20);
    }
    Accel::set_query_width(0);
}

TR_TEST(rays_that_are_none_hit_nothing) {
    load_embree(embree_path());
    const float positions[] = {-9, -9, 0, 9, -9, 0, 0, 9, 0};
    const uint32_t faces[] = {0, 1, 2};
    Accel accel;
    accel.set_mesh(0, positions, 3, faces, 1);
    accel.commit();
    const float bad = NAN, inf = INFINITY;
    float ox[] = {0, bad, 0, 0, inf, 0}, oy[] = {0, 0, 0, 0, 0, 0}, oz[] = {-1, -1, -1, -1, -1, -1};
    float dx[] = {0, 0, bad, 0, 0, 0}, dz[] = {1, 1, 1, 0, 1, 1}, tmax[] = {9, 9, 9, 9, 9, -1};
    float t[6], b1[6], b2[6];
    uint32_t shape[6], primitive[6];
    uint8_t occluded[6];
    RayBatch rays{{ox, oy, oz}, {dx, oy, dz}, tmax};
    accel.intersect(rays, {shape, primitive, t, b1, b2}, 6, false);
    accel.occluded(rays, occluded, 6);
    CHECK(shape[0] == 0 && occluded[0] == 1);
    for (int i = 1; i < 6; ++i) CHECK(shape[i] == Accel::Miss && occluded[i] == 0);
}

TR_TEST(meshes_move) {
    load_embree(embree_path());
    float positions[] = {-9, -9, 0, 9, -9, 0, 0, 9, 0};
    const uint32_t faces[] = {0, 1, 2};
    Accel accel;
    accel.set_mesh(0, positions, 3, faces, 1);
    accel.commit();
    for (float z : {0.f, 2.f, 5.f}) {
        for (int i = 2; i < 9; i += 3) positions[i] = z;
        accel.set_mesh(0, positions, 3, faces, 1);
        accel.commit();
        float zero = 0, start = -1, one = 1, tmax = INFINITY, t, b1, b2;
        uint32_t shape, primitive;
        accel.intersect({{&zero, &zero, &start}, {&zero, &zero, &one}, &tmax}, {&shape, &primitive, &t, &b1, &b2}, 1,
                        true);
        CHECK(shape == 0);
        CHECK_NEAR(t, 1 + z, 1e-5);
    }
}

// Two meshes; the first moves, a little and then wildly. Answers are those of a structure that is built for the
// positions at hand, whose counters tell how this one got there.
TR_TEST(refitted_trees_answer_like_new_ones) {
    load_embree(embree_path());
    std::mt19937 generator(2);
    std::uniform_real_distribution<float> uniform(-1, 1);
    constexpr size_t side = 24, n_vertices = side * side;
    std::vector<float> rest, moved;
    std::vector<uint32_t> faces;
    for (size_t i = 0; i < n_vertices; ++i) {
        rest.push_back(float(i % side) * 2 / float(side - 1) - 1);
        rest.push_back(float(i / side) * 2 / float(side - 1) - 1);
        rest.push_back(0.1f * uniform(generator));
    }
    for (uint32_t i = 0; i + side < n_vertices; ++i)
        if (i % side + 1 < side) faces.insert(faces.end(), {i, i + 1, i + uint32_t(side)});
    const float wall[] = {-9, -9, 3, 9, -9, 3, 0, 9, 3};
    const uint32_t wall_face[] = {0, 1, 2};

    const size_t n = 500;
    std::vector<float> columns[7], t[2], b1(n), b2(n);
    for (size_t i = 0; i < n; ++i)
        for (int k = 0; k < 7; ++k)
            columns[k].push_back(k == 2 ? -2.f : k < 3 ? uniform(generator) : k == 5 ? 1.f : 0.2f * uniform(generator));
    std::fill(columns[6].begin(), columns[6].end(), INFINITY);
    RayBatch rays{{columns[0].data(), columns[1].data(), columns[2].data()},
                  {columns[3].data(), columns[4].data(), columns[5].data()},
                  columns[6].data()};
    std::vector<uint32_t> shape[2], primitive[2];
    Accel accel;
    accel.set_mesh(0, rest.data(), n_vertices, faces.data(), faces.size() / 3);
    accel.set_mesh(1, wall, 3, wall_face, 1);
    accel.commit();
    for (int step = 1; step <= 12; ++step) {
        moved = rest;
        for (size_t i = 0; i < moved.size(); ++i) moved[i] += (step < 8 ? 0.01f : 0.5f) * uniform(generator);
        accel.set_mesh(0, moved.data(), n_vertices, nullptr, faces.size() / 3);
        accel.commit();
        Accel fresh;
        fresh.set_mesh(0, moved.data(), n_vertices, faces.data(), faces.size() / 3);
        fresh.set_mesh(1, wall, 3, wall_face, 1);
        fresh.commit();
        const Accel *which[] = {&accel, &fresh};
        for (int k = 0; k < 2; ++k) {
            shape[k].assign(n, 0), primitive[k].assign(n, 0), t[k].assign(n, 0);
            which[k]->intersect(rays, {shape[k].data(), primitive[k].data(), t[k].data(), b1.data(), b2.data()}, n,
                                false);
        }
        size_t hits = 0;
        for (size_t i = 0; i < n; ++i) {
            hits += shape[0][i] == 0;
            CHECK(shape[0][i] == shape[1][i]);
            CHECK(t[0][i] == t[1][i]);
        }
        CHECK(hits > 100);
        if (step == 7) CHECK(accel.counters().refits == 5 && accel.counters().rebuilds == 0);
    }
    CHECK(accel.counters().builds == 3);
    CHECK(accel.counters().rebuilds >= 1 && accel.counters().refits + accel.counters().rebuilds == 10);
}

}  // namespace tr::testing
