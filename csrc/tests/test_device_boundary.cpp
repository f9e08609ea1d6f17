// Derivatives of moving outlines on the emulated device: those of the CPU, whatever the batches.
#include <algorithm>

#include "accel/embree_library.h"
#include "device/emulated.h"
#include "device/scene_rays.h"
#include "device/tree_walk.h"
#include "kernel_resources.h"
#include "scene_builder.h"

#if !TR_HAS_PACKETS
#include "cpu/device_paths.h"

namespace tr::testing {

namespace {

// A ball and a tetrahedron, which moves, under a sky, over a floor with a lamp above it.
template <class S>
void build_solids(SceneBuilder<S> &builder) {
    const int64_t gray = builder.diffuse(0.5f, 0.4f, 0.6f);
    const int64_t metal = builder.add("bsdf", "roughconductor", {{"alpha", builder.constant(0.3f, 0.3f, 0.3f)}});
    const int64_t vertices = builder.param({4, 3}, {-0.5f, 0.3f, 4, 0.3f, 0.4f, 4.2f, 0, -0.5f, 4.1f, 0, 0.1f, 3.4f});
    builder.add(
        "shape", "mesh",
        {{"vertices", vertices}, {"faces", builder.faces({0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0})}, {"bsdf", gray}});
    builder.add("shape", "sphere", {{"to_world", builder.matrix(0.6f, 0, 4.5f, 0.4f)}, {"bsdf", metal}});
    builder.add("shape", "rectangle",
                {{"to_world", builder.matrix(0, 0.2f, 6, 1.5f)}, {"flip_normals", 1}, {"bsdf", gray}});
    const int64_t lamp = builder.add("emitter", "area", {{"radiance", builder.constant(9, 8, 7)}});
    builder.add("shape", "sphere",
                {{"to_world", builder.matrix(-0.8f, 1.2f, 3, 0.3f)}, {"bsdf", gray}, {"emitter", lamp}});
    builder.add("emitter", "constant", {{"radiance", builder.color(0.5f, 0.6f, 0.9f)}});
    builder.camera(0, 0, 0, 40);
}

template <class S>
struct Solids {
    SceneBuilder<S> builder{3};
    SceneData<S> data;
    SceneRays rays;
    TreeWalk walk;
    const std::vector<uint8_t> moves{1, 1, 0, 0};
    OutlineSet outlines;
    OutlinePieces pieces;
    std::vector<int64_t> cells;
    std::vector<double> adjoint;
    Settings settings;
    RenderCall<S> call;
    const AovLayout layout{3, [](int kind) { return kind == AovDepth || kind == AovUv; }};
    const bool glued;

    explicit Solids(bool glued_ = false) : glued(glued_) {
        load_embree(embree_path());
        build_solids(builder);
        builder.build(data);
        rays.update(data.view(), 1);
        walk.tree = rays.tree().view();
        data.walk(&walk);
        settings.filter = Filter(FilterKind::Gaussian, 0.5);
        call = make_call(data, settings);
        CHECK(find_outlines<S>(call, moves.data(), glued, data.geometry_version(), outlines, pieces));
        for (int64_t y = 0; y < call.film_height; ++y)
            for (int64_t x = 0; x < call.film_width; ++x) cells.insert(cells.end(), {x, y});
        for (size_t i = 0; i < 2 * cells.size(); ++i) adjoint.push_back(0.5 + double(i % 7));
    }
    // Of so many samples of a part.
    BoundaryCall<S> boundary(BoundaryPart part, uint64_t count) const {
        BoundaryCall<S> b{};
        b.part = part, b.channels = 4, b.filter = call.filter, b.outlines = &outlines, b.pieces = &pieces;
        b.moves = moves.data(), b.cells = cells.data(), b.n_cells = cells.size() / 2;
        b.layout = &layout, b.glued = glued;
        b.count = count, b.total = b.samples = double(count), b.near = 0.05, b.in_view = 0.7;
        b.adjoint = adjoint.data();
        return b;
    }
    // f(call, boundaries, derivative) is handed all parts; what it adds to the gradients of all parameters.
    template <class Reverse>
    std::vector<std::vector<S>> gradients(uint64_t count, bool fixed_sums, Reverse &&reverse) const {
        std::vector<std::vector<S>> r;
        for (const auto &values : builder.values) r.emplace_back(values.size(), S(0));
        DerivativeCall<S> d = reverse_call(data, call.config, false, addresses_of(r));
        d.fixed_sums = fixed_sums;
        const auto look = [&](const BoundaryCall<S> &b) { boundary_forward<S>(call, b, d); };
        std::vector<BoundaryCall<S>> parts;
        for (const BoundaryPart part : {BoundaryPart::Silhouettes, BoundaryPart::Shadows, BoundaryPart::Reflections})
            parts.push_back(boundary(part, count));
        if (!glued) parts.push_back(boundary(BoundaryPart::Outputs, count));
        const ShadowPieces shadows = find_shadows<S>(call, parts[1], look);
        parts[1].shadows = &shadows;
        const std::vector<RenderCall<S>> calls(parts.size(), call);
        const std::vector<RenderStats> stats = reverse(calls, parts, d);
        for (const RenderStats &each : stats) CHECK(each.closest_rays > 100);
        add_gradients(data, d, addresses_of(r), 2);
        return r;
    }
    std::vector<std::vector<S>> on_cpu(uint64_t count) const {
        return gradients(count, false,
                         [](auto &calls, auto &parts, auto &d) { return boundary_reverse<S>(calls, parts, d); });
    }
    // In batches of so many bytes.
    std::vector<std::vector<S>> on_device(uint64_t count, size_t memory, bool fixed_sums,
                                          const EmulatedOptions &options = {}) const {
        const auto device = make_emulated(options);
        DeviceTree copied(*device);
        copied.set(rays.tree());
        DevicePaths<S> paths(*device, memory);
        const auto reverse = [&](auto &calls, auto &parts, auto &d) {
            return paths.boundary().reverse(calls, parts, data, copied.view(), d);
        };
        const auto found = gradients(count, fixed_sums, reverse);
        CHECK(!fixed_sums || gradients(count, true, reverse) == found);  // what is kept from call to call is zero again
        return found;
    }
};

template <class S>
bool are_close(const std::vector<std::vector<S>> &found, const std::vector<std::vector<S>> &expected) {
    constexpr S Close = sizeof(S) == sizeof(float) ? S(1e-5) : S(1e-12);
    bool close = true;
    for (size_t i = 0; i < expected.size(); ++i) {
        S largest = 0;
        for (const S a : expected[i]) largest = std::max(largest, std::abs(a));
        for (size_t k = 0; k < expected[i].size(); ++k)
            close &= std::abs(found[i][k] - expected[i][k]) <= Close * largest;
    }
    return close;
}

}  // namespace

template <class S>
static void check_outlines(const std::vector<size_t> &memories, bool glued = false) {
    const Solids<S> solids(glued);
    constexpr uint64_t count = 2500;
    const auto expected = solids.on_cpu(count);
    S largest = 0;
    for (const auto &of_slot : expected)
        for (const S a : of_slot) largest = std::max(largest, std::abs(a));
    CHECK(largest > 1);
    for (const size_t memory : memories) CHECK(are_close(solids.on_device(count, memory, false), expected));
    std::vector<std::vector<S>> first;
    for (const uint64_t seed : {1u, 2u}) {
        EmulatedOptions options;
        options.threads = 1 + 2 * int(seed - 1), options.seed = seed;
        const auto found = solids.on_device(count, memories[0], true, options);
        CHECK(are_close(found, expected));
        CHECK(first.empty() || found == first);
        first = found;
    }
}

// Of one batch, and of several of 1024 samples each.
TR_TEST(outlines_of_the_device_are_those_of_the_cpu_in_any_batches) {
    check_outlines<float>({size_t(1) << 19, size_t(1) << 24});
    check_outlines<double>({size_t(1) << 20});
}

TR_TEST(outlines_of_light_paths_of_the_device_are_those_of_the_cpu) { check_outlines<float>({size_t(1) << 19}, true); }

TR_TEST(batches_of_outlines_shrink) {
    const Solids<float> solids;
    EmulatedOptions options;
    options.capacity = size_t(12) << 20;
    CHECK(are_close(solids.on_device(2500, size_t(1) << 24, false, options), solids.on_cpu(2500)));
    options.capacity = size_t(1) << 19;
    CHECK_THROWS(solids.on_device(2500, size_t(1) << 24, false, options), DeviceMemoryError, "smaller textures");
}

TR_TEST(kernels_of_outlines_take_no_more_of_a_card) {
    SceneFacts room = facts_of_room(), lights, derivative;
    room.sampler = int32_t(SamplerKind::Independent), room.records = room.motion = true;
    lights = derivative = room;
    lights.light_paths = true;
    const int diffuse = kind_of_model<Diffuse>(Bsdfs{});
    check_resources({{kernel_of<FindSights<float>>(), room, -1, ""},
                     {kernel_of<StartSights<float>>(), room, -1, ""},
                     {kernel_of<AddSights<float>>(), room, MissKind, ""},
                     {kernel_of<LookUpOutputs<float>>(), room, -1, ""},
                     {kernel_of<AddOutputSights<float>>(), room, MissKind, ""},
                     {kernel_of<FindEdges<float>>(), lights, -1, ""},
                     {kernel_of<ShadeEnds<float>>(), room, diffuse, ",diffuse"},
                     {kernel_of<ConnectEdges<float>>(), room, -1, ""},
                     {kernel_of<AddEdges<float>>(), room, MissKind, ""},
                     {kernel_of<SweepPlaces<float>>(), room, diffuse, ",diffuse"},
                     {kernel_of<NumberOutlines<float>>(), room, -1, ""},
                     {kernel_of<KeepInPixels<float>>(), room, -1, ""},
                     {kernel_of<KeepSmooth<float>>(), room, -1, ""},
                     {kernel_of<ChooseVertices<float>>(), room, -1, ""},
                     {kernel_of<LookAtVertices<float>>(), room, diffuse, ",diffuse"},
                     {kernel_of<ScatterTowards<float>>(), room, diffuse, ",diffuse"},
                     {kernel_of<ListEdges<float>>(), room, -1, ""},
                     {kernel_of<ShareEdges<float>>(), room, -1, ""},
                     {kernel_of<AimAtEdges<float>>(), room, -1, ""},
                     {kernel_of<SeeEdges<float>>(), room, -1, ""},
                     {kernel_of<SlideVertices<float>>(), room, -1, ""},
                     {kernel_of<ShareOutlines<float>>(), room, -1, ""},
                     {kernel_of<ChooseOutlines<float>>(), room, -1, ""},
                     {kernel_of<FindOutlines<float>>(), room, -1, ""},
                     {kernel_of<LookPastOutlines<float>>(), room, -1, ""},
                     {kernel_of<StartOutlines<float>>(), room, -1, ""},
                     {kernel_of<TakeOutlines<float>>(), room, -1, ""},
                     {kernel_of<AddOutlines<float>>(), room, MissKind, ""},
                     {kernel_of<TellEdges<float>>(), room, -1, ""},
                     {kernel_of<WeighSights<float>>(), room, -1, ""},
                     {kernel_of<WeighEdges<float>>(), room, -1, ""},
                     {kernel_of<WeighOutlines<float>>(), room, -1, ""}});
}

}  // namespace tr::testing
#endif
