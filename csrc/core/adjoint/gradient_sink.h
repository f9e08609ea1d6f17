// Where derivatives go. Reverse and forward mode are the same sweep: in reverse mode the sink adds g * d(look-up) /
// d(parameter) to the parameter's gradient, in forward mode g * (look-up of the tangent) to the derivative of the
// pixel. Look-ups are linear in the parameters, so both walk the same footprints.
//
// Two kinds of adjoints come in: a spectrum, component by component, for what multiplies radiance; and a number, the
// sum over components, for what moves points and directions. Numbers in forward mode need a sweep a component, see
// `component`.
#pragma once

#include "../texture/texture.h"
#include "fixed_sum.h"

namespace tr {

// Numbers of vertices: those of SceneView::vertices, array by array.
enum class VertexArray { Positions, Normals, Texcoords };
constexpr int VertexArrays = 3;

// What of a shape is differentiated: it moves, or its normals or coordinates do; and its matrix among what moves it.
enum ShapeWants : int32_t { ShapeMoves = 1, MatrixMoves = 2 };

// The texels of a look-up, however many they are.
template <class F>
struct Taps {
    static constexpr int Most = 16;
    const UIntOf<F> *texel;
    const F *weight;
    int n;

    template <int N>
    TR_INLINE Taps(const Footprint<F, N> &at) : texel(at.texel), weight(at.weight), n(N) {
        static_assert(N <= Most, "there is room");
    }
};

template <class F>
class GradientSink {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    using Scene = SceneView<S>;

public:
    TR_FACT(bool, forward, TR_FORWARD) = false;
    // The matrices of curved shapes, 12 numbers a shape, follow the block of small parameters, at `matrices`.
    uint32_t matrices = 0;
    const int32_t *shape_wanted = nullptr;  // by shape, see ShapeWants
    uint32_t non_finite = 0;
    Wavelengths<F> waves;  // of the packet that is swept

    // reverse mode: the gradient of the block of small parameters; of large tensors by slot, null where it is not
    // wanted; of vertices, null without meshes that have one
    double *constants = nullptr;
    uint32_t copies = 1;  // of each of them, side by side, one of which is added to; of devices, and 1 with packets
    S *const *tensors = nullptr;
    double *vertices[VertexArrays] = {};
    // ... of devices: all of these are FixedSums, whose largest numbers are found, or which are added to
    TR_FACT(bool, fixed, TR_FIXED_SUMS) = false;
    bool measures = false;

    // forward mode
    Values<S> tangent{};
    const S *vertex_tangent[VertexArrays] = {};
    int component = 0;       // to which numbers belong
    Spectrum<F> derivative;  // of the radiance of the paths in the lanes, since begin()

    TR_INLINE void begin(const Wavelengths<F> &of = {}) {
        waves = of;
        derivative = uniform_spectrum(F(0));
    }

    // Of a texture's value, of its luminance, and of one whose channels are the components of a vector.
    TR_LARGE void texture(const Scene &, const I &id, const TexturedPoint<F> &at, const Spectrum<F> &g,
                          const M &active);
    TR_LARGE void texture(const Scene &, const I &id, const SurfacePoint<F> &at, const Spectrum<F> &g, const M &active);
    TR_LARGE void scalar_texture(const Scene &, const I &id, const TexturedPoint<F> &at, const Spectrum<F> &g,
                                 const M &active);
    // Of the function of this name, in the spectral variant.
    TR_LARGE void daylight_luminance(const Scene &, const I &id, const TexturedPoint<F> &at, const Spectrum<F> &g,
                                     const M &active);
    TR_LARGE void vector_texture(const Scene &, const I &id, const TexturedPoint<F> &at, const Vec3<F> &g,
                                 const M &active);
    // Of a colour in the block of small parameters, a number that is the same for all components, and a number whose
    // adjoint is one.
    TR_LARGE void spectrum(const I &offset, const Spectrum<F> &g, const M &active);
    TR_LARGE void number(const I &offset, const Spectrum<F> &g, const M &active);
    TR_LARGE void scalar(const I &offset, const F &g, const M &active);
    // Of rows of a tensor, with weights.
    TR_LARGE void footprint(const Scene &, int32_t slot, const Taps<F> &at, const Spectrum<F> &g, const M &active);
    // ... of their luminance, and of numbers in a tensor of one channel; the weights are multiplied by the adjoint.
    TR_LARGE void luminance_footprint(const Scene &, int32_t slot, const Taps<F> &at, const M &active);
    TR_LARGE void taps(int32_t slot, const Taps<F> &at, const M &active);
    // Of the trapezoidal rule over all n numbers of a tensor of one channel: `inner` times each but the first and the
    // last, which count half.
    TR_LARGE void trapezoid(int32_t slot, int32_t n, S inner, const Spectrum<F> &g, const M &active);
    // Of a number in a vertex array.
    TR_LARGE void vertex(VertexArray, const U &index, const F &g, const M &active);
    // Of a volume's data at p.
    TR_LARGE void volume(const Scene &, int32_t index, const Vec3<F> &p, const Spectrum<F> &g, const M &active);

    // In forward mode: a number whose adjoint is one has this tangent.
    TR_LARGE void number_tangent(const F &d, const M &active);

    TR_INLINE M wants_shape(const U &shape, const M &active) const { return wants(shape, ShapeMoves, active); }
    TR_INLINE M wants_matrix(const U &shape, const M &active) const { return wants(shape, MatrixMoves, active); }

private:
    TR_INLINE M wants(const U &shape, int32_t what, const M &active) const {
        return active && mask<F>((gather<I>(shape_wanted, shape, mask<I>(active)) & what) != 0);
    }
    template <class Point>
    TR_HD void any_texture(const Scene &, const I &id, const Point &at, const Spectrum<F> &g, const M &active);
    TR_HD M count_finite(const M &usable, const M &active);
    template <class Index>
    TR_HD Index constant(const Index &offset) const;
    template <class T>
    TR_HD void put(T *to, size_t index, T value) const;
    TR_HD void add(double *to, const U &index, const F &g, const M &active);
    TR_HD void add_derivative(const Spectrum<F> &d, const M &active);
    TR_HD void add_derivative(const F &d, const M &active);
    // of the spectral variant
    TR_HD void add_to_tables(const I &offset, const Spectrum<F> &g, const M &active);
    TR_HD void add_sigmoid_texels(const TensorView<S> &, S *gradient, const Taps<F> &at, const Spectrum<F> &g,
                                  const M &active);

    struct Scatter;
};

}  // namespace tr
