// `bitmap`: an image over texture coordinates. Texel (row i, column j) is centred at v = (i + 0.5) / rows,
// u = (j + 0.5) / columns; row 0 is at v = 0.
#pragma once

#include "../shape/surface.h"

namespace tr {

// The texels that a look-up touches and their weights: the look-up is linear in the data, so the same footprint gives
// the value, the reverse-mode derivative (scatter) and the forward-mode one (the value of the tangent).
template <class F, int N>
struct Footprint {
    UIntOf<F> texel[N];
    F weight[N];
};

// Columns x0, x1 and rows y0, y1 with the fractions a, b between them.
template <class F>
TR_INLINE Footprint<F, 4> bilinear_footprint(const IntOf<F> &x0, const IntOf<F> &x1, const IntOf<F> &y0,
                                             const IntOf<F> &y1, int columns, const F &a, const F &b) {
    Footprint<F, 4> r;
    r.texel[0] = UIntOf<F>(y0 * columns + x0);
    r.texel[1] = UIntOf<F>(y0 * columns + x1);
    r.texel[2] = UIntOf<F>(y1 * columns + x0);
    r.texel[3] = UIntOf<F>(y1 * columns + x1);
    r.weight[0] = (F(1) - a) * (F(1) - b);
    r.weight[1] = a * (F(1) - b);
    r.weight[2] = (F(1) - a) * b;
    r.weight[3] = a * b;
    return r;
}

// Derivatives of a bilinear look-up with respect to its column and row: look-ups themselves.
template <class F>
struct Slopes {
    Footprint<F, 4> x, y;
};
template <class F>
TR_INLINE Slopes<F> slopes(const Footprint<F, 4> &at) {
    F a = at.weight[1] + at.weight[3], b = at.weight[2] + at.weight[3];
    Slopes<F> r{at, at};
    r.x.weight[0] = b - F(1), r.x.weight[1] = F(1) - b, r.x.weight[2] = -b, r.x.weight[3] = b;
    r.y.weight[0] = a - F(1), r.y.weight[1] = -a, r.y.weight[2] = F(1) - a, r.y.weight[3] = a;
    return r;
}

struct Bitmap {
    static constexpr const char *Filters[] = {"bilinear", "nearest", nullptr};
    enum { Data, ToUv, Filter, Wrap };
    static constexpr Field fields[] = {
        {"data", Kind::Tensor, None, -INFINITY, INFINITY, "interior",
         "texels (rows, columns, channels), linear; 1 channel is grey"},
        {"to_uv", Kind::Transform2, None, -INFINITY, INFINITY, "interior",
         "homogeneous 3x3 map of the texture coordinates, (u, v) -> image coordinates"},
        {"filter_type", Kind::Int, 0, 0, 1, "", "between texels", Filters},
        {"wrap_mode", Kind::Int, 0, 0, 2, "", "beyond the image", WrapModes},
    };
    static constexpr Model model = {"texture", "bitmap",
                                    "An image, bilinear or nearest, repeated, mirrored or clamped.", fields, 4};

    template <class F>
    TR_INLINE static IntOf<F> wrap(const IntOf<F> &i, int n, int mode) {
        using I = IntOf<F>;
        if (mode == 2) return max(I(0), min(I(n - 1), i));
        // i mod n through floating point: exact for the sizes and repetitions that single precision resolves
        int period = mode == 1 ? 2 * n : n;
        F q = floor((F(i) + F(0.5)) * F(1.0 / period));
        I r = i - I(q) * period;
        if (mode == 1) r = select(mask<I>(r >= n), I(2 * n - 1) - r, r);
        return max(I(0), min(I(n - 1), r));
    }

    template <class F, class S>
    TR_INLINE static Footprint<F, 4> footprint(const SceneView<S> &scene, const Record &record, const Vec2<F> &uv) {
        using I = IntOf<F>;
        const int32_t *shape = scene.values.tensors[record.field[Data]].shape;
        const S *m = scene.values.constants + record.field[ToUv];
        int rows = shape[0], columns = shape[1], mode = record.field[Wrap];
        bool nearest = record.field[Filter] == 1;
        F u = m[0] * uv.x + m[1] * uv.y + m[2], v = m[3] * uv.x + m[4] * uv.y + m[5];
        F x = u * F(S(columns)) - F(nearest ? 0.0 : 0.5), y = v * F(S(rows)) - F(nearest ? 0.0 : 0.5);
        F fx = floor(x), fy = floor(y), a = nearest ? F(0) : x - fx, b = nearest ? F(0) : y - fy;
        I x0 = wrap<F>(I(fx), columns, mode), y0 = wrap<F>(I(fy), rows, mode);
        I x1 = wrap<F>(I(fx) + 1, columns, mode), y1 = wrap<F>(I(fy) + 1, rows, mode);
        return bilinear_footprint<F>(x0, x1, y0, y1, columns, a, b);
    }
};

// The weighted sum of n rows of a tensor's channels, of which there are one, or as many as a spectrum has, or those of
// a spectrum's coefficients.
template <class F, class S>
TR_INLINE Spectrum<F> gather_taps(const TensorView<S> &tensor, const Wavelengths<F> &waves, const UIntOf<F> *texel,
                                  const F *weight, int n, const MaskOf<F> &active) {
    const int channels = tensor.shape[2];
    if (waves.spectral() && channels == SigmoidChannels)
        return sigmoid_texels(tensor.data, tensor.base, waves, texel, weight, n, active);
    Spectrum<F> r = uniform_spectrum(F(0));
    for (int i = 0; i < n; ++i) {
        F row[SpectrumSize];
        if (channels == SpectrumSize) {
            gather_rows<F>(tensor.data, texel[i] * uint32_t(SpectrumSize), active, row);
        } else {
            row[0] = gather<F>(tensor.data, texel[i], active);
            for (int c = 1; c < SpectrumSize; ++c) row[c] = row[0];
        }
        for (int c = 0; c < SpectrumSize; ++c) r[c] = fmadd(weight[i], row[c], r[c]);
    }
    return r;
}

// A colour, looked up.
template <class F, class S, int N>
TR_INLINE Spectrum<F> gather_footprint(const TensorView<S> &tensor, const Wavelengths<F> &waves,
                                       const Footprint<F, N> &at, const MaskOf<F> &active) {
    return gather_taps(tensor, waves, at.texel, at.weight, N, active);
}

}  // namespace tr
