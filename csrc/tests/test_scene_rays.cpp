// Ray queries of a scene on the emulated device: its tree follows the shapes, also into other processes.
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "device/scene_rays.h"
#include "harness.h"

namespace tr::testing {

namespace {

// A wavy square of n x n cells, a ball above it, a disk, a cylinder, a height field beside that, and a grid of
// distances.
template <class S>
struct SmallScene {
    static constexpr int N = 24, Rows = 21, Columns = 70, Shapes = 6;
    static constexpr int Corners[3] = {9, 7, 8};  // of the grid
    std::vector<VertexRow<S>> vertices;
    std::vector<uint32_t> faces;
    std::vector<ShapeInfo> shapes;
    std::vector<S> matrices, heights, distances;
    TensorView<S> tensors[2]{};
    SceneView<S> view{};

    explicit SmallScene(bool linear = false)
        : vertices((N + 1) * (N + 1)),
          shapes(Shapes, ShapeInfo{}),
          matrices(Shapes * 24),
          heights(Rows * Columns),
          distances(size_t(Corners[0]) * Corners[1] * Corners[2]) {
        for (uint32_t i = 0; i < N; ++i)
            for (uint32_t j = 0; j < N; ++j) {
                const uint32_t a = i * (N + 1) + j, b = a + 1, c = a + N + 1, d = c + 1;
                faces.insert(faces.end(), {a, b, d, a, d, c});
            }
        shapes[0].n_faces = int32_t(faces.size() / 3);
        shapes[1].flags = IsSphere, shapes[2].flags = IsDisk, shapes[3].flags = IsCylinder;
        shapes[4].flags = IsHeightField, shapes[4].heights = 0, shapes[4].interpolation = linear;
        tensors[0].data = heights.data(), tensors[1].data = distances.data();
        tensors[0].shape[0] = Rows, tensors[0].shape[1] = 1, tensors[0].shape[2] = Columns;
        shapes[5].flags = IsSdfGrid, shapes[5].heights = 1;
        tensors[1].shape[0] = Corners[1], tensors[1].shape[1] = Corners[0];
        tensors[1].shape[2] = 1, tensors[1].shape[3] = Corners[2];
        view.values.tensors = tensors;
        place(0, 0.05);
        view.vertices = vertices[0].p, view.faces = faces.data(), view.shapes = shapes.data();
        view.shape_matrices = matrices.data(), view.n_shapes = Shapes;
    }
    // How far the curved shapes are moved, and how high the waves of the square and the field are.
    void place(double by, double height) {
        for (int i = 0; i <= N; ++i)
            for (int j = 0; j <= N; ++j) {
                S *p = vertices[size_t(i * (N + 1) + j)].p;
                p[0] = S(2.0 * i / N - 1), p[1] = S(2.0 * j / N - 1), p[2] = S(height * std::sin(i + 3.0 * j));
            }
        for (int i = 0; i < Rows * Columns; ++i) heights[size_t(i)] = S(5 * height * std::sin(0.3 * i));
        for (int z = 0, i = 0; z < Corners[2]; ++z)
            for (int y = 0; y < Corners[1]; ++y)
                for (int x = 0; x < Corners[0]; ++x, ++i) {
                    const double p[] = {x / 8.0 - 0.5, y / 6.0 - 0.5, z / 7.0 - 0.5};
                    distances[size_t(i)] = S(std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) - 0.4 + height * p[0]);
                }
        for (size_t shape = 1; shape < Shapes; ++shape) {
            const double scale = shape < 5 ? 0.3 : 0.7, at[] = {(shape < 4   ? double(shape) - 2
                                                                 : shape < 5 ? 0.5
                                                                             : -0.9) +
                                                                    by,
                                                                (shape < 4 ? 0.5 : 0.1) * by + (shape < 4   ? 0
                                                                                                : shape < 5 ? 0.7
                                                                                                            : -1.1),
                                                                0.5};
            for (size_t k = 0; k < 3; ++k) {
                S *m = &matrices[shape * 24 + 4 * k];
                m[k] = S(scale), m[3] = S(at[k]);
                m[12 + k] = S(1 / scale), m[15] = S(-at[k] / scale);
            }
        }
    }
};

struct Found {
    std::vector<uint32_t> shape, primitive;
    std::vector<float> t, b1, b2;
    std::vector<uint8_t> occluded;
    bool operator==(const Found &o) const {
        return shape == o.shape && primitive == o.primitive && t == o.t && b1 == o.b1 && b2 == o.b2 &&
               occluded == o.occluded;
    }
};

// Of rays from above in all directions downwards.
Found look(SceneRays &rays) {
    constexpr size_t n = 2000;
    std::vector<float> column[7];
    for (size_t i = 0; i < n; ++i) {
        const auto x = float(i) * 0.6180339f, y = float(i) * 0.7548776f;  // their fractions fill the square
        const float o[] = {2.4f * (x - std::floor(x)) - 1.2f, 2.4f * (y - std::floor(y)) - 1.2f, 1.5f},
                    d[] = {0.3f * std::sin(float(i)), 0.3f * std::cos(float(i)), -1};
        for (int k = 0; k < 3; ++k) column[k].push_back(o[k]), column[3 + k].push_back(d[k]);
        column[6].push_back(i % 3 ? INFINITY : 1.3f);
    }
    Found f;
    f.shape.resize(n), f.primitive.resize(n), f.t.resize(n), f.b1.resize(n), f.b2.resize(n), f.occluded.resize(n);
    const RayBatch batch{{column[0].data(), column[1].data(), column[2].data()},
                         {column[3].data(), column[4].data(), column[5].data()},
                         column[6].data()};
    rays.intersect(batch, {f.shape.data(), f.primitive.data(), f.t.data(), f.b1.data(), f.b2.data()}, n);
    rays.occluded(batch, f.occluded.data(), n);
    return f;
}

template <class S>
Found found_anew(const SmallScene<S> &scene) {
    SceneRays rays;
    rays.update(scene.view, 1);
    return look(rays);
}

template <class S>
void check_following(bool linear) {
    SmallScene<S> scene(linear);
    SceneRays rays;
    rays.update(scene.view, 7);
    const Found before = look(rays);
    for (uint32_t shape = 0; shape < SmallScene<S>::Shapes; ++shape)
        CHECK(std::count(before.shape.begin(), before.shape.end(), shape) > 20);
    scene.place(0.02, 0.07);
    rays.update(scene.view, 7);  // as if nothing had happened
    CHECK(look(rays) == before && rays.builds() == 1 && rays.refits() == 0);
    rays.update(scene.view, 8);
    CHECK(rays.builds() == 1 && rays.refits() == 1);
    const Found after = look(rays);
    CHECK(after == found_anew(scene) && !(after == before));
    scene.place(0.4, 3);
    rays.update(scene.view, 9);
    CHECK(rays.builds() == 2 && rays.refits() == 1);
    CHECK(look(rays) == found_anew(scene));
}

}  // namespace

TR_TEST(trees_follow_scenes) {
    for (bool linear : {false, true}) check_following<float>(linear), check_following<double>(linear);
}

TR_TEST(emulated_devices_are_made_again_after_a_fork) {
    SmallScene<float> scene;
    auto rays = std::make_unique<SceneRays>();
    rays->update(scene.view, 1);
    const Found before = look(*rays);
    std::fflush(stdout);
    const pid_t child = fork();
    if (child == 0) {
        alarm(20);  // nobody waits for ever for a thread that is not there
        rays->update(scene.view, 1);
        bool good = look(*rays) == before;
        scene.place(0.02, 0.07);
        rays->update(scene.view, 2);
        good = good && look(*rays) == found_anew(scene);
        rays.reset();
        _exit(good ? 0 : 1);
    }
    int status = 0;
    waitpid(child, &status, 0);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    CHECK(look(*rays) == before);
}

TR_TEST(scenes_without_shapes_are_missed) {
    SceneRays rays;
    rays.update(SceneView<float>{}, 1);
    const Found found = look(rays);
    for (size_t i = 0; i < found.shape.size(); ++i) CHECK(found.shape[i] == TreeHit::Miss && found.occluded[i] == 0);
}

// What a child only lets go.
TR_TEST(emulated_devices_of_a_parent_are_let_go) {
    SmallScene<float> scene;
    auto rays = std::make_unique<SceneRays>();
    rays->update(scene.view, 1);
    std::fflush(stdout);
    const pid_t child = fork();
    if (child == 0) {
        alarm(20);
        rays.reset();
        _exit(0);
    }
    int status = 0;
    waitpid(child, &status, 0);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

TR_TEST(shapes_that_the_device_has_not_are_named) {
    const auto missing = [](int32_t flags) {
        ShapeInfo shape{};
        shape.flags = flags;
        const char *name = SceneRays::missing(shape);
        return std::string(name ? name : "");
    };
    for (const int32_t flags : {0, int32_t(HasNormals), int32_t(IsSphere), int32_t(IsDisk), int32_t(IsCylinder),
                                int32_t(IsHeightField), int32_t(IsSdfGrid)})
        CHECK(missing(flags).empty());
    CHECK(missing(IsCurve) == "a bsplinecurve" && missing(IsCurve | IsStraight) == "a linearcurve");
}

}  // namespace tr::testing
