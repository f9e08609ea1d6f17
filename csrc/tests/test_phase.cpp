// Phase functions where their tables end: directions straight ahead and back, the first and the last uniform number.
// (Their values, samples and derivatives are tested from Python; this runs under sanitizers, too.)
#include "accel/embree_library.h"
#include "core/adjoint/gradient_sink.h"
#include "core/phase/phase.h"
#include "scene_builder.h"

namespace tr::testing {

template <class S>
struct PhaseScene {
    SceneBuilder<S> b{3};
    SceneData<S> scene;
    int64_t table, grid;

    explicit PhaseScene(std::vector<S> values) {
        load_embree(embree_path());
        table = b.param({int64_t(values.size())}, values);
        grid = b.random({2, 1, 3, 1}, 0, 1);
        int64_t volume = b.add("volume", "gridvolume", {{"data", grid}, {"to_world", b.matrix(0, 0, 0)}});
        int64_t first = b.add("phase", "tabphase", {{"values", table}});
        int64_t second = b.add("phase", "hg", {{"g", b.number(S(-0.9999))}});
        b.add("phase", "blendphase", {{"weight", volume}, {"phase_0", first}, {"phase_1", second}});
        b.add("phase", "rayleigh");
        b.camera(0, 0, 0, 45);
    }
};

template <class F>
static void check_ends(std::vector<ScalarOf<F>> values) {
    using S = ScalarOf<F>;
    PhaseScene<S> s(values);
    s.b.build(s.scene);
    const SceneView<S> &view = s.scene.view();
    std::vector<double> constants(s.scene.n_constants(), 0.0);
    std::vector<S> by_value(values.size(), S(0)), by_voxel(6, S(0));
    std::vector<S *> tensors(s.scene.n_params(), nullptr);
    tensors[size_t(s.table)] = by_value.data(), tensors[size_t(s.grid)] = by_voxel.data();
    GradientSink<F> sink;
    sink.constants = constants.data(), sink.tensors = tensors.data();
    sink.begin();
    const MaskOf<F> active(true);
    const Vec3<F> d{F(0), F(0), F(1)};
    for (int32_t phase = 0; phase < 4; ++phase)
        for (S sign : {S(-1), S(1)})
            for (S at : {S(-3), S(0), S(1), S(7)}) {
                Vec3<F> p{F(at), F(at), F(at)}, along = d * F(sign);
                CHECK(all(mask<F>(eval_phase(view, phase, p, along, d, active) >= F(0))));
                sweep_phase(view, phase, p, along, d, uniform_spectrum(F(1)), active, sink);
                for (S u : {S(0), S(0.5), S(1) - S(1.0 / (1 << 24))}) {
                    Vec3<F> wo = sample_phase(view, phase, p, along, F(u), F(u), F(u), active);
                    CHECK(all(mask<F>(abs(squared_norm(wo) - F(1)) < F(1e-5))));
                    CHECK(all(mask<F>(eval_phase(view, phase, p, along, wo, active) >= F(0))));
                }
            }
    CHECK(sink.non_finite == 0);
}

TR_TEST(phase_functions_at_their_ends) {
    for (const std::vector<float> &values : {std::vector<float>{0, 1}, {1, 0, 2, 3, 0}, std::vector<float>(100, 1)}) {
#define TR_CHECK_ENDS(S) check_ends<PacketOf<S>>({values.begin(), values.end()});
        TR_FOR_EACH_PRECISION(TR_CHECK_ENDS)
    }
}

TR_TEST(phase_functions_that_are_refused) {
    PhaseScene<float> short_table({1});
    CHECK_THROWS(short_table.b.build(short_table.scene), std::invalid_argument,
                 "field 'values': expected a tensor of shape (N,) with at least 2 numbers");
    for (float bad : {-1.f, INFINITY, NAN}) {
        PhaseScene<float> s({1, bad});
        CHECK_THROWS(s.b.build(s.scene), std::invalid_argument, "phase.tabphase: field 'values': expected");
    }
    PhaseScene<float> s({1, 2});
    s.b.add("phase", "blendphase", {{"phase_0", 2}, {"phase_1", 0}});
    CHECK_THROWS(s.b.build(s.scene), std::invalid_argument,
                 "field 'phase_0': expected a phase function that is no blend itself, got 'blendphase'");
}

}  // namespace tr::testing
