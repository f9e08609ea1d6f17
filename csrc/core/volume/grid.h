// `gridvolume`: values on a grid over the unit cube [0, 1]^3 of the volume's own space. Voxel (k, j, i) of (Z, Y, X) is
// centred at x = (i + 0.5) / X, y = (j + 0.5) / Y, z = (k + 0.5) / Z.
#pragma once

#include "../texture/bitmap.h"

namespace tr {

struct GridVolume {
    static constexpr const char *Filters[] = {"trilinear", "nearest", nullptr};
    enum { Data, ToWorld, Filter, Wrap };
    static constexpr Field fields[] = {
        {"data", Kind::Tensor, None, -INFINITY, INFINITY, "interior", "voxels (Z, Y, X, channels)"},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, "interior",
         "from the unit cube that the grid fills to the world"},
        {"filter_type", Kind::Int, 0, 0, 1, "", "between voxels", Filters},
        {"wrap_mode", Kind::Int, 2, 0, 2, "", "beyond the cube", WrapModes},
    };
    static constexpr Model model = {"volume", "gridvolume", "Voxels, trilinear or nearest.", fields, 4,
                                    0,        "GridVolume"};

    // One axis: the voxels on both sides of x (in units of the cube) and the fraction between them. With `clamp` the
    // second always follows the first.
    template <class F, class S>
    struct Axis {
        IntOf<F> i0, i1;
        F a;

        TR_INLINE Axis(const F &x, int n, bool nearest, int wrap) {
            using I = IntOf<F>;
            F at = x * F(S(n)) - F(nearest ? 0.0 : 0.5);
            if (wrap == 2 && n > 1) {
                F low = max(F(0), min(floor(at), F(S(nearest ? n - 1 : n - 2))));
                i0 = I(low);
                i1 = nearest ? i0 : i0 + 1;
                a = nearest ? F(0) : max(F(0), min(F(1), at - low));
                return;
            }
            F low = floor(at);
            i0 = Bitmap::wrap<F>(I(low), n, wrap);
            i1 = Bitmap::wrap<F>(I(low) + 1, n, wrap);
            a = nearest ? F(0) : at - low;
        }
    };

    // p in the unit cube's space. Voxels 2 k and 2 k + 1 are neighbours along x.
    template <class F, class S>
    TR_INLINE static Footprint<F, 8> footprint(const TensorView<S> &grid, const Record &record, const Vec3<F> &p) {
        using U = UIntOf<F>;
        const bool nearest = record.field[Filter] == 1;
        const int wrap = record.field[Wrap], nx = grid.shape[1], ny = grid.shape[0], nz = grid.shape[3];
        Axis<F, S> x(p.x, nx, nearest, wrap), y(p.y, ny, nearest, wrap), z(p.z, nz, nearest, wrap);
        Footprint<F, 8> r;
        for (int k = 0; k < 4; ++k) {
            auto row = (k & 2 ? z.i1 : z.i0) * ny + (k & 1 ? y.i1 : y.i0);
            F w = (k & 2 ? z.a : F(1) - z.a) * (k & 1 ? y.a : F(1) - y.a);
            r.texel[2 * k] = U(row * nx + x.i0);
            r.texel[2 * k + 1] = U(row * nx + x.i1);
            r.weight[2 * k] = w * (F(1) - x.a);
            r.weight[2 * k + 1] = w * x.a;
        }
        return r;
    }

    // The derivative of a trilinear look-up by p, of numbers that the voxels of its footprint have. It is zero beyond
    // the outermost voxels of a grid that is clamped.
    template <class F, class S>
    TR_INLINE static Vec3<F> slope(const TensorView<S> &grid, const Record &record, const Vec3<F> &p,
                                   const Footprint<F, 8> &at, const F (&value)[8]) {
        const F *w = at.weight;
        const F xa = w[1] + w[3] + w[5] + w[7], ya = w[2] + w[3] + w[6] + w[7], za = w[4] + w[5] + w[6] + w[7];
        const F wx[2] = {F(1) - xa, xa}, wy[2] = {F(1) - ya, ya}, wz[2] = {F(1) - za, za};
        Vec3<F> r{F(0), F(0), F(0)};
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i < 2; ++i) {
                r.x = fmadd(wz[j] * wy[i], value[4 * j + 2 * i + 1] - value[4 * j + 2 * i], r.x);
                r.y = fmadd(wz[j] * wx[i], value[4 * j + 2 + i] - value[4 * j + i], r.y);
                r.z = fmadd(wy[j] * wx[i], value[4 + 2 * j + i] - value[2 * j + i], r.z);
            }
        const bool clamped = record.field[Wrap] == 2;
        auto axis = [&](const F &slope, const F &x, int n) {
            F cells = x * F(S(n)) - F(0.5);
            auto inside = mask<F>(cells > F(0)) && mask<F>(cells < F(S(n - 1)));
            return select(inside || MaskOf<F>(!clamped), slope * F(S(n)), F(0));
        };
        return {axis(r.x, p.x, grid.shape[1]), axis(r.y, p.y, grid.shape[0]), axis(r.z, p.z, grid.shape[3])};
    }
};

}  // namespace tr
