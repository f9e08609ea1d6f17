// Light tracing: forward mode against reverse mode, and images that do not depend on threads or on what is cropped. On
// the emulated device: images and derivatives are those of the CPU, in whatever batches and order.
#include <algorithm>
#include <random>

#include "accel/embree_library.h"
#include "device/emulated.h"
#include "device/scene_rays.h"
#include "device/tree_walk.h"
#include "scene_builder.h"
#if !TR_HAS_PACKETS
#include "cpu/device_paths.h"
#endif

namespace tr::testing {

namespace {

// A beam, an area light, lights without a surface and an environment shine through a glass ball onto a wall; the
// camera, or a meter on the wall, looks.
template <class S>
void add_scene(SceneBuilder<S> &b, bool meter) {
    int64_t black = b.diffuse(0, 0, 0), wall = b.diffuse(S(0.5), S(0.6), S(0.7));
    int64_t glass = b.add("bsdf", "dielectric", {{"eta", b.number(S(1.5))}});
    int64_t beam = b.add("emitter", "directionalarea", {{"radiance", b.constant(2, 1, 3)}});
    int64_t area = b.add("emitter", "area", {{"radiance", b.constant(4, 2, 1)}});
    b.add("emitter", "point", {{"intensity", b.color(5, 6, 7)}, {"position", b.param({3}, {S(1.5), 1, -2})}});
    b.add("emitter", "constant", {{"radiance", b.color(S(0.1), S(0.2), S(0.3))}});
    b.add("emitter", "spot",
          {{"intensity", b.color(5, 6, 7)},
           {"cutoff_angle", b.number(30)},
           {"beam_width", b.number(10)},
           {"to_world", b.matrix(1, S(0.5), -1)}});
    b.add("emitter", "projector",
          {{"irradiance", b.constant(2, 1, 3)}, {"x_fov", b.number(40)}, {"to_world", b.matrix(-1, S(0.3), -1)}});
    b.add("emitter", "directional", {{"irradiance", b.color(1, 2, 1)}, {"to_world", b.matrix(0, 0, 0)}});
    b.add("shape", "rectangle", {{"to_world", b.matrix(0, 0, 3, 4)}, {"flip_normals", 1}, {"bsdf", wall}});
    b.add("shape", "rectangle", {{"to_world", b.matrix(S(0.2), 0, -2, S(0.7))}, {"bsdf", black}, {"emitter", beam}});
    b.add("shape", "rectangle", {{"to_world", b.matrix(-2, S(0.5), -1, S(0.5))}, {"bsdf", black}, {"emitter", area}});
    b.add("shape", "sphere",
          {{"to_world", b.matrix(S(0.1), S(0.1), 0)}, {"radius", b.number(S(0.6))}, {"bsdf", glass}});
    if (meter) b.add("sensor", "irradiancemeter", {{"shape", 0}});
    b.camera(0, 0, S(0.8), 70);
}

template <class S>
std::vector<S> light(const SceneData<S> &scene, const Settings &s) {
    std::vector<S> image(n_values(scene, s));
    trace_light<S>(make_call(scene, s), image.data());
    return image;
}

template <class S>
void compare_modes(bool meter) {
    const double tolerance = sizeof(S) == 8 ? 1e-11 : 1e-3;
    SceneBuilder<S> b(3);
    add_scene(b, meter);
    SceneData<S> scene;
    b.build(scene);
    Settings s;
    s.spp = 8, s.max_depth = 5;
    s.filter = Filter(FilterKind::Gaussian, 0.5);
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    std::vector<std::vector<S>> tangents;
    for (int64_t n : scene.layout().slot_sizes) {
        tangents.emplace_back();
        for (int64_t i = 0; i < n; ++i) tangents.back().push_back(n == 16 && i >= 12 ? S(0) : S(normal(random)));
    }
    const std::vector<S> image = forward<S>(scene, s, tangents, true);
    std::vector<S> adjoint;
    for (size_t i = 0; i < image.size(); ++i) adjoint.push_back(S(normal(random)));
    RenderStats stats;
    const auto gradients = reverse<S>(scene, s, adjoint, true, &stats);
    CHECK(stats.non_finite == 0);
    double by_image = 0, by_parameters = 0, size = 0;
    for (size_t i = 0; i < image.size(); ++i)
        by_image += double(image[i]) * double(adjoint[i]), size += std::abs(double(image[i]));
    for (size_t k = 0; k < tangents.size(); ++k)
        for (size_t i = 0; i < tangents[k].size(); ++i)
            by_parameters += double(gradients[k][i]) * double(tangents[k][i]);
    CHECK(size > 0);
    CHECK_NEAR(by_image, by_parameters, tolerance * (1 + size));
}

}  // namespace

TR_TEST(light_forward_and_reverse_mode_agree) {
    load_embree(embree_path());
    for (bool meter : {false, true}) {
#define TR_COMPARE(S) compare_modes<S>(meter);
        TR_FOR_EACH_PRECISION(TR_COMPARE)
    }
}

TR_TEST(light_images_are_the_same_for_any_threads_and_crop) {
    load_embree(embree_path());
    SceneBuilder<float> b(3);
    add_scene(b, false);
    SceneData<float> scene;
    b.build(scene);
    Settings s;
    s.spp = 40;
    s.filter = Filter(FilterKind::Tent, 1.3);
    std::vector<float> one = light(scene, s);
    s.threads = 5;
    CHECK((one == light(scene, s)));
    RenderCall<float> call = make_call(scene, s);
    call.crop = {3, 2, 9, 11};
    std::vector<float> part(6 * 9 * 3);
    trace_light(call, part.data());
    bool same = true;
    for (int y = 0; y < 6; ++y)
        for (int x = 0; x < 27; ++x)
            same = same && part[size_t(y * 27 + x)] == one[size_t((y + 3) * s.width * 3 + 6 + x)];
    CHECK(same);
}

#if !TR_HAS_PACKETS
namespace {

// A scene that the CPU walks through a device's tree of.
struct OnDevice {
    SceneBuilder<float> builder{3};
    SceneData<float> data;
    SceneRays rays;
    TreeWalk walk;
    Settings settings;

    explicit OnDevice(bool meter) {
        load_embree(embree_path());
        add_scene(builder, meter);
        builder.build(data);
        rays.update(data.view(), 1);
        walk.tree = rays.tree().view();
        data.walk(&walk);
        settings.spp = 30, settings.max_depth = 5, settings.filter = Filter(FilterKind::Gaussian, 0.5);
    }
    // What f(paths, tree) does with batches of so many paths.
    template <class Do>
    void run(size_t batch, const EmulatedOptions &options, Do &&f) const {
        const auto device = make_emulated(options);
        DeviceTree copied(*device);
        copied.set(rays.tree());
        DevicePaths<float> paths(*device, batch * DevicePaths<float>::bytes_per_path({false, true}));
        f(paths, copied.view());
    }
    std::vector<float> image(size_t batch, const EmulatedOptions &options = {}) const {
        std::vector<float> found(n_values(data, settings));
        const RenderCall<float> call = make_call(data, settings);
        run(batch, options, [&](DevicePaths<float> &paths, const TreeView &tree) {
            paths.light(call, data, tree, found.data(), nullptr);
        });
        return found;
    }
    std::vector<float> tangent(size_t batch, const std::vector<std::vector<float>> &tangents) const {
        std::vector<float> found(n_values(data, settings));
        const RenderCall<float> call = make_call(data, settings);
        const ForwardCall<float> d(data, call.config, true, addresses_of(tangents));
        run(batch, {}, [&](DevicePaths<float> &paths, const TreeView &tree) {
            paths.forward_light(call, data, tree, d.call, found.data());
        });
        return found;
    }
    std::vector<std::vector<float>> gradient(size_t batch, const std::vector<float> &adjoint, bool fixed,
                                             const EmulatedOptions &options = {}) const {
        std::vector<std::vector<float>> found;
        for (int64_t n : data.layout().slot_sizes) found.emplace_back(size_t(n), 0.f);
        const RenderCall<float> call = make_call(data, settings);
        DerivativeCall<float> d = reverse_call(data, call.config, true, addresses_of(found));
        d.adjoint = adjoint.data(), d.fixed_sums = fixed;
        run(batch, options, [&](DevicePaths<float> &paths, const TreeView &tree) {
            CHECK(paths.reverse_light(call, data, tree, d).non_finite == 0);
        });
        add_gradients(data, d, addresses_of(found), 2);
        return found;
    }
};

// Relative to the largest number.
void check_close(const std::vector<float> &found, const std::vector<float> &expected) {
    float largest = 0;
    for (const float x : expected) largest = std::max(largest, std::abs(x));
    for (size_t i = 0; i < expected.size(); ++i) CHECK(std::abs(found[i] - expected[i]) <= 1e-4f * largest);
}

}  // namespace

TR_TEST(light_of_the_device_is_that_of_the_cpu_in_any_batches) {
    for (const bool meter : {false, true}) {
        const OnDevice scene(meter);
        const Settings &s = scene.settings;
        std::mt19937 random(2);
        std::normal_distribution<float> normal;
        std::vector<float> adjoint(n_values(scene.data, s));
        for (float &x : adjoint) x = normal(random);
        std::vector<std::vector<float>> tangents;
        for (const int64_t n : scene.data.layout().slot_sizes) {
            tangents.emplace_back();
            for (int64_t i = 0; i < n; ++i) tangents.back().push_back(n == 16 && i >= 12 ? 0.f : normal(random));
        }
        const std::vector<float> image = light(scene.data, s), tangent = forward(scene.data, s, tangents, true);
        const auto gradient = reverse(scene.data, s, adjoint, true);
        CHECK(*std::max_element(image.begin(), image.end()) > 0.1f);
        for (const size_t batch : {size_t(1000), size_t(1) << 20}) {
            check_close(scene.image(batch), image);
            check_close(scene.tangent(batch, tangents), tangent);
            const auto found = scene.gradient(batch, adjoint, false);
            for (size_t k = 0; k < gradient.size(); ++k) check_close(found[k], gradient[k]);
        }
    }
}

TR_TEST(light_of_the_device_does_not_depend_on_any_order) {
    const OnDevice scene(false);
    const std::vector<float> adjoint(n_values(scene.data, scene.settings), 1.f);
    const std::vector<float> image = scene.image(3000);
    const auto gradient = scene.gradient(3000, adjoint, true);
    for (const int threads : {1, 5}) {
        EmulatedOptions options;
        options.threads = threads, options.seed = uint64_t(threads) + 7;
        CHECK(scene.image(3000, options) == image);
        CHECK(scene.gradient(3000, adjoint, true, options) == gradient);
    }
}
#endif

}  // namespace tr::testing
