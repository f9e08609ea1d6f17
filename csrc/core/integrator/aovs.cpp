#include "aovs.h"

namespace tr {

namespace {

// Those of the BSDF follow each other.
constexpr int FirstBsdfAov = AovAlbedo, LastBsdfAov = AovRoughness;
TR_INLINE BsdfAov bsdf_aov(int kind) {
    return kind == AovAlbedo ? BsdfAov::Albedo : kind == AovSpecular ? BsdfAov::Specular : BsdfAov::Roughness;
}

template <class F>
TR_INLINE MaskOf<F> met_from_behind(const FirstHit<F> &hit) {
    return mask<F>(dot(hit.si.frame.n, hit.ray.d) > F(0));
}

// A colour of which the sink of a luminance gets one number.
template <class F>
TR_INLINE Spectrum<F> only_first(Spectrum<F> g) {
    for (int c = 1; c < SpectrumSize; ++c) g[c] = F(0);
    return g;
}

// Calls visit(attribute, its rows, lanes) where meshes have the colours of output k.
template <class F, class Visit>
TR_INLINE void each_attribute(const AovContext<F> &c, int k, const FirstHit<F> &hit, const MaskOf<F> &active,
                              Visit &&visit) {
    const int32_t name = c.layout.attributes[size_t(k)];
    for_each_distinct<F>(IntOf<F>(hit.si.at.shape), active, [&](int32_t shape, const MaskOf<F> &lanes) {
        int32_t a = c.scene.shapes[shape].first_attribute;
        while (a >= 0 && c.scene.attributes[a].name != name) a = c.scene.attributes[a].next;
        if (a < 0) return;
        const AttributeInfo &info = c.scene.attributes[a];
        visit(info, MeshAttribute::footprint<F>(c.scene, info, uint32_t(shape), hit.si.at, lanes), lanes);
    });
}

}  // namespace

template <class F>
TR_LARGE void eval_aovs(const AovContext<F> &c, const FirstHit<F> &hit, const MaskOf<F> &active, F *value) {
    const AovLayout &layout = c.layout;
    const Interaction<F> &si = hit.si;
    auto number = [&](int kind, int k, const F &x) { value[layout.offset[kind] + k] = x; };
    auto vector = [&](int kind, const Vec3<F> &v) { number(kind, 0, v.x), number(kind, 1, v.y), number(kind, 2, v.z); };
    auto color = [&](int kind, const Spectrum<F> &v) {
        const Spectrum<F> shown = kind == AovRoughness ? v : hit.colors.channels(v);
        for (int k = 0; k < layout.count(kind); ++k) number(kind, k, shown[k]);
    };
    auto axis = [&](int k) { return widen<F>(c.camera.axis[k]); };
    auto turned = [&](const Vec3<F> &v) { return Vec3<F>{dot(v, axis(0)), dot(v, axis(1)), dot(v, axis(2))}; };
    auto wants = [&](int kind) { return layout.wants(kind); };
    if (wants(AovDepth)) number(AovDepth, 0, dot(si.p - widen<F>(c.camera.origin), axis(2)));
    if (wants(AovDistance)) number(AovDistance, 0, norm(si.p - hit.center));
    if (wants(AovRayLength)) number(AovRayLength, 0, dot(si.p - hit.first, hit.ray.d));
    if (wants(AovPosition)) vector(AovPosition, si.p);
    if (wants(AovNormal)) vector(AovNormal, si.ng);
    if (wants(AovShadingNormal)) vector(AovShadingNormal, si.frame.n);
    if (wants(AovNormalCamera)) vector(AovNormalCamera, turned(si.ng));
    if (wants(AovShadingNormalCamera)) vector(AovShadingNormalCamera, turned(si.frame.n));
    if (wants(AovUv)) {
        Vec2<F> uv = texture_coordinates<F>(c.scene, static_cast<const SurfacePoint<F> &>(si.at), active);
        number(AovUv, 0, uv.x), number(AovUv, 1, uv.y);
    }
    if (wants(AovBarycentric)) number(AovBarycentric, 0, si.at.b1), number(AovBarycentric, 1, si.at.b2);
    if (wants(AovPartialU) || wants(AovPartialV)) {
        PositionPartials<F> partials = position_partials(c.scene, si.at, si.shape, active);
        if (wants(AovPartialU)) vector(AovPartialU, partials.u);
        if (wants(AovPartialV)) vector(AovPartialV, partials.v);
    }
    for (int kind = FirstBsdfAov; kind <= LastBsdfAov; ++kind)
        if (wants(kind))
            color(kind, eval_bsdf_aov(c.scene, hit.colors.waves(), bsdf_aov(kind), si.shape.bsdf, met_from_behind(hit),
                                      si.at, active));
    for (int k = 0; k < AovAttributes; ++k) {
        if (!wants(AovAttribute + k)) continue;
        Spectrum<F> found = uniform_spectrum(F(0));
        each_attribute(c, k, hit, active, [&](const AttributeInfo &info, const Footprint<F, 3> &at, const auto &lanes) {
            const auto &tensor = c.scene.values.tensors[info.tensor];
            found = select(lanes, gather_footprint(tensor, hit.colors.waves(), at, lanes), found);
        });
        color(AovAttribute + k, found);
    }
}

namespace {

// What a channel is linear in: textures, numbers and colours of meshes.
template <class F>
TR_INLINE void sweep_values(const AovContext<F> &c, const FirstHit<F> &hit, const GradientNeeds &needs,
                            const MaskOf<F> &active, F *value, GradientSink<F> &sink) {
    auto sweep = [&](int kind, auto &&give) {
        F *to = value + c.layout.offset[kind];
        const int channels = c.layout.count(kind);
        Spectrum<F> g = uniform_spectrum(F(1));
        if (!sink.forward)
            for (int k = 0; k < SpectrumSize; ++k) g[k] = k < channels ? to[k] : F(0);
        const bool colored = kind != AovRoughness;
        if (!sink.forward && colored) g = hit.colors.pull(g);
        sink.component = 0;
        sink.begin(hit.colors.waves());
        give(g);
        if (!sink.forward) return;
        const Spectrum<F> shown = colored ? hit.colors.channels(sink.derivative) : sink.derivative;
        for (int k = 0; k < channels; ++k) to[k] = shown[k];
    };
    for (int kind = FirstBsdfAov; kind <= LastBsdfAov; ++kind) {
        if (!c.layout.wants(kind) || !needs.bsdf) continue;
        CoordinateAdjoint<F> none;
        sweep(kind, [&](const Spectrum<F> &g) {
            sweep_bsdf_aov(c.scene, bsdf_aov(kind), hit.si.shape.bsdf, met_from_behind(hit), hit.si.at,
                           kind == AovRoughness ? only_first(g) : g, true, false, active, none, sink);
        });
    }
    for (int k = 0; k < AovAttributes; ++k) {
        if (!c.layout.wants(AovAttribute + k)) continue;
        sweep(AovAttribute + k, [&](const Spectrum<F> &g) {
            each_attribute(c, k, hit, active,
                           [&](const AttributeInfo &info, const Footprint<F, 3> &at, const MaskOf<F> &lanes) {
                               sink.footprint(c.scene, info.tensor, at, g, lanes);
                           });
        });
    }
}

// What moves the hit, its normals or the look-up there; given(channel) is the adjoint of a channel.
template <class F, class Given>
TR_INLINE void sweep_motion(const AovContext<F> &c, const FirstHit<F> &hit, const GradientNeeds &needs,
                            const MaskOf<F> &active, GradientSink<F> &sink, Given &&given) {
    const AovLayout &layout = c.layout;
    auto number = [&](int kind, int k) { return layout.wants(kind) ? given(layout.offset[kind] + k) : F(0); };
    auto vector = [&](int kind) { return Vec3<F>{number(kind, 0), number(kind, 1), number(kind, 2)}; };
    auto color = [&](int kind) {
        Spectrum<F> r = uniform_spectrum(F(0));
        for (int k = 0; k < layout.count(kind); ++k) r[k] = number(kind, k);
        return kind == AovRoughness ? r : hit.colors.pull(r);
    };
    OutputAdjoint<F> g;
    g.depth = number(AovDepth, 0);
    g.distance = number(AovDistance, 0);
    g.ray_length = number(AovRayLength, 0);
    g.position = vector(AovPosition);
    g.normal = vector(AovNormal);
    g.shading_normal = vector(AovShadingNormal);
    g.normal_camera = vector(AovNormalCamera);
    g.shading_normal_camera = vector(AovShadingNormalCamera);
    g.at.uv = {number(AovUv, 0), number(AovUv, 1)};
    g.at.b = {number(AovBarycentric, 0), number(AovBarycentric, 1)};
    g.partial_u = vector(AovPartialU);
    g.partial_v = vector(AovPartialV);
    const Interaction<F> &si = hit.si;
    for (int kind = FirstBsdfAov; kind <= LastBsdfAov; ++kind)
        if (layout.wants(kind))
            sweep_bsdf_aov(c.scene, bsdf_aov(kind), si.shape.bsdf, met_from_behind(hit), si.at, color(kind), false,
                           true, active, g.at, sink);
    for (int k = 0; k < AovAttributes; ++k) {
        if (!layout.wants(AovAttribute + k)) continue;
        each_attribute(
            c, k, hit, active, [&](const AttributeInfo &info, const Footprint<F, 3> &at, const MaskOf<F> &lanes) {
                sweep_attribute(c.scene, hit.colors.waves(), info, at, F(1), color(AovAttribute + k), lanes, g.at);
            });
    }
    sweep_outputs(c.scene, c.sensor, c.camera, hit.sample, c.width, c.height, hit.center, hit.ray.d, si, g,
                  needs.camera, layout.wants(AovPartialU) || layout.wants(AovPartialV), active, sink);
}

}  // namespace

template <class F>
TR_LARGE void sweep_aovs(const AovContext<F> &c, const FirstHit<F> &hit, const GradientNeeds &needs,
                         const MaskOf<F> &active, F *value, GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    sweep_values(c, hit, needs, active, value, sink);
    if (!needs.geometry) return;
    if (!sink.forward) return sweep_motion(c, hit, needs, active, sink, [&](int channel) { return value[channel]; });
    sink.component = 0;  // one number after the other, whatever it is
    for (int k = 0; k < c.layout.n; ++k) {
        sink.begin(hit.colors.waves());
        sweep_motion(c, hit, needs, active, sink, [&](int channel) { return F(channel == k ? S(1) : S(0)); });
        value[k] = value[k] + sink.derivative[0];
    }
}

#define TR_INSTANTIATE(F, S)                                                                                       \
    template void eval_aovs(const AovContext<F> &, const FirstHit<F> &, const MaskOf<F> &, F *);                   \
    template void sweep_aovs(const AovContext<F> &, const FirstHit<F> &, const GradientNeeds &, const MaskOf<F> &, \
                             F *, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
