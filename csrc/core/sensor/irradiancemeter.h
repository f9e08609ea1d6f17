// `irradiancemeter`: what arrives on the front of a surface, per area; a pixel of the film is a part of the square of
// its texture coordinates, row 0 at v = 0. Measured where light paths hit the surface, whatever its BSDF.
#pragma once

#include "../shape/surface.h"
#include "connection.h"

namespace tr {

struct IrradianceMeter {
    enum { ShapeIndex };
    static constexpr Field fields[] = {
        {"shape", Kind::Shape, None, 0, INFINITY, "", "the rectangle, or mesh with texture coordinates, it lies on"},
    };
    static constexpr Model model = {"sensor", "irradiancemeter", "Irradiance on a surface.", fields, 1,
                                    0,        "IrradianceMeter"};

    // What light that travels along d brings to the film where it has hit `shape`. Importance is texels per area.
    template <class F, class S>
    TR_NOINLINE static Connection<F> measure(const SceneView<S> &scene, int32_t shape, const Interaction<F> &si,
                                             const Vec3<F> &d, S width, S height, const MaskOf<F> &active) {
        Connection<F> r{};
        r.seen = active && mask<F>(si.at.shape == uint32_t(shape)) && mask<F>(dot(si.ng, d) < F(0));
        if (!any(r.seen)) return r;
        Corners<F> corners;
        Triangle<F, S> face(scene, UIntOf<F>(si.shape.face_offset) + si.at.primitive, r.seen, r.seen, corners);
        Vec2<F> e1{corners.uv[1].x - corners.uv[0].x, corners.uv[1].y - corners.uv[0].y};
        Vec2<F> e2{corners.uv[2].x - corners.uv[0].x, corners.uv[2].y - corners.uv[0].y};
        F area = norm(cross(face.e1, face.e2));
        r.seen = r.seen && mask<F>(area > F(0));
        r.importance = abs(e1.x * e2.y - e1.y * e2.x) * F(width * height) / select(r.seen, area, F(1));
        r.x = si.at.uv.x * F(width);
        r.y = si.at.uv.y * F(height);
        // beyond the film nothing is averaged
        r.seen = r.seen && mask<F>(r.x >= F(0)) && mask<F>(r.x <= F(width)) && mask<F>(r.y >= F(0)) &&
                 mask<F>(r.y <= F(height));
        return r;
    }
};

constexpr int IrradianceMeterKind = 1;  // in the registry

}  // namespace tr
