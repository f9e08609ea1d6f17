// The path tracer on the emulated device: images are those of the CPU, whatever the batches.
#include <algorithm>

#include "accel/embree_library.h"
#include "device/emulated.h"
#include "device/scene_rays.h"
#include "device/tree_walk.h"
#include "kernel_resources.h"
#include "scene_builder.h"

#if !TR_HAS_PACKETS
#include "cpu/derivative_call.h"
#include "cpu/device_paths.h"
#include "device/light_kernels.h"

namespace tr::testing {

namespace {

// A glossy and a diffuse ball in a sky, over a floor with a lamp above it.
template <class S>
void build_balls(SceneBuilder<S> &builder) {
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

// A cloud before them that scatters forwards, glows, and has three densities of colours; its boundary does not scatter.
template <class S>
void build_cloud(SceneBuilder<S> &builder) {
    const auto volume = [&](S low, S high) {
        return builder.add(
            "volume", "gridvolume",
            {{"data", builder.random({3, 4, 2, 3}, low, high)}, {"to_world", builder.matrix(-1, -0.8f, 2.5f, 2)}});
    };
    const int64_t phase = builder.add("phase", "hg", {{"g", builder.number(0.4f)}});
    const int64_t medium = builder.add("medium", "heterogeneous",
                                       {{"sigma_t", volume(0, 2)},
                                        {"albedo", volume(0.5f, 1)},
                                        {"emission", volume(0, 0.3f)},
                                        {"scale", builder.number(1.5f)},
                                        {"phase", phase}});
    builder.add("shape", "sphere",
                {{"to_world", builder.matrix(0, 0.1f, 3.5f, 0.9f)},
                 {"bsdf", builder.add("bsdf", "null")},
                 {"interior", medium}});
}

template <class S>
struct Image {
    std::vector<S> image, alpha, variance, second_moment;
    RenderStats stats;

    explicit Image(size_t n) : image(3 * n), alpha(n), variance(3 * n), second_moment(3 * n) {}
    RenderOutput<S> out() { return {{image.data(), alpha.data(), variance.data(), second_moment.data()}}; }
    bool operator==(const Image &o) const {
        return image == o.image && alpha == o.alpha && variance == o.variance && second_moment == o.second_moment;
    }
};

template <class S>
struct Balls {
    SceneBuilder<S> builder{3};
    SceneData<S> data;
    SceneRays rays;
    TreeWalk walk;

    explicit Balls(bool cloud = false) {
        load_embree(embree_path());
        build_balls(builder);
        if (cloud) build_cloud(builder);
        builder.build(data);
        rays.update(data.view(), 1);
        walk.tree = rays.tree().view();
        data.walk(&walk);
    }
    Image<S> on_cpu(const RenderCall<S> &call, size_t n) const {
        Image<S> r(n);
        r.stats = render_primal<S>(call, r.out());
        return r;
    }
    // Batches of so many paths.
    Image<S> on_device(const RenderCall<S> &call, size_t n, size_t batch) const {
        const auto device = make_emulated();
        DeviceTree copied(*device);
        copied.set(rays.tree());
        DevicePaths<S> paths(*device, batch * DevicePaths<S>::bytes_per_path({call.config.volumetric, false}));
        Image<S> r(n);
        r.stats = paths.render(call, data, copied.view(), r.out());
        return r;
    }
};

// The derivative of the sum of an image by all parameters: the numbers of the slots one after the other. `adaptive`: of
// numbers that pixels have more and less of.
template <class S>
struct Gradient {
    std::vector<std::vector<S>> of_slots;
    RenderStats stats;

    template <class Reverse>
    Gradient(const Balls<S> &balls, const RenderCall<S> &call, Reverse &&reverse, bool fixed_sums = false,
             bool adaptive = false) {
        std::vector<S> weights(size_t(call.film_height * call.film_width) * 3, S(1));
        for (size_t i = 0; i < weights.size() && adaptive; ++i) weights[i] = S(i % 21) / 10;
        for (const auto &values : balls.builder.values) of_slots.emplace_back(values.size(), S(0));
        DerivativeCall<S> d = reverse_call(balls.data, call.config, false, addresses_of(of_slots));
        d.adjoint = weights.data(), d.fixed_sums = fixed_sums, d.adaptive = adaptive;
        stats = reverse(call, d);
        add_gradients(balls.data, d, addresses_of(of_slots), 2);
    }
};

// Relative to the largest number of each slot.
template <class S>
void check_close(const Gradient<S> &found, const Gradient<S> &expected) {
    constexpr S Close = sizeof(S) == sizeof(float) ? S(1e-4) : S(1e-12);
    for (size_t i = 0; i < expected.of_slots.size(); ++i) {
        S largest = 0;
        for (const S a : expected.of_slots[i]) largest = std::max(largest, std::abs(a));
        for (size_t k = 0; k < expected.of_slots[i].size(); ++k)
            CHECK(std::abs(found.of_slots[i][k] - expected.of_slots[i][k]) <= Close * largest);
    }
}

Settings small(Filter filter) {
    Settings s;
    s.height = 18, s.width = 20, s.spp = 70, s.filter = filter;  // four tiles, and two chunks of samples each
    return s;
}

}  // namespace

// A batch is smaller than a unit of the film (256 pixels, 64 samples), or has several of them.
template <class S>
static void check_images(bool cloud, const std::vector<Filter> &filters, const std::vector<size_t> &batches) {
    const Balls<S> balls(cloud);
    for (const Filter &filter : filters) {
        RenderCall<S> call = make_call(balls.data, small(filter));
        call.config.volumetric = cloud;
        const Image expected = balls.on_cpu(call, 18 * 20);
        CHECK(*std::max_element(expected.image.begin(), expected.image.end()) > 1);
        CHECK(cloud == (expected.stats.collisions > 10000));
        for (const size_t batch : batches) {
            const Image found = balls.on_device(call, 18 * 20, batch);
            CHECK(found == expected);
            CHECK(found.stats.closest_rays == expected.stats.closest_rays);
            CHECK(found.stats.shadow_rays == expected.stats.shadow_rays);
            CHECK(found.stats.collisions == expected.stats.collisions);
        }
    }
}

TR_TEST(images_of_the_device_are_those_of_the_cpu_in_any_batches) {
    check_images<float>(false, {Filter(), Filter(FilterKind::Gaussian, 0.5)}, {1000, 17000, size_t(1) << 20});
    check_images<double>(false, {Filter(FilterKind::Gaussian, 0.5)}, {17000});
}

TR_TEST(images_through_media_are_those_of_the_cpu_in_any_batches) {
    check_images<float>(true, {Filter()}, {1000, size_t(1) << 20});
    check_images<double>(true, {Filter()}, {9000});
}

// ... gradients but for the order of sums, to which the emulated device has one thread add.
// `reach`: what the filter's is, as it is not asked here: a compiler took this for one who does not read it.
template <class S>
static void check_gradients(const Balls<S> &balls, const Filter &filter, int reach, bool adaptive, bool volumetric,
                            const std::vector<size_t> &batches) {
    RenderCall<S> call = make_call(balls.data, small(filter));
    CHECK(call.filter.reach() == reach);
    call.config.volumetric = volumetric;
    const auto on_cpu = [](const RenderCall<S> &c, DerivativeCall<S> &d) { return render_reverse<S>(c, d); };
    const Gradient expected(balls, call, on_cpu, false, adaptive);
    for (const size_t batch : batches) {
        const auto device = make_emulated();
        DeviceTree copied(*device);
        copied.set(balls.rays.tree());
        DevicePaths<S> paths(*device, batch * DevicePaths<S>::bytes_per_path({volumetric, false}));
        const auto there = [&](const RenderCall<S> &c, DerivativeCall<S> &d) {
            return paths.reverse(c, balls.data, copied.view(), d);
        };
        const Gradient found(balls, call, there, false, adaptive);
        CHECK(found.stats.closest_rays == expected.stats.closest_rays);
        CHECK(found.stats.shadow_rays == expected.stats.shadow_rays);
        check_close(found, expected);
        CHECK(std::abs(expected.of_slots[0][0]) > 1);
    }
}

TR_TEST(gradients_of_the_device_are_those_of_the_cpu_in_any_batches) {
    const Balls<float> balls, in_cloud(true);
    const Filter gaussian(FilterKind::Gaussian, 0.5);
    const std::vector<size_t> batches{1000, size_t(1) << 20};
    for (const bool adaptive : {false, true}) {
        check_gradients(balls, Filter(), 0, adaptive, false, batches);
        check_gradients(balls, gaussian, 2, adaptive, false, batches);
    }
    check_gradients(in_cloud, Filter(), 0, false, true, batches);
    check_gradients(Balls<double>(), gaussian, 2, true, false, {17000});
    check_gradients(Balls<double>(true), Filter(), 0, false, true, {9000});
}

// ... but sums of whole numbers are the same, bit for bit, in any order, of however many threads.
template <class S>
static void check_fixed_sums(const std::vector<int> &all_threads) {
    const Balls<S> balls;
    const RenderCall<S> call = make_call(balls.data, small(Filter()));
    const Gradient expected(balls, call,
                            [](const RenderCall<S> &c, DerivativeCall<S> &d) { return render_reverse<S>(c, d); });
    const auto on_device = [&](int threads, uint64_t seed) {
        EmulatedOptions options;
        options.threads = threads, options.seed = seed;
        const auto device = make_emulated(options);
        DeviceTree copied(*device);
        copied.set(balls.rays.tree());
        DevicePaths<S> paths(*device, 9000 * DevicePaths<S>::bytes_per_path());
        const auto reverse = [&](const RenderCall<S> &c, DerivativeCall<S> &d) {
            return paths.reverse(c, balls.data, copied.view(), d);
        };
        const Gradient plain(balls, call, reverse), found(balls, call, reverse, true),
            again(balls, call, reverse, true);
        CHECK(again.of_slots == found.of_slots);  // what is kept from call to call is zero again
        CHECK(found.stats.non_finite == plain.stats.non_finite);
        return found;
    };
    const Gradient first = on_device(1, 1);
    check_close(first, expected);
    CHECK(std::abs(first.of_slots[0][0]) > 1);
    for (const int threads : all_threads)
        for (const uint64_t seed : {2u, 3u}) CHECK(on_device(threads, seed).of_slots == first.of_slots);
}

TR_TEST(fixed_sums_of_gradients_do_not_depend_on_any_order) {
    check_fixed_sums<float>({2, 5}), check_fixed_sums<double>({3});
}

// Of numbers of very different sizes: `bits` below the largest of them are kept.
template <class S>
static void check_sums(const std::vector<std::vector<S>> &cases, int bits) {
    for (const std::vector<S> &numbers : cases) {
        FixedSum<S> forth{}, back{};
        long double sum = 0, largest = 0;
        for (const S x : numbers) {
            forth.measure(x), sum += x, largest = std::max<long double>(largest, std::abs(x));
        }
        back.largest = forth.largest;
        for (size_t i = 0; i < numbers.size(); ++i) {
            forth.add(numbers[i]), back.add(numbers[numbers.size() - 1 - i]);
        }
        CHECK(forth.value() == back.value());
        CHECK(std::abs(forth.value() - sum) <= largest * std::ldexp(double(numbers.size()), -bits));
    }
    FixedSum<S> many{};
    many.measure(S(1.5));
    for (int i = 0; i < 100000; ++i) many.add(i % 2 ? S(-1.5) : S(1.25));
    CHECK(many.value() == -12500);
}

TR_TEST(fixed_sums_are_those_of_exact_numbers) {
    check_sums<float>({{1.f, 0x1p-20f, -1.f, 0x1p-22f},
                       {-3e38f, 1e38f, 2e38f, 7e30f},
                       {0x1p-149f, 0x1p-140f, -0x1p-149f, 3 * 0x1p-149f},
                       {0.f, -0.f},
                       {0.1f, 0.2f, 0.3f, -0.7f, 1e-9f}},
                      34);
    // the rest, and the result, have the 53 bits of a double
    check_sums<double>({{1, 0x1p-40, -0.5, 0x1p-50},
                        {-1.5e308, 1e308, 0.4e308, 7e290},
                        {0x1p-1074, 0x1p-1060, -0x1p-1074},
                        {1e-300, 1e-290, -1e-310},
                        {0., -0.},
                        {0.1, 0.2, 0.3, -0.7, 1e-15}},
                       52);
}

// Where memory is short batches are smaller, as long as they fit at all.
TR_TEST(batches_of_a_device_shrink) {
    const Balls<float> balls;
    const RenderCall<float> call = make_call(balls.data, small(Filter()));
    const Image expected = balls.on_cpu(call, 18 * 20);
    const auto on_device = [&](size_t capacity, auto &&use) {
        EmulatedOptions options;
        options.capacity = capacity;
        const auto device = make_emulated(options);
        DeviceTree copied(*device);
        copied.set(balls.rays.tree());
        DevicePaths<float> paths(*device, (size_t(1) << 20) * DevicePaths<float>::bytes_per_path());
        use(paths, copied.view());
    };
    on_device(size_t(6) << 20, [&](DevicePaths<float> &paths, const TreeView &tree) {
        Image<float> found(18 * 20);
        found.stats = paths.render(call, balls.data, tree, found.out());
        CHECK(found == expected);
        const auto on_cpu = [](const RenderCall<float> &c, DerivativeCall<float> &d) {
            return render_reverse<float>(c, d);
        };
        const auto there = [&](const RenderCall<float> &c, DerivativeCall<float> &d) {
            return paths.reverse(c, balls.data, tree, d);
        };
        const float a = Gradient(balls, call, on_cpu).of_slots[0][0], b = Gradient(balls, call, there).of_slots[0][0];
        CHECK(std::abs(a - b) <= 1e-4f * std::abs(a));
    });
    on_device(size_t(1) << 19, [&](DevicePaths<float> &paths, const TreeView &tree) {
        Image<float> found(18 * 20);
        CHECK_THROWS(paths.render(call, balls.data, tree, found.out()), DeviceMemoryError, "smaller textures");
    });
}

TR_TEST(kernels_take_no_more_of_a_card) {
    SceneFacts room = facts_of_room(), more = room;  // one that has more
    more.shape_flags |= IsSphere | FlipNormals, more.textures = 3, more.textured = true, more.emitters = 15;
    more.stacks = true;
    SceneFacts fields = room;
    fields.shape_flags |= IsHeightField;
    SceneFacts grids = room;
    grids.shape_flags |= IsSdfGrid;
    SceneFacts recorded = room, forward = room;
    recorded.records = forward.records = forward.forward = true;
    // ... and of a cloud in it.
    SceneFacts cloud = room;
    cloud.volumetric = true, cloud.phases = 1u << kind_of_model<HenyeyGreenstein>(Phases{});
    SceneFacts colored = cloud, recorded_cloud = cloud;
    colored.chromatic = recorded_cloud.records = true;
    SceneFacts moved = recorded, fixed = recorded, output_moved = room, moved_cloud = recorded_cloud;
    SceneFacts moved_grids = moved;
    moved_grids.motion = true, moved_grids.shape_flags |= IsSdfGrid;
    moved_cloud.motion = true;
    moved.motion = output_moved.motion = fixed.fixed_sums = true;
    SceneFacts light = room, recorded_light = recorded, moved_light = moved;
    light.light_paths = recorded_light.light_paths = moved_light.light_paths = true;
    const int diffuse = kind_of_model<Diffuse>(Bsdfs{}), principled = kind_of_model<Principled>(Bsdfs{});
    check_resources({{kernel_of<StartPaths<float>>(), room, -1, ""},
                     {kernel_of<TracePaths<float>>(), room, -1, ""},
                     {kernel_of<TraceShadows<float>>(), room, -1, ""},
                     {kernel_of<TracePaths<float>>(), more, -1, ",more"},
                     {kernel_of<TracePaths<float>>(), fields, -1, ",fields"},
                     {kernel_of<TracePaths<float>>(), grids, -1, ",grids"},
                     {kernel_of<ShadeHits<float>>(), grids, diffuse, ",diffuse,grids"},
                     {kernel_of<SweepVertices<float>>(), moved_grids, diffuse, ",diffuse,grids,moved"},
                     {kernel_of<ClassifyHits<float>>(), room, -1, ""},
                     {kernel_of<ShadeHits<float>>(), room, diffuse, ",diffuse"},
                     {kernel_of<TracePaths<double>>(), room, -1, ""},
                     {kernel_of<ShadeHits<double>>(), room, diffuse, ",diffuse"},
                     {kernel_of<SweepVertices<double>>(), recorded, diffuse, ",diffuse"},
                     {kernel_of<SweepVertices<double>>(), fixed, diffuse, ",diffuse,fixed"},
                     {kernel_of<SettleSums<double>>(), room, -1, ""},
                     {kernel_of<FlyRays<double>>(), cloud, -1, ""},
                     {kernel_of<SplatConnections<double>>(), light, -1, ""},
                     {kernel_of<WriteImage<double>>(), room, -1, ""},
                     {kernel_of<ShadeHits<float>>(), more, diffuse, ",diffuse,more"},
                     {kernel_of<ShadeHits<float>>(), more, principled, ",principled,more"},
                     {kernel_of<ShadeHits<float>>(), more, MissKind, ",miss,more"},
                     {kernel_of<ShadeHits<float>>(), recorded, diffuse, ",diffuse,recorded"},
                     {kernel_of<SweepVertices<float>>(), recorded, diffuse, ",diffuse"},
                     {kernel_of<SweepVertices<float>>(), recorded, MissKind, ",miss"},
                     {kernel_of<SweepVertices<float>>(), forward, diffuse, ",diffuse,forward"},
                     {kernel_of<SweepVertices<float>>(), fixed, diffuse, ",diffuse,fixed"},
                     {kernel_of<ShadeHits<float>>(), moved, diffuse, ",diffuse,recorded,moved"},
                     {kernel_of<SweepVertices<float>>(), moved, diffuse, ",diffuse,moved"},
                     {kernel_of<BeginMedia<float>>(), cloud, -1, ""},
                     {kernel_of<FlyRays<float>>(), cloud, -1, ""},
                     {kernel_of<FlyRays<float>>(), colored, -1, ",colored"},
                     {kernel_of<ShadeInMedia<float>>(), cloud, CollisionKind, ",collision"},
                     {kernel_of<ShadeInMedia<float>>(), recorded_cloud, CollisionKind, ",collision,recorded"},
                     {kernel_of<ShadeInMedia<float>>(), recorded_cloud, diffuse, ",diffuse,recorded"},
                     {kernel_of<TransmitShadows<float>>(), cloud, -1, ""},
                     {kernel_of<TransmitShadows<float>>(), recorded_cloud, -1, ",recorded"},
                     {kernel_of<StartBranches<float>>(), cloud, -1, ""},
                     {kernel_of<FinishBranches<float>>(), cloud, -1, ""},
                     {kernel_of<SweepVertices<float>>(), recorded_cloud, CollisionKind, ",collision"},
                     {kernel_of<SweepVertices<float>>(), moved_cloud, CollisionKind, ",collision,moved"},
                     {kernel_of<StartLightPaths<float>>(), light, -1, ""},
                     {kernel_of<ShadeLightPaths<float>>(), light, diffuse, ",diffuse"},
                     {kernel_of<ShadeLightPaths<float>>(), recorded_light, diffuse, ",diffuse,recorded"},
                     {kernel_of<TraceConnections<float>>(), light, -1, ""},
                     {kernel_of<SplatConnections<float>>(), light, -1, ""},
                     {kernel_of<CollectConnections<float>>(), light, -1, ""},
                     {kernel_of<KeepConnections<float>>(), light, -1, ""},
                     {kernel_of<SetAdjoints<float>>(), light, -1, ""},
                     {kernel_of<SplatTangents<float>>(), light, -1, ""},
                     {kernel_of<SweepLightVertices<float>>(), recorded_light, EmissionKind, ",emission"},
                     {kernel_of<SweepLightVertices<float>>(), recorded_light, diffuse, ",diffuse"},
                     {kernel_of<SweepLightVertices<float>>(), moved_light, EmissionKind, ",emission,moved"},
                     {kernel_of<SweepLightVertices<float>>(), moved_light, diffuse, ",diffuse,moved"},
                     {kernel_of<EvaluateOutputs<float>>(), room, -1, ""},
                     {kernel_of<EvaluateOutputs<float>>(), more, -1, ",more"},
                     {kernel_of<SweepOutputs<float>>(), room, -1, ""},
                     {kernel_of<SweepOutputs<float>>(), output_moved, -1, ",moved"},
                     {kernel_of<StartCentres<float>>(), room, -1, ""},
                     {kernel_of<AddOutputsToFilm<float>>(), room, -1, ""},
                     {kernel_of<CollectOutputs<float>>(), room, -1, ""},
                     {kernel_of<PlaceSamples<float>>(), room, -1, ""},
                     {kernel_of<DivideAdjoint<float>>(), room, -1, ""},
                     {kernel_of<CollectAdjoints<float>>(), room, -1, ""},
                     {kernel_of<SumCopies>(), room, -1, ""},
                     {kernel_of<SettleSums<float>>(), room, -1, ""},
                     {kernel_of<NumberSamples<float>>(), room, -1, ""},
                     {kernel_of<CountKeys>(), room, -1, ""},
                     {kernel_of<SumKeys>(), room, -1, ""},
                     {kernel_of<PlaceKeys>(), room, -1, ""},
                     {kernel_of<FillWords>(), room, -1, ""},
                     {kernel_of<FillNumbers<float>>(), room, -1, ""},
                     {kernel_of<AddToFilm<float>>(), room, -1, ""},
                     {kernel_of<WriteImage<float>>(), room, -1, ""},
                     {kernel_of<IntersectRays>(), room, -1, ""},
                     {kernel_of<OccludeRays>(), room, -1, ""},
                     {kernel_of<OccludeRays>(), fields, -1, ",fields"}});
}

}  // namespace tr::testing
#endif
