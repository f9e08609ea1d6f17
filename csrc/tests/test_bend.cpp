// Rays that bend go back over the very integers that they came by, and blocks without surfaces have none.
// (Values and derivatives are tested from Python.)
#include <algorithm>
#include <random>

#include "accel/embree_library.h"
#include "core/adjoint/bend.h"
#include "host/bend_blocks.h"
#include "scene_builder.h"

namespace tr::testing {

namespace {

// A rough field over a small grid, which rays leave, with a matrix of kicks that is not diagonal.
template <class S>
struct RoughField {
    BendField<S> field{nullptr, {7, 6, 9}, {S(0.3), S(0.25), S(0.35), S(0.02), S(-0.03), S(0.04)}};
    std::vector<S> values;

    explicit RoughField(std::mt19937 &generator) : values(field.size()) {
        std::uniform_real_distribution<S> uniform(S(0.8), S(1.2));
        for (S &v : values) v = uniform(generator);
        field.values = values.data();
    }
};

template <class F>
F random_lanes(std::mt19937 &generator, double low, double high) {
    using S = ScalarOf<F>;
    std::uniform_real_distribution<double> uniform(low, high);
    alignas(64) S lanes[size_t(Lanes<F>::Width)];
    for (S &x : lanes) x = S(uniform(generator));
    return load<F>(lanes);
}

template <class F>
MaskOf<F> equal(const BendState<F> &a, const BendState<F> &b) {
    MaskOf<F> r(true);
    for (int k = 0; k < 3; ++k) r = r && mask<F>(a.q[k] == b.q[k]) && mask<F>(a.u[k] == b.u[k]);
    return r;
}

// Forwards with what tracing evaluates, backwards with what the adjoint does, in every lane as many steps as it has.
template <int T, class F>
void check_way_back(int rays, int most) {
    using S = ScalarOf<F>;
    using I = IntOf<F>;
    std::mt19937 generator(1);
    const RoughField<S> rough(generator);
    const BendField<S> &field = rough.field;
    std::vector<S> values_bar(field.size());
    const int bits = position_bits<F>(field);
    for (int ray = 0; ray < rays; ray += Lanes<F>::Width) {
        const F x = random_lanes<F>(generator, 0, 7), y = random_lanes<F>(generator, 0, 6),
                z = random_lanes<F>(generator, 0, 9);
        const F u = random_lanes<F>(generator, -1, 1), v = random_lanes<F>(generator, -1, 1),
                w = random_lanes<F>(generator, -1, 1);
        const I steps = I(random_lanes<F>(generator, 0, most + 0.999));
        BendState<F> s;
        start_bent<F>(s, {x, y, z}, {u, v, w}, bits);
        const BendState<F> start = s;
        const MaskOf<F> everywhere(true);
        auto forwards = [&](const F &weight, const MaskOf<F> &active) {
            const BendSlope<F> at = spline_slope<T, F>(field, cell_at<T>(field, s, bits), active);
            kick<F, false>(s, symmetric_times<F>(field.kick, at.slope) * weight, active);
        };
        forwards(F(S(0.5)), everywhere);
        MaskOf<F> active = mask<F>(steps > I(0));
        for (int32_t m = 1; any(active); ++m) {
            drift<F>(s, bits, active);
            forwards(F(1), active);
            active = mask<F>(steps > I(m));
        }
        CHECK(!any(equal<F>(s, start)));
        BendAdjoint<F> adjoint{{F(1), F(2), F(3)}, {F(3), F(2), F(1)}, F(1), F(1)};
        fly_back<T, F>(field, S(1), s, bits, steps, adjoint, everywhere,
                       [&](const auto &at, const F &value, const Vec3<F> &slope, const MaskOf<F> &lanes) {
                           splat_spline(field, at, value, slope, values_bar.data(), lanes);
                       });
        CHECK(all(equal<F>(s, start)));
    }
}

template <class F>
void check_ways_back() {
    check_way_back<3, F>(4000, 40);
    check_way_back<4, F>(4000, 40);
    check_way_back<3, F>(64, 2000);
    check_way_back<4, F>(64, 2000);
}

// Drifts are rounded to the nearest position on both sides of zero, so that none is left over.
template <class F>
void check_drift() {
    const BendField<ScalarOf<F>> field{nullptr, {250, 3, 3}, {}};
    const int bits = position_bits<F>(field), shift = BendNumber<F>::Velocity - bits;
    CHECK(shift > 0);
    using Lane = BendLane<F>;
    for (int n = -5; n <= 5; ++n) {
        const Lane unit = Lane(1) << shift, whole = Lane(n) * unit;
        CHECK(all(mask<F>(drift_of<F>(BendInt<F>(whole), bits) == BendInt<F>(Lane(n)))));
        CHECK(all(mask<F>(drift_of<F>(BendInt<F>(whole + unit / 4), bits) == BendInt<F>(Lane(n)))));
        CHECK(all(mask<F>(drift_of<F>(BendInt<F>(whole - unit / 4), bits) == BendInt<F>(Lane(n)))));
    }
}

// Lanes that have from one to all different places in a table, some not being active: rows are those of their places.
template <int T, class F>
void check_shared_rows() {
    using S = ScalarOf<F>;
    constexpr int W = Lanes<F>::Width;
    std::mt19937 generator(3);
    std::vector<S> table(200);
    for (size_t i = 0; i < table.size(); ++i) table[i] = S(i);
    int shared = 0, others = 0;
    for (int round = 0; round < 2000; ++round) {
        alignas(64) uint32_t at[W], which[W];
        alignas(64) S wanted[W];
        std::vector<uint32_t> places(1 + generator() % W), different;
        for (uint32_t &place : places) place = uint32_t(generator() % (table.size() - T + 1));
        const uint32_t always = uint32_t(generator() % W);
        for (uint32_t i = 0; i < W; ++i) {
            at[i] = places[generator() % places.size()];
            wanted[i] = S(i == always || generator() % 4);
            if (wanted[i] != 0 && std::find(different.begin(), different.end(), at[i]) == different.end())
                different.push_back(at[i]);
        }
        const MaskOf<F> active = mask<F>(load<F>(wanted) != F(0));
        const FewNumbers<F> few(load_uint<F>(at), active);
        CHECK(few.all == (different.size() <= size_t(FewNumbers<F>::Most)));
        ++(few.all ? shared : others);
        if (!few.all) continue;
        CHECK(size_t(few.n) == different.size());
        for (size_t k = 0; k < different.size(); ++k) CHECK(few.value[k] == different[k]);
        store(which, few.which);
        with_shared_rows<F, T>(few, [&](auto &&rows) {
            F row[T];
            rows(table.data(), row);
            for (int k = 0; k < T; ++k)
                for (int i = 0; i < W; ++i)
                    if (lane_is_set(active, i))
                        CHECK(few.value[which[i]] == at[i] && lane(row[k], i) == table[at[i] + uint32_t(k)]);
        });
    }
    CHECK(shared > 0);
    CHECK(W <= FewNumbers<F>::Most || others > 0);
}

// Numbers of lanes as rows, and sums of these.
template <class F>
void check_lane_rows() {
    using S = ScalarOf<F>;
    F numbers[3];
    for (int k = 0; k < 3; ++k) numbers[k] = F(lane_index<F>()) * F(S(3)) + F(S(k));
    const LaneRows<F> rows(numbers);
    RowSum<S> sum;
    S expected = 0;
    for (uint32_t i = 0; i < uint32_t(Lanes<F>::Width); ++i) {
        for (uint32_t k = 0; k < 4; ++k) CHECK(rows[i][k] == (k < 3 ? S(3 * i + k) : S(0)));
        sum.add(rows[i], S(2)), expected += S(6 * i);
    }
    alignas(32) S found[4];
    sum.put(found);
    for (int k = 0; k < 3; ++k) CHECK(found[k] == expected + S(2 * k * Lanes<F>::Width));
    CHECK(found[3] == S(0));
}

template <class F>
void check_rows() {
    check_lane_rows<F>();
    if constexpr (Lanes<F>::Width > 1) {
        check_shared_rows<3, F>();
        check_shared_rows<4, F>();
    }
}

// A point and its place in the grid, both ways.
struct Placed {
    double m[12], inverse[9];
    // Axes at an angle, voxels of about this size.
    Placed(std::mt19937 &generator, double size) {
        std::uniform_real_distribution<double> uniform(-0.3, 0.3);
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 4; ++k)
                m[4 * i + k] = k == 3 ? uniform(generator) : size * ((i == k) + uniform(generator));
        const Vec3<double> a = column(0), b = column(1), c = column(2);
        const double determinant = dot(a, cross(b, c));
        const Vec3<double> rows[3] = {cross(b, c), cross(c, a), cross(a, b)};
        for (int i = 0; i < 3; ++i) {
            inverse[3 * i] = rows[i].x / determinant, inverse[3 * i + 1] = rows[i].y / determinant;
            inverse[3 * i + 2] = rows[i].z / determinant;
        }
    }
    Vec3<double> column(int k) const { return {m[k], m[4 + k], m[8 + k]}; }
    Vec3<double> world(const Vec3<double> &q) const {
        return column(0) * q.x + column(1) * q.y + column(2) * q.z + column(3);
    }
    Vec3<double> voxel(const Vec3<double> &p) const {
        const Vec3<double> v = p - column(3);
        auto row = [&](int i) { return inverse[3 * i] * v.x + inverse[3 * i + 1] * v.y + inverse[3 * i + 2] * v.z; };
        return {row(0), row(1), row(2)};
    }
};

constexpr int32_t Grid[3] = {37, 30, 22};

template <class S>
bool is_near(const BendBlocks &blocks, const Vec3<double> &q, bool &inside) {
    inside = q.x >= 0 && q.y >= 0 && q.z >= 0 && q.x < Grid[0] && q.y < Grid[1] && q.z < Grid[2];
    const BendField<S> field{nullptr, {Grid[0], Grid[1], Grid[2]}, {}};
    const int bits = position_bits<S>(field);
    BendState<S> s;
    start_bent<S>(s, {S(q.x), S(q.y), S(q.z)}, {S(0), S(0), S(0)}, bits);
    BendMedium<S> medium{};
    medium.blocks = blocks.words();
    std::copy_n(blocks.n(), 3, medium.n_blocks);
    return inside && surface_near<S>(medium, s, bits, true);
}

enum Kinds { Triangles, Sphere, Disk, Cylinder, NumberOfKinds };

// A shape of this kind, about half as large as the grid; points on it come from random numbers.
template <class S>
struct OneShape {
    SceneBuilder<S> b{3};
    SceneData<S> scene;
    std::vector<double> matrix;
    std::vector<S> corners;
    Kinds kind;

    OneShape(Kinds kind, const Placed &placed, std::mt19937 &generator) : kind(kind) {
        std::uniform_real_distribution<double> uniform(0, 1);
        const int64_t white = b.diffuse(1, 1, 1);
        auto anywhere = [&] {
            return placed.world(
                {Grid[0] * uniform(generator), Grid[1] * uniform(generator), Grid[2] * uniform(generator)});
        };
        if (kind == Triangles) {
            for (int i = 0; i < 3; ++i) {
                const Vec3<double> p = anywhere();
                corners.insert(corners.end(), {S(p.x), S(p.y), S(p.z)});
            }
            b.add("shape", "mesh",
                  {{"vertices", b.param({3, 3}, corners)}, {"faces", b.faces({0, 1, 2})}, {"bsdf", white}});
        } else {
            const Vec3<double> p = anywhere();
            const double a = 6 * uniform(generator), c = 6 * uniform(generator), r = 0.4 + 0.4 * uniform(generator);
            matrix = {r * std::cos(a),
                      -r * std::sin(a) * std::cos(c),
                      r * std::sin(a) * std::sin(c),
                      p.x,
                      r * std::sin(a),
                      r * std::cos(a) * std::cos(c),
                      -r * std::cos(a) * std::sin(c),
                      p.y,
                      0,
                      r * std::sin(c),
                      r * std::cos(c),
                      p.z};
            matrix.insert(matrix.end(), {0, 0, 0, 1});
            std::vector<S> numbers(matrix.begin(), matrix.end());
            for (size_t i = 0; i < numbers.size(); ++i) matrix[i] = double(numbers[i]);
            const char *names[] = {"mesh", "sphere", "disk", "cylinder"};
            Fields fields{{"to_world", b.param({4, 4}, numbers)}, {"bsdf", white}};
            if (kind == Cylinder) {
                fields.emplace_back("p0", b.param({3}, {0, 0, 0}));
                fields.emplace_back("p1", b.param({3}, {0, 0, 1}));
            }
            b.add("shape", names[kind], fields);
        }
        b.camera(0, 0, -9, 45);
        b.build(scene);
    }
    Vec3<double> point(std::mt19937 &generator) const {
        std::uniform_real_distribution<double> uniform(0, 1);
        const double u = uniform(generator), v = uniform(generator), phi = 2 * M_PI * u;
        if (kind == Triangles) {
            const double r = std::sqrt(u), weight[3] = {1 - r, r * (1 - v), r * v};
            Vec3<double> p{0, 0, 0};
            for (size_t i = 0; i < 3; ++i)
                p = p + Vec3<double>{double(corners[3 * i]), double(corners[3 * i + 1]), double(corners[3 * i + 2])} *
                            weight[i];
            return p;
        }
        double x = std::cos(phi), y = std::sin(phi), z = v;
        if (kind == Sphere) z = 2 * v - 1, x *= std::sqrt(1 - z * z), y *= std::sqrt(1 - z * z);
        if (kind == Disk) x *= std::sqrt(v), y *= std::sqrt(v), z = 0;
        auto row = [&](size_t i) {
            return matrix[4 * i] * x + matrix[4 * i + 1] * y + matrix[4 * i + 2] * z + matrix[4 * i + 3];
        };
        return {row(0), row(1), row(2)};
    }
};

template <class S>
void check_blocks() {
    std::mt19937 generator(2);
    std::uniform_real_distribution<double> uniform(-1, 1);
    for (int kind = 0; kind < NumberOfKinds; ++kind) {
        size_t flagged = 0, tried = 0, on_surface = 0;
        for (int shape = 0; shape < 25; ++shape) {
            const Placed placed(generator, 0.1);
            const OneShape<S> one(Kinds(kind), placed, generator);
            S to_world[12];
            for (int i = 0; i < 12; ++i) to_world[i] = S(placed.m[i]);
            const double reach = shape % 2 ? 1.5 : 3;
            const BendBlocks blocks(one.scene.view(), Grid, to_world, reach);
            bool inside = false;
            for (int i = 0; i < 2000; ++i) {
                const double r = 0.999 * reach;
                const Vec3<double> off{r * uniform(generator), r * uniform(generator), r * uniform(generator)};
                const bool found = is_near<S>(blocks, placed.voxel(one.point(generator)) + off, inside);
                CHECK(found == inside);
                on_surface += inside;
            }
            for (int i = 0; i < 1000; ++i, ++tried)
                flagged += is_near<S>(
                    blocks,
                    {Grid[0] * (0.5 + 0.4999 * uniform(generator)), Grid[1] * (0.5 + 0.4999 * uniform(generator)),
                     Grid[2] * (0.5 + 0.4999 * uniform(generator))},
                    inside);
        }
        CHECK(on_surface > 25000);
        CHECK(flagged > 0);
        CHECK(double(flagged) < 0.75 * double(tried));  // or every ray would ask at every step
    }
}

}  // namespace

TR_TEST(bent_rays_go_back_bit_for_bit) {
#define TR_CHECK_WAYS(S)  \
    check_ways_back<S>(); \
    if constexpr (Lanes<PacketOf<S>>::Width > 1) check_ways_back<PacketOf<S>>();
    TR_FOR_EACH_PRECISION(TR_CHECK_WAYS)
}

TR_TEST(drifts_of_bent_rays_are_rounded) {
#define TR_CHECK_DRIFT(S) \
    check_drift<S>();     \
    check_drift<PacketOf<S>>();
    TR_FOR_EACH_PRECISION(TR_CHECK_DRIFT)
}

TR_TEST(rows_that_lanes_share_are_their_own) {
#define TR_CHECK_ROWS(S)  \
    check_lane_rows<S>(); \
    check_rows<PacketOf<S>>();
    TR_FOR_EACH_PRECISION(TR_CHECK_ROWS)
}

TR_TEST(blocks_near_surfaces_are_marked) {
    load_embree(embree_path());
#define TR_CHECK_BLOCKS(S) check_blocks<S>();
    TR_FOR_EACH_PRECISION(TR_CHECK_BLOCKS)
}

}  // namespace tr::testing
