// What integrators know of an emitter: a table of functions on packets. Each model is one translation unit that fills
// in such a table; the registry below lists them. A packet may have several emitters: `lanes` are those of the model
// that is called, and results are written there alone.
#pragma once

#include "../adjoint/needs.h"
#include "../math/warp.h"
#include "../shape/surface.h"
#include "../texture/texture.h"
#include "../typelist.h"

// One line a model, each a file here; the position is the model's kind.
#define TR_EMITTERS(X)        \
    X(AreaEmitter)            \
    X(ConstantEmitter)        \
    X(EnvironmentMap)         \
    X(PointEmitter)           \
    X(DirectionalAreaEmitter) \
    X(DirectionalEmitter)     \
    X(SpotEmitter)            \
    X(ProjectorEmitter)

namespace tr {

template <class F>
class GradientSink;
template <class F>
struct CoordinateAdjoint;
template <class F>
struct EmissionRecord;
template <class F>
struct NextVertex;

// Where on which emitter: on a shape a surface point; of an environment (b1, b2) are coordinates of the direction, of
// a light at a point they are the direction in its frame (delta_position.h).
template <class F>
struct EmitterPoint {
    IntOf<F> emitter;
    SurfacePoint<F> at;
};

// A point on an emitter, chosen for a reference point.
template <class F>
struct EmitterSample {
    EmitterPoint<F> point;
    Vec3<F> d;  // unit direction from the reference point
    F distance;
    F pdf;     // per solid angle, times the probability of the emitter; 0: nothing arrives
    F factor;  // radiance arriving = factor * emitted: 1, or 1 / distance^2 of lights at a point
    MaskOf<F> delta;
};

template <class F>
TR_INLINE EmitterSample<F> no_emitter_sample() {
    EmitterSample<F> r;
    r.point = {IntOf<F>(-1), {UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}};
    r.d = {F(0), F(0), F(1)};
    r.distance = r.factor = F(1);
    r.pdf = F(0);
    r.delta = MaskOf<F>(false);
    return r;
}

// A ray of light, where the paths of the particle tracer begin. What it carries is `weight` times what the emitter
// sends there, `weight` being the cosine over the density of the choice. How it moves when the emitter does, see
// adjoint/light.h.
template <class F>
struct EmissionSample {
    EmitterPoint<F> point;
    IntOf<F> kind;
    Vec3<F> p, n, d;  // where on the emitter (or on a disk in front of the scene), its normal, unit direction of travel
    F weight;
    F inverse_pdf;  // of the emitter and of p, by area; of light from afar of the direction, by solid angle
    MaskOf<F> active;
};

// How light came from a sampled point to a reference point x, as its derivative sees it: along the unit vector w from
// x, `log_bar` being the adjoint of the logarithm of what arrives.
template <class F>
struct DirectAdjoint {
    EmitterPoint<F> point;
    Vec3<F> x, w;
    F distance;
    Vec3<F> w_bar;
    F log_bar;
    const CoordinateAdjoint<F> &at;         // of the point, from what it sends
    bool shapes;                            // whether shapes may move, or lights alone
    Vec3<F> end_bar{F(0), F(0), F(0)};      // of the place of the point, from what lies on the way
    Vec3<F> tangent_bar{F(0), F(0), F(0)};  // of dp/du there, from polarised light
};

// Means over what emitters look up, on the host: what their power is made of.
struct EmitterMeans {
    virtual ~EmitterMeans() = default;
    virtual double number(int32_t offset) const = 0;
    virtual double color(int32_t offset) const = 0;            // luminance, as the following
    virtual double texture(int32_t index, int32_t shape) = 0;  // on a shape, or -1
    virtual double environment(int32_t slot) = 0;              // of an image over directions
    virtual double area(int32_t shape) const = 0;
    double disk = 0;  // area of one that covers the scene
};

// A model's declaration as polarised light needs it.
struct EmitterInfo : ModelInfo {
    int stokes = -1, to_world = -1;  // fields, -1: none

    constexpr EmitterInfo() = default;
    constexpr EmitterInfo(const Model &declared)
        : ModelInfo(declared), stokes(field_named(declared, "stokes")), to_world(field_named(declared, "to_world")) {}
};

template <class F>
struct EmitterKernels : EmitterInfo {
    using S = ScalarOf<F>;
    using Scene = SceneView<S>;
    using Point = EmitterPoint<F>;
    using M = MaskOf<F>;

    // Radiance (of lights at a point: intensity; of parallel light: irradiance).
    void (*eval)(const Scene &, const Wavelengths<F> &, const Point &, const M &lanes, Spectrum<F> &);
    // A point for the reference point p: all of r but the emitter, pdf without its probability. Null of beams.
    void (*sample_direct)(const Scene &, const Vec3<F> &p, const F &u0, const F &u1, const F &u2, const M &lanes,
                          EmitterSample<F> &r);
    // Density per solid angle with which that chooses, for the reference point `from`, what a ray has met: the point p
    // of normal n, or the environment. Null where no ray does.
    F (*pdf_direct)(const Scene &, const Point &, const Vec3<F> &from, const Vec3<F> &p, const Vec3<F> &n,
                    const M &lanes);
    // The environment in direction d as an emitter point. Null of others.
    void (*point_of_direction)(const Scene &, const Vec3<F> &d, Point &);
    // Light as it leaves: `left` chooses the face of a mesh; (a, b) is a point of the unit square, which is spread over
    // the surface (of an environment: over its directions), (c, d) gives the direction (of an environment: the place).
    void (*sample_emission)(const Scene &, const F &left, const F &a, const F &b, const F &c, const F &d,
                            const F &inverse_pmf, const M &lanes, EmissionSample<F> &);
    // Derivative of what is sent, of which g is the adjoint, in the unit direction -d. `at` and `d_bar` receive those
    // of the point and of d where something moves.
    void (*vjp)(const Scene &, const Point &, const Vec3<F> &d, const Spectrum<F> &g, const GradientNeeds &,
                const M &lanes, CoordinateAdjoint<F> &at, Vec3<F> &d_bar, GradientSink<F> &);
    // Derivative of where it comes from: the adjoint of the reference point. Null where nothing of it depends on that.
    void (*direct_vjp)(const Scene &, const DirectAdjoint<F> &, const M &lanes, Vec3<F> &x_bar, GradientSink<F> &);
    // Derivative of how a path of light begins; `carried` is the adjoint of the logarithm of what it carries, `at` and
    // `d_bar` those of the point and of the direction -d from what is sent. Null where nothing of it moves.
    void (*emission_vjp)(const Scene &, const EmissionRecord<F> &, const NextVertex<F> &, const F &carried,
                         const CoordinateAdjoint<F> &at, const Vec3<F> &d_bar, const M &lanes, GradientSink<F> &);
    // On the host alone.
    double (*power)(EmitterMeans &, const Record &);
};

template <class M, class F>
TR_DEVICE_CONSTEXPR EmitterKernels<F> emitter_kernels_of();

#define TR_NAME(M) struct M;
TR_EMITTERS(TR_NAME)
#undef TR_NAME
struct NoEmitter;
#define TR_NAME(M) M,
using Emitters = TypeList<TR_EMITTERS(TR_NAME) NoEmitter>;  // the last stands for none
#undef TR_NAME
constexpr int EmitterKinds = Emitters::Size - 1;

template <class F>
TR_HD const EmitterKernels<F> &emitter_kernels(int kind);

// What the host adds to records: of emitters that are on a shape its index; where the aspect of the image is.
constexpr int EmitterShape = Record::Extra, ImageAspect = Record::Extra;

// Calls visit(table) for the model of a kind.
template <class F, class Visit>
TR_INLINE void visit_emitter_kind(int32_t kind, Visit &&visit) {
#if defined(TR_ONE_SCENE)  // calls of known functions, which are compiled for all lanes together
#define TR_CASE(M)                                                                 \
    if constexpr (facts::has(facts::EmitterKinds, kind_of_model<M>(Emitters{}))) { \
        constexpr EmitterKernels<F> of_##M = emitter_kernels_of<M, F>();           \
        if (kind == kind_of_model<M>(Emitters{})) visit(of_##M);                   \
    }
    TR_EMITTERS(TR_CASE)
#undef TR_CASE
#else
    visit(emitter_kernels<F>(kind));
#endif
}

// Calls visit(table, lanes) for every model that lanes have an emitter of.
template <class F, class Visit>
TR_INLINE void for_each_emitter_kind(const IntOf<F> &kind, const MaskOf<F> &active, Visit &&visit) {
    for_each_distinct<F>(kind, active, [&](int32_t k, const MaskOf<F> &lanes) {
        visit_emitter_kind<F>(k, [&](const EmitterKernels<F> &emitter) { visit(emitter, lanes); });
    });
}

template <class F>
TR_INLINE IntOf<F> emitter_kind(const SceneOf<F> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
    if (scene.n_emitters == 1) return IntOf<F>(scene.emitters[0].kind);
    return record_kind<F>(scene.emitters, emitter, active);
}

// A field of emitters' records.
template <class F>
TR_INLINE IntOf<F> emitter_field(const SceneOf<F> &scene, int field, const IntOf<F> &emitter, const MaskOf<F> &active) {
    if (scene.n_emitters == 1) return IntOf<F>(scene.emitters[0].field[field]);
    return record_field<F>(scene.emitters, field, emitter, active);
}

// What the emitters of these kinds are; -1: nothing.
template <class F>
struct EmitterFlags {
    UIntOf<F> flags;

    TR_INLINE EmitterFlags(const SceneOf<F> &scene, const IntOf<F> &kind) : flags(0u) {
        const bool one = scene.n_emitters == 1;
        for (int k = one ? scene.emitters[0].kind : 0, end = one ? k + 1 : EmitterKinds; k < end; ++k)
            visit_emitter_kind<F>(k, [&](const EmitterKernels<F> &emitter) {
                flags = one ? UIntOf<F>(emitter.flags)
                            : select(mask<UIntOf<F>>(mask<F>(kind == k)), UIntOf<F>(emitter.flags), flags);
            });
    }
    TR_INLINE MaskOf<F> has(uint32_t flag) const { return mask<F>((flags & UIntOf<F>(flag)) != UIntOf<F>(0u)); }
};

// What emitters send from these points; beams are black, since nothing else sees them, unless they are `beams`.
template <class F>
TR_LARGE Spectrum<F> eval_emitter(const SceneOf<F> &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                                  const MaskOf<F> &active, bool beams = false);

// An emitter and a point on it for the reference point p: u0 chooses the emitter and, with what is left of it, the face
// of a mesh light; u1, u2 the point or direction.
template <class F>
TR_LARGE EmitterSample<F> sample_emitter(const SceneOf<F> &scene, const Vec3<F> &p, const F &u0, const F &u1,
                                         const F &u2, const MaskOf<F> &active);

// Density with which that chooses, for the reference point `from`, the point p of a shape's emitter.
template <class F>
TR_LARGE F shape_emitter_pdf(const SceneOf<F> &scene, const EmitterPoint<F> &point, const Vec3<F> &from,
                             const Vec3<F> &p, const Vec3<F> &n, const MaskOf<F> &active);

// The environment in direction d as an emitter point, and the density with which it is chosen.
template <class F>
TR_LARGE EmitterPoint<F> environment_point(const SceneOf<F> &scene, const Vec3<F> &d, F &pdf, const MaskOf<F> &active);

// Where a path of light begins; `choice` chooses the emitter, for the others see EmitterKernels::sample_emission.
template <class F>
TR_LARGE EmissionSample<F> sample_emission(const SceneOf<F> &scene, const F &choice, const F &a, const F &b, const F &c,
                                           const F &d, const MaskOf<F> &active);

}  // namespace tr
