#include "emitter.h"

namespace tr {

template <class F>
TR_HD const EmitterKernels<F> &emitter_kernels(int kind) {
#define TR_TABLE(M) emitter_kernels_of<M, F>(),
    static const EmitterKernels<F> all[] = {TR_EMITTERS(TR_TABLE)};
#undef TR_TABLE
    return all[kind];
}

template <class F>
TR_LARGE Spectrum<F> eval_emitter(const SceneOf<F> &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                                  const MaskOf<F> &active, bool beams) {
    Spectrum<F> r = uniform_spectrum(F(0));
    IntOf<F> kind = emitter_kind<F>(scene, point.emitter, active);
    for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        if (beams || !emitter.is(IsBeam)) emitter.eval(scene, waves, point, lanes, r);
    });
    return r;
}

namespace {

// An emitter, the probability of choosing it, and a uniform number that is left of the one that chose.
template <class F>
struct ChosenEmitter {
    UIntOf<F> index{0u};
    F pmf, left;

    TR_INLINE ChosenEmitter(const SceneOf<F> &scene, const F &u, const MaskOf<F> &active) {
        using U = UIntOf<F>;
        left = u;
        if (scene.n_emitters > 1) {
            index = search_cdf<F>(scene.emitter_cdf, U(0u), U(uint32_t(scene.n_emitters)), u, active);
            pmf = gather<F>(scene.emitter_pmf, index, active);
            F before = select(mask<F>(index > 0u), gather<F>(scene.emitter_cdf, max(index, U(1u)) - 1u, active), F(0));
            left = max(F(0), min((u - before) / max(pmf, F(1e-20)), F(1 - 1e-7)));
        } else {
            pmf = F(scene.emitter_pmf[0]);
        }
    }
};

}  // namespace

template <class F>
TR_LARGE EmitterSample<F> sample_emitter(const SceneOf<F> &scene, const Vec3<F> &p, const F &u0, const F &u1,
                                         const F &u2, const MaskOf<F> &active) {
    EmitterSample<F> r = no_emitter_sample<F>();
    ChosenEmitter<F> chosen(scene, u0, active);
    r.point.emitter = IntOf<F>(chosen.index);
    IntOf<F> kind = emitter_kind<F>(scene, r.point.emitter, active);
    for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        if (emitter.sample_direct) emitter.sample_direct(scene, p, chosen.left, u1, u2, lanes, r);
    });
    r.pdf = r.pdf * chosen.pmf;
    return r;
}

template <class F>
TR_LARGE F shape_emitter_pdf(const SceneOf<F> &scene, const EmitterPoint<F> &point, const Vec3<F> &from,
                             const Vec3<F> &p, const Vec3<F> &n, const MaskOf<F> &active) {
    F r(0);
    IntOf<F> kind = emitter_kind<F>(scene, point.emitter, active);
    for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        if (emitter.pdf_direct) r = select(lanes, emitter.pdf_direct(scene, point, from, p, n, lanes), r);
    });
    return r * gather<F>(scene.emitter_pmf, UIntOf<F>(point.emitter), active);
}

template <class F>
TR_LARGE EmitterPoint<F> environment_point(const SceneOf<F> &scene, const Vec3<F> &d, F &pdf, const MaskOf<F> &active) {
    EmitterPoint<F> r{IntOf<F>(scene.environment), {UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}};
    visit_emitter_kind<F>(scene.emitters[scene.environment].kind, [&](const EmitterKernels<F> &environment) {
        if (!environment.point_of_direction) return;
        environment.point_of_direction(scene, d, r);
        pdf = environment.pdf_direct(scene, r, d, d, d, active) * F(scene.emitter_pmf[scene.environment]);
    });
    return r;
}

template <class F>
TR_LARGE EmissionSample<F> sample_emission(const SceneOf<F> &scene, const F &choice, const F &a, const F &b, const F &c,
                                           const F &d, const MaskOf<F> &active) {
    EmissionSample<F> r;
    ChosenEmitter<F> chosen(scene, choice, active);
    r.point = {IntOf<F>(chosen.index), {UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}};
    r.kind = emitter_kind<F>(scene, r.point.emitter, active);
    r.p = {F(0), F(0), F(0)};
    r.n = r.d = {F(0), F(0), F(1)};
    r.weight = r.inverse_pdf = F(0);
    F inverse_pmf = F(1) / max(chosen.pmf, F(1e-20));
    for_each_emitter_kind<F>(r.kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        emitter.sample_emission(scene, chosen.left, a, b, c, d, inverse_pmf, lanes, r);
    });
    r.active = active && mask<F>(r.weight > F(0));
    return r;
}

#define TR_INSTANTIATE(F, S)                                                                                         \
    template const EmitterKernels<F> &emitter_kernels(int);                                                          \
    template Spectrum<F> eval_emitter(const SceneView<S> &, const Wavelengths<F> &, const EmitterPoint<F> &,         \
                                      const MaskOf<F> &, bool);                                                      \
    template EmitterSample<F> sample_emitter(const SceneView<S> &, const Vec3<F> &, const F &, const F &, const F &, \
                                             const MaskOf<F> &);                                                     \
    template F shape_emitter_pdf(const SceneView<S> &, const EmitterPoint<F> &, const Vec3<F> &, const Vec3<F> &,    \
                                 const Vec3<F> &, const MaskOf<F> &);                                                \
    template EmitterPoint<F> environment_point(const SceneView<S> &, const Vec3<F> &, F &, const MaskOf<F> &);       \
    template EmissionSample<F> sample_emission(const SceneView<S> &, const F &, const F &, const F &, const F &,     \
                                               const F &, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
