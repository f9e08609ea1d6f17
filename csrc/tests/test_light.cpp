// Light tracing: forward mode against reverse mode, and images that do not depend on threads or on what is cropped.
#include <random>

#include "accel/embree_library.h"
#include "host/dependence.h"
#include "scene_builder.h"

namespace tr::testing {

namespace {

// A beam, an area light, lights without a surface and a surrounding shine through a glass ball onto a wall; the camera,
// or a meter on the wall, looks.
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
    const std::vector<int64_t> &sizes = scene.layout().slot_sizes;
    std::vector<std::vector<S>> tangents, gradients;
    std::vector<const S *> addresses;
    for (int64_t n : sizes) {
        tangents.emplace_back();
        for (int64_t i = 0; i < n; ++i) tangents.back().push_back(n == 16 && i >= 12 ? S(0) : S(normal(random)));
        gradients.emplace_back(size_t(n), S(0));
    }
    for (const auto &t : tangents) addresses.push_back(t.data());

    Dependence depends(scene.layout(), std::vector<bool>(sizes.size(), true));
    DerivativeCall<S> d = make_derivative(scene);
    d.wanted = {true, true, true, true, !meter, {}};
    for (size_t i = 0; i < scene.layout().shapes.size(); ++i) d.shape_wanted.push_back(depends.shape(i));
    d.geometry_sizes = depends.geometry_sizes();
    d.matrices = uint32_t(scene.n_constants());
    d.n_constants = scene.n_constants() + 12 * scene.layout().shapes.size();

    DerivativeCall<S> forward = d;
    GeometryArrays<S> arrays;
    std::vector<TensorView<S>> tensors;
    scene.fill_values(addresses, arrays.constants, tensors);
    scene.fill_geometry(addresses, d.geometry_sizes, arrays);
    auto table = [](const std::vector<S> &v) { return v.empty() ? nullptr : v.data(); };
    forward.tangent = {arrays.constants.data(), tensors.data()};
    forward.geometry_tangent = {table(arrays.positions), table(arrays.normals), table(arrays.texcoords), d.matrices,
                                d.shape_wanted.data()};
    size_t n = size_t(s.height * s.width * 3);
    std::vector<S> image(n), adjoint(n);
    trace_light_forward<S>(make_call(scene, s), forward, image.data());
    for (S &x : adjoint) x = S(normal(random));

    d.adjoint = adjoint.data();
    d.gradients.assign(sizes.size(), nullptr);
    RenderStats stats = trace_light_reverse<S>(make_call(scene, s), d);
    CHECK(stats.non_finite == 0);
    scene.spread_geometry(d.sums, d.gradients);
    double by_image = 0, by_parameters = 0, size = 0;
    for (size_t i = 0; i < n; ++i)
        by_image += double(image[i]) * double(adjoint[i]), size += std::abs(double(image[i]));
    for (const ConstantEntry &e : scene.constant_entries())
        for (int i = 0; i < e.stored; ++i)
            by_parameters +=
                d.sums.constants[size_t(e.offset + i)] * double(tangents[size_t(e.slot)][size_t(e.count == 1 ? 0 : i)]);
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
    trace_light(call, true, part.data());
    bool same = true;
    for (int y = 0; y < 6; ++y)
        for (int x = 0; x < 27; ++x)
            same = same && part[size_t(y * 27 + x)] == one[size_t((y + 3) * s.width * 3 + 6 + x)];
    CHECK(same);
}

}  // namespace tr::testing
