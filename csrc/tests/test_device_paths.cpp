// The path tracer on the emulated device: images are those of the CPU, whatever the batches.
#include "accel/embree_library.h"
#include "device/emulated.h"
#include "device/scene_rays.h"
#include "scene_builder.h"

#if !TR_HAS_PACKETS
#include "device/device_paths.h"

namespace tr::testing {

namespace {

// A glossy and a diffuse ball in a sky, over a floor with a lamp above it.
void build_balls(SceneBuilder<float> &builder) {
    const int64_t gray = builder.diffuse(0.5f, 0.4f, 0.6f);
    const int64_t metal = builder.add("bsdf", "roughconductor", {{"alpha", builder.constant(0.2f, 0.2f, 0.2f)}});
    builder.add("shape", "sphere", {{"to_world", builder.matrix(-0.6f, 0, 4, 0.5f)}, {"bsdf", gray}});
    builder.add("shape", "sphere", {{"to_world", builder.matrix(0.6f, 0, 4, 0.5f)}, {"bsdf", metal}});
    const int64_t lamp = builder.add("emitter", "area", {{"radiance", builder.constant(5, 4, 3)}});
    builder.add(
        "shape", "rectangle",
        {{"to_world", builder.matrix(0, 0.2f, 6, 0.7f)}, {"flip_normals", 1}, {"bsdf", gray}, {"emitter", lamp}});
    builder.add("emitter", "constant", {{"radiance", builder.color(0.5f, 0.6f, 0.9f)}});
    builder.camera(0, 0, 0, 40);
}

struct Image {
    std::vector<float> image, alpha, variance, second_moment;
    RenderStats stats;

    explicit Image(size_t n) : image(3 * n), alpha(n), variance(3 * n), second_moment(3 * n) {}
    RenderOutput<float> out() { return {image.data(), alpha.data(), variance.data(), second_moment.data()}; }
    bool operator==(const Image &o) const {
        return image == o.image && alpha == o.alpha && variance == o.variance && second_moment == o.second_moment;
    }
};

struct Balls {
    SceneBuilder<float> builder{3};
    SceneData<float> data;
    SceneRays rays;
    TreeView tree;

    Balls() {
        load_embree(embree_path());
        build_balls(builder);
        builder.build(data);
        rays.update(data.view(), 1);
        tree = rays.tree().view();
        data.walk(&tree);
    }
    Image on_cpu(const RenderCall<float> &call, size_t n) const {
        Image r(n);
        r.stats = render_primal<float>(call, r.out());
        return r;
    }
    // Batches of so many paths.
    Image on_device(const RenderCall<float> &call, size_t n, size_t batch) const {
        const auto device = make_emulated();
        DeviceTree copied(*device);
        copied.set(rays.tree());
        DevicePaths paths(*device, batch * DevicePaths::bytes_per_path());
        Image r(n);
        r.stats = paths.render(call, data, copied.view(), r.out());
        return r;
    }
};

Settings small(Filter filter) {
    Settings s;
    s.height = 18, s.width = 20, s.spp = 70, s.filter = filter;  // four tiles, and two chunks of samples each
    return s;
}

}  // namespace

// A batch is smaller than a unit of the film (256 pixels, 64 samples), or has several of them.
TR_TEST(images_of_the_device_are_those_of_the_cpu_in_any_batches) {
    Balls balls;
    for (const Filter &filter : {Filter(), Filter(FilterKind::Gaussian, 0.5)}) {
        const Settings s = small(filter);
        const RenderCall<float> call = make_call(balls.data, s);
        const Image expected = balls.on_cpu(call, 18 * 20);
        CHECK(*std::max_element(expected.image.begin(), expected.image.end()) > 1);
        for (const size_t batch : {size_t(1000), size_t(17000), size_t(1) << 20}) {
            const Image found = balls.on_device(call, 18 * 20, batch);
            CHECK(found == expected);
            CHECK(found.stats.closest_rays == expected.stats.closest_rays);
            CHECK(found.stats.shadow_rays == expected.stats.shadow_rays);
        }
    }
}

}  // namespace tr::testing
#endif
