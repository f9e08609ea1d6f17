// Whole renders: furnaces with known answers, every model at once, derivatives in both modes, bad input.
#include "accel/embree_library.h"
#include "scene_builder.h"

namespace tr::testing {

static void need_embree() { load_embree(embree_path()); }

template <class S>
static double mean(const std::vector<S> &numbers) {
    double sum = 0;
    for (S x : numbers) sum += double(x);
    return sum / double(numbers.size());
}

template <class S>
static bool all_finite(const std::vector<S> &numbers) {
    for (S x : numbers)
        if (!std::isfinite(x)) return false;
    return true;
}

// Inside a sphere of albedo a that emits 1, paths of d vertices see 1 + a + ... + a^(d-1), every sample of them.
template <class S>
static void check_furnace(int channels) {
    const S albedo = S(0.6);
    SceneBuilder<S> b(channels);
    int64_t reflectance = b.color(albedo, albedo, albedo), radiance = b.color(1, 1, 1);
    int64_t texture = b.add("texture", "constant", {{"value", reflectance}});
    int64_t light = b.add("texture", "constant", {{"value", radiance}});
    b.add("shape", "sphere",
          {{"to_world", b.matrix(0, 0, 0)},
           {"flip_normals", 1},
           {"bsdf", b.add("bsdf", "diffuse", {{"reflectance", texture}})},
           {"emitter", b.add("emitter", "area", {{"radiance", light}})}});
    b.camera(S(0.1), S(-0.2), S(0.1), 60);
    SceneData<S> scene;
    b.build(scene);
    Settings s;
    s.max_depth = 4;
    s.spp = 128;
    double value = 0, derivative = 0, power = 1;
    for (int k = 0; k < s.max_depth; ++k) {
        value += power;
        derivative += k ? k * power / albedo : 0;
        power *= albedo;
    }
    RenderStats stats;
    auto image = render(scene, s, &stats);
    CHECK_NEAR(mean(image), value, 0.02 * value);
    CHECK(stats.non_finite == 0 && stats.closest_rays > 0 && !stats.interrupted);

    std::vector<S> adjoint(image.size(), S(1) / S(image.size()) * S(channels));
    auto gradients = reverse<S>(scene, s, adjoint);
    for (int c = 0; c < channels; ++c) {
        CHECK_NEAR(gradients[size_t(reflectance)][size_t(c)], derivative, 0.05 * derivative);
        CHECK_NEAR(gradients[size_t(radiance)][size_t(c)], value, 0.02 * value);
    }
}

// In every precision of the module: Do(S) for each.
#define TR_TEST_PRECISIONS(name, Check) \
    TR_TEST(name) {                     \
        need_embree();                  \
        TR_FOR_EACH_PRECISION(Check)    \
    }
#define TR_CHECK_FURNACE(S) check_furnace<S>(3), check_furnace<S>(1);
TR_TEST_PRECISIONS(furnaces, TR_CHECK_FURNACE)

// Every model of the build, in several combinations, before the camera.
template <class S>
static void add_everything(SceneBuilder<S> &b) {
    const int64_t C = b.channels;
    std::vector<int64_t> bsdfs, textures;
    for (int64_t filter : {0, 1})
        for (int64_t wrap : {0, 1, 2})
            textures.push_back(b.add("texture", "bitmap",
                                     {{"data", b.random({3 + wrap, 5, wrap == 1 ? 1 : C}, S(0.2), S(0.8))},
                                      {"to_uv", b.param({3, 3}, {2, S(0.3), S(-0.4), S(-0.2), 3, S(0.7), 0, 0, 1})},
                                      {"filter_type", filter},
                                      {"wrap_mode", wrap}}));
    textures.push_back(b.add("texture", "checkerboard",
                             {{"color0", b.constant(S(0.2), S(0.5), S(0.3))},
                              {"color1", textures[0]},
                              {"to_uv", b.param({3, 3}, {4, 0, 0, 0, 4, 0, 0, 0, 1})}}));
    int64_t attribute_vertex = b.add("texture", "mesh_attribute", {{"name", 0}});
    int64_t attribute_face = b.add("texture", "mesh_attribute", {{"name", 1}, {"scale", b.number(S(0.5))}});
    textures.push_back(attribute_vertex);
    textures.push_back(attribute_face);
    for (int64_t t : textures) {
        int64_t diffuse = b.add("bsdf", "diffuse", {{"reflectance", t}});
        bsdfs.push_back(diffuse);
        bsdfs.push_back(b.add("bsdf", "twosided", {{"brdf_0", diffuse}}));
    }
    int64_t conductor = b.add("bsdf", "conductor",
                              {{"eta", b.constant(S(0.2), S(0.4), S(1.1))}, {"k", b.constant(S(3.9), S(2.4), S(2.2))}});
    bsdfs.push_back(conductor);
    bsdfs.push_back(b.add("bsdf", "twosided", {{"brdf_0", conductor}, {"brdf_1", bsdfs[0]}}));
    bsdfs.push_back(b.add("bsdf", "dielectric", {{"eta", b.number(S(1.5))}}));
    bsdfs.push_back(b.add("bsdf", "dielectric", {{"eta", b.number(1)}, {"specular_transmittance", textures[1]}}));
    bsdfs.push_back(b.add("bsdf", "roughdielectric", {{"eta", b.number(S(1.3))}, {"distribution", 0}}));
    bsdfs.push_back(
        b.add("bsdf", "roughdielectric", {{"alpha", b.constant(S(0.3), S(0.3), S(0.3))}, {"distribution", 1}}));
    bsdfs.push_back(b.add("bsdf", "null"));

    int64_t cube = b.faces(
        {0, 1, 2, 2, 1, 3, 4, 6, 5, 5, 6, 7, 0, 4, 1, 1, 4, 5, 2, 3, 6, 6, 3, 7, 0, 2, 4, 4, 2, 6, 1, 5, 3, 3, 5, 7});
    int64_t degenerate = b.faces({0, 0, 1, 1, 2, 3, 4, 4, 4});
    std::mt19937 generator(3);
    std::uniform_real_distribution<S> uniform(-2, 2);
    int64_t n = 0;
    for (int64_t bsdf : bsdfs) {
        S x = uniform(generator), y = uniform(generator), z = uniform(generator);
        std::vector<S> corners;
        for (int i = 0; i < 8; ++i)
            for (int k = 0; k < 3; ++k) corners.push_back((k == 0 ? x : k == 1 ? y : z) + S(0.5) * S((i >> k) & 1));
        Fields fields{
            {"vertices", b.param({8, 3}, corners)}, {"faces", n % 5 == 4 ? degenerate : cube}, {"bsdf", bsdf}};
        if (n % 2) fields.push_back({"normals", b.random({8, 3}, -1, 1)});
        if (n % 3) fields.push_back({"texcoords", b.random({8, 2}, -2, 3)});
        if (n % 7 == 3)
            fields.push_back({"emitter", b.add("emitter", "area", {{"radiance", textures[size_t(n) % 6]}})});
        int64_t shape = b.add("shape", "mesh", fields);
        b.add("attribute", "attribute", {{"name", 0}, {"shape", shape}, {"data", b.random({8, C}, S(0.1), S(0.9))}});
        if (n % 5 != 4)
            b.add("attribute", "attribute",
                  {{"name", 1}, {"shape", shape}, {"data", b.random({12, 1}, S(0.1), S(0.9))}, {"per_face", 1}});
        const char *type = n % 3 == 0 ? "sphere" : n % 3 == 1 ? "disk" : "rectangle";
        Fields other{{"to_world", b.matrix(uniform(generator), uniform(generator), uniform(generator), S(0.4))},
                     {"bsdf", bsdf},
                     {"flip_normals", n % 2}};
        if (n % 4 == 0) other.push_back({"emitter", b.add("emitter", "area", {{"radiance", b.constant(2, 1, 1)}})});
        b.add("shape", type, other);
        ++n;
    }
    b.add("emitter", "point", {{"intensity", b.color(3, 2, 1)}, {"position", b.param({3}, {S(0.3), 2, -3})}});
    b.add("emitter", "envmap",
          {{"data", b.random({4, 6, C}, 0, 2)}, {"scale", b.number(S(0.7))}, {"to_world", b.matrix(0, 0, 0)}});
    b.camera(0, 0, -6, 50);
}

template <class S>
static void check_everything(int channels) {
    SceneBuilder<S> b(channels);
    add_everything(b);
    SceneData<S> scene;
    b.build(scene);
    Settings s;
    for (FilterKind filter : {FilterKind::Box, FilterKind::Tent, FilterKind::Gaussian}) {
        s.filter = Filter(filter, filter == FilterKind::Tent ? 1 : 0.5);
        s.hide_emitters = filter == FilterKind::Tent;
        RenderStats stats;
        auto image = render(scene, s, &stats);
        CHECK(all_finite(image));
        CHECK(mean(image) > 0.05);
        CHECK(stats.non_finite == 0);
        s.threads = 1;
        CHECK((render(scene, s) == image));
        s.threads = 2;

        std::vector<std::vector<S>> tangents;
        std::mt19937 generator(5);
        std::uniform_real_distribution<S> uniform(-1, 1);
        for (const auto &v : b.values) {
            tangents.emplace_back();
            for (size_t i = 0; i < v.size(); ++i) tangents.back().push_back(uniform(generator));
        }
        std::vector<S> adjoint;
        for (size_t i = 0; i < image.size(); ++i) adjoint.push_back(uniform(generator));
        auto derivative = forward<S>(scene, s, tangents);
        auto gradients = reverse<S>(scene, s, adjoint);
        double left = 0, right = 0, size = 0;
        for (size_t i = 0; i < image.size(); ++i) {
            left += double(derivative[i]) * double(adjoint[i]);
            size += std::abs(double(derivative[i]) * double(adjoint[i]));
        }
        for (size_t k = 0; k < tangents.size(); ++k) {
            CHECK(all_finite(gradients[k]));
            for (size_t i = 0; i < tangents[k].size(); ++i) right += double(tangents[k][i]) * double(gradients[k][i]);
        }
        CHECK(size > 0);
        CHECK_NEAR(left, right, (sizeof(S) == 4 ? 1e-4 : 1e-10) * size);
    }
}

#define TR_CHECK_EVERYTHING(S) check_everything<S>(3);
#define TR_CHECK_EVERYTHING_MONO(S) check_everything<S>(1);
TR_TEST_PRECISIONS(every_model_rgb, TR_CHECK_EVERYTHING)
TR_TEST_PRECISIONS(every_model_mono, TR_CHECK_EVERYTHING_MONO)

TR_TEST(an_empty_scene_is_black) {
    need_embree();
    SceneBuilder<float> b(3);
    b.camera(0, 0, 0, 40);
    SceneData<float> scene;
    b.build(scene);
    for (float x : render(scene, Settings())) CHECK(x == 0);
}

TR_TEST(films_of_awkward_sizes) {
    need_embree();
    SceneBuilder<float> b(3);
    b.add("emitter", "constant", {{"radiance", b.color(1, 2, 3)}});
    b.add("shape", "sphere", {{"to_world", b.matrix(0, 0, 3)}, {"bsdf", b.diffuse(1, 1, 1)}});
    b.camera(0, 0, 0, 60);
    SceneData<float> scene;
    b.build(scene);
    for (auto [height, width, spp] : {std::array<int, 3>{1, 1, 1}, {1, 37, 3}, {65, 3, 1}, {17, 33, 2}, {2, 2, 1000}}) {
        Settings s;
        s.height = height, s.width = width, s.spp = spp, s.max_depth = -1;
        auto image = render(scene, s);
        CHECK(all_finite(image));
        CHECK(mean(image) > 1);
    }
}

TR_TEST(max_depth_zero_and_one) {
    need_embree();
    SceneBuilder<float> b(1);
    b.add("emitter", "constant", {{"radiance", b.color(1, 1, 1)}});
    b.add("shape", "sphere", {{"to_world", b.matrix(0, 0, 3)}, {"bsdf", b.diffuse(1, 1, 1)}});
    b.camera(0, 0, 0, 10);  // sees nothing but the sphere
    SceneData<float> scene;
    b.build(scene);
    for (int depth : {0, 1}) {
        Settings s;
        s.max_depth = depth;
        for (float x : render(scene, s)) CHECK(x == 0);
    }
}

TR_TEST(an_interruption_stops) {
    need_embree();
    SceneBuilder<float> b(3);
    add_everything(b);
    SceneData<float> scene;
    b.build(scene);
    Settings s;
    s.spp = 1 << 20;
    RenderCall<float> call = make_call(scene, s);
    call.interrupted = [](double) { return true; };
    std::vector<float> image(size_t(s.height * s.width * 3), 7.0f);
    FilmSums sums;
    RenderOutput<float> out{{image.data()}};
    out.sums = &sums;
    CHECK((render_primal<float>(call, out).interrupted));
    CHECK(sums.spp == 0 && sums.sum.empty() && image == std::vector<float>(image.size(), 7.0f));
}

TR_TEST(parts_add_up) {
    need_embree();
    SceneBuilder<float> b(3);
    add_everything(b);
    SceneData<float> scene;
    b.build(scene);
    Settings s;
    s.spp = 12;
    RenderCall<float> call = make_call(scene, s);
    std::vector<float> whole(size_t(s.height * s.width * 3)), parts(whole.size());
    render_primal<float>(call, {{whole.data()}});
    FilmSums sums;
    RenderOutput<float> out{{parts.data()}};
    out.sums = &sums;
    for (int64_t begin : {0, 5, 6}) {
        call.sample_offset = begin;
        call.spp = (begin == 0 ? 5 : begin == 5 ? 6 : 12) - begin;
        render_primal<float>(call, out);
        CHECK(sums.spp == call.sample_offset + call.spp);
    }
    for (size_t i = 0; i < whole.size(); ++i) CHECK_NEAR(parts[i], whole[i], 1e-6 + 1e-6 * double(whole[i]));
}

// ------------------------------------------------------------------------------------------------------- bad input

TR_TEST(bad_structure_is_refused) {
    need_embree();
    auto refused = [](auto spoil, const char *words) {
        SceneBuilder<float> b(3);
        int64_t faces = b.faces({0, 1, 2});
        int64_t vertices = b.param({3, 3}, {0, 0, 0, 1, 0, 0, 0, 1, 0});
        b.add("shape", "mesh", {{"vertices", vertices}, {"faces", faces}, {"bsdf", b.diffuse(1, 1, 1)}});
        b.camera(0, 0, -2, 40);
        spoil(b);
        SceneData<float> scene;
        CHECK_THROWS(b.build(scene), std::invalid_argument, words);
    };
    using B = SceneBuilder<float>;
    refused([](B &b) { b.indices[0][1] = 3; }, "vertex indices from 0 to 2");
    refused([](B &b) { b.indices[0][2] = -1; }, "vertex indices from 0 to 2");
    refused([](B &b) { b.indices[0].clear(); }, "at least one face");
    refused([](B &b) { b.objects["shape"][0].ints[0] = 99; }, "parameter");
    refused([](B &b) { b.objects["shape"][0].ints[1] = 7; }, "index array");
    refused([](B &b) { b.objects["shape"][0].ints.pop_back(); }, "fields");
    refused([](B &b) { b.objects["shape"][0].type = "teapot"; }, "teapot");
    refused([](B &b) { b.objects["potato"]; }, "potato");
    refused([](B &b) { b.objects["bsdf"][0].ints[0] = 5; }, "texture");
    refused([](B &b) { b.values[0][4] = NAN; }, "finite");
    refused([](B &b) { b.values[1][0] = INFINITY; }, "finite");
    refused([](B &b) { b.shapes[0] = {9}; }, "(V, 3)");
    refused([](B &b) { b.shapes[0] = {3, 2}; }, "(V, 3)");
    refused([](B &b) { b.add("texture", "bitmap", {{"data", b.param({0, 4, 3}, {})}}); }, "not empty");
    refused([](B &b) { b.add("texture", "bitmap", {{"data", b.random({4, 4, 2}, 0, 1)}}); }, "1 or 3");
    refused([](B &b) { b.add("texture", "checkerboard", {{"color0", int64_t(b.objects["texture"].size())}}); },
            "circular");
    refused([](B &b) { b.add("emitter", "area"); }, "shape");
    refused([](B &b) { b.add("emitter", "constant"), b.add("emitter", "constant"); }, "one environment");
    refused([](B &b) { b.add("shape", "sphere", {{"to_world", b.matrix(0, 0, 0, 0)}, {"bsdf", 0}}); }, "to_world");
}

TR_TEST(a_library_that_is_not_embree_is_refused) {
    need_embree();
    CHECK_THROWS(load_embree("/nonexistent/libembree4.so"), std::runtime_error, "cannot be loaded");
    CHECK_THROWS(load_embree(__FILE__), std::runtime_error, "cannot be loaded");
    need_embree();  // the one before still works
}

}  // namespace tr::testing
