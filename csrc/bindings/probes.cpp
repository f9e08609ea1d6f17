#include "probes.h"

#include <stdexcept>

#include "core/bsdf/parameters.h"
#include "core/integrator/bsdf_stack.h"
#include "core/phase/phase.h"
#include "cpu/packet_rows.h"

namespace tr {

namespace {

// A BSDF as at a hit: `twosided` resolved, and its parameters. Of one side, since lanes may be on different ones.
template <class F>
struct ProbedSide {
    MaskOf<F> lanes;
    F mirror;
    const BsdfKernels<F> *kernels;
    BsdfParameters<F> params;
};

// Calls visit(side) for both sides that are seen along wi.
template <class F, class Visit>
void for_sides(const SceneOf<F> &scene, int bsdf, const Vec3<F> &wi, const Vec2<F> &uv, const MaskOf<F> &active,
               Visit &&visit) {
    if (scene.bsdfs[bsdf].kind > TwoSidedKind)
        throw std::invalid_argument(
            "bsdf: a mixture, a mask or a normal map is met by chance or at a surface; probe what is nested in it");
    const TexturedPoint<F> at{{UIntOf<F>(0u), UIntOf<F>(0u), uv.x, uv.y}, uv};
    const MaskOf<F> behind = mask<F>(wi.z < F(0));
    for (bool back : {false, true}) {
        ProbedSide<F> side;
        side.lanes = active && (back ? behind : !behind);
        if (!any(side.lanes)) continue;
        ResolvedBsdf<F> r = resolve_bsdf<F>(scene, IntOf<F>(bsdf), MaskOf<F>(back), side.lanes);
        const int32_t leaf = first_lane(r.bsdf, side.lanes);
        side.mirror = select(r.mirrored, F(-1), F(1));
        side.kernels = &bsdf_kernels<F>(scene.bsdfs[leaf].kind);
        load_parameters(scene, Wavelengths<F>{}, *side.kernels, IntOf<F>(leaf), at, side.lanes, side.params);
        visit(side);
    }
}

template <class F>
Vec3<F> mirrored(Vec3<F> w, const F &mirror) {
    w.z = w.z * mirror;
    return w;
}

}  // namespace

template <class S>
void Probe<S>::bsdf(int index, size_t n) const {
    using F = PacketOf<S>;
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        const Vec3<F> wi = rows.vector(at("wi")), wo = rows.vector(at("wo"));
        BsdfValue<F> r{uniform_spectrum(F(0)), F(0)};
        for_sides(scene, index, wi, rows.pair(at("uv")), rows.active, [&](const ProbedSide<F> &side) {
            BsdfValue<F> v;
            side.kernels->eval_pdf(side.params, mirrored(wi, side.mirror), mirrored(wo, side.mirror),
                                   Transport::Radiance, v);
            r = {select(side.lanes, v.f, r.f), select(side.lanes, v.pdf, r.pdf)};
        });
        rows.put(at("value"), r.f, channels);
        rows.put(at("pdf"), r.pdf);
    });
}

template <class S>
void Probe<S>::bsdf_sample(int index, size_t n) const {
    using F = PacketOf<S>;
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        const Vec3<F> wi = rows.vector(at("wi")), u = rows.vector(at("u"));
        Spectrum<F> weight = uniform_spectrum(F(0));
        BsdfSample<F> r{{F(0), F(0), F(1)}, F(0), F(1), IntOf<F>(0), MaskOf<F>(false)};
        for_sides(scene, index, wi, rows.pair(at("uv")), rows.active, [&](const ProbedSide<F> &side) {
            BsdfSample<F> s;
            Spectrum<F> f;
            side.kernels->sample(side.params, mirrored(wi, side.mirror), u.x, u.y, u.z, Transport::Radiance, s, f);
            auto some = side.lanes && mask<F>(s.pdf > F(0));
            for (int c = 0; c < SpectrumSize; ++c)
                weight[c] = select(some, f[c] / select(some, s.pdf, F(1)), weight[c]);
            r.wo = select(side.lanes, mirrored(s.wo, side.mirror), r.wo);
            r.pdf = select(side.lanes, s.pdf, r.pdf);
            r.eta = select(side.lanes, s.eta, r.eta);
            r.delta = r.delta || (side.lanes && s.delta);
        });
        rows.put(at("wo"), r.wo);
        rows.put(at("weight"), weight, channels);
        rows.put(at("pdf"), r.pdf);
        rows.put(at("eta"), r.eta);
        rows.put_flags(reinterpret_cast<uint8_t *>(arrays.at("delta")), r.delta);
    });
}

template <class S>
void Probe<S>::emitter_sample(size_t n) const {
    using F = PacketOf<S>;
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        const Vec3<F> u = rows.vector(at("u"));
        EmitterSample<F> s = sample_emitter(scene, rows.vector(at("p")), u.x, u.y, u.z, rows.active);
        auto possible = rows.active && mask<F>(s.pdf > F(0));
        rows.put(at("d"), s.d);
        rows.put(at("distance"), s.distance);
        rows.put(at("pdf"), s.pdf);
        rows.put(at("radiance"), eval_emitter(scene, Wavelengths<F>{}, s.point, possible) * s.factor, channels);
    });
}

template <class S>
void Probe<S>::emitter_pdf(size_t n) const {
    using F = PacketOf<S>;
    using U = UIntOf<F>;
    constexpr size_t W = size_t(Lanes<F>::Width);
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        const Ray<F> ray{rows.vector(at("p")), rows.vector(at("d"))};
        float in[7][W], t[W], b1[W], b2[W];
        uint32_t shape[W], primitive[W];
        for (size_t i = 0; i < W; ++i) {
            const size_t row = rows.begin + std::min(i, rows.count - 1);
            for (size_t k = 0; k < 3; ++k)
                in[k][i] = float(at("p")[3 * row + k]), in[3 + k][i] = float(at("d")[3 * row + k]);
            in[6][i] = INFINITY;
        }
        accel.intersect({{in[0], in[1], in[2]}, {in[3], in[4], in[5]}, in[6]}, {shape, primitive, t, b1, b2}, W, false);
        alignas(64) S wide[3][W];
        for (size_t i = 0; i < W; ++i) wide[0][i] = S(t[i]), wide[1][i] = S(b1[i]), wide[2][i] = S(b2[i]);
        const U shapes = load_uint<F>(shape);
        Spectrum<F> radiance = uniform_spectrum(F(0));
        F pdf(0);
        auto missed = rows.active && mask<F>(shapes == U(Accel::Miss)), hit = rows.active && !missed;
        if (any(missed) && scene.environment >= 0) {
            F found;
            EmitterPoint<F> point = environment_point(scene, ray.d, found, missed);
            pdf = select(missed, found, pdf);
            radiance = select(missed, eval_emitter(scene, Wavelengths<F>{}, point, missed), radiance);
        }
        if (any(hit)) {
            SurfacePoint<F> place{select(mask<U>(hit), shapes, U(0u)),
                                  select(mask<U>(hit), load_uint<F>(primitive), U(0u)), load<F>(wide[1]),
                                  load<F>(wide[2])};
            Interaction<F> si = make_interaction(scene, ray, place, load<F>(wide[0]), hit);
            auto lit = hit && mask<F>(si.shape.emitter >= 0) && mask<F>(dot(si.frame.n, ray.d) < F(0));
            if (any(lit)) {
                EmitterPoint<F> point{si.shape.emitter, si.at};
                pdf = select(lit, shape_emitter_pdf(scene, point, ray.o, si.p, si.ng, lit), pdf);
                radiance = select(lit, eval_emitter(scene, Wavelengths<F>{}, point, lit), radiance);
            }
        }
        rows.put(at("pdf"), pdf);
        rows.put(at("radiance"), radiance, channels);
    });
}

template <class S>
void Probe<S>::phase(int index, size_t n) const {
    using F = PacketOf<S>;
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        rows.put(at("value"), eval_phase(scene, index, rows.vector(at("p")), rows.vector(at("d")),
                                         rows.vector(at("wo")), rows.active));
    });
}

template <class S>
void Probe<S>::phase_sample(int index, size_t n) const {
    using F = PacketOf<S>;
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        const Vec3<F> u = rows.vector(at("u"));
        rows.put(at("wo"),
                 sample_phase(scene, index, rows.vector(at("p")), rows.vector(at("d")), u.x, u.y, u.z, rows.active));
    });
}

template <class S>
void Probe<S>::phase_sweep(int index, size_t n, GradientSink<PacketOf<S>> &sink) const {
    using F = PacketOf<S>;
    for_rows<F>(n, [&](const PacketRows<F> &rows) {
        sink.begin();
        sweep_phase(scene, index, rows.vector(at("p")), rows.vector(at("d")), rows.vector(at("wo")),
                    rows.spectrum(at("g"), channels), rows.active, sink);
        if (sink.forward) rows.put(at("derivative"), sink.derivative, channels);
    });
}

#define TR_INSTANTIATE(S) template struct Probe<S>;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
