// What samples of outlines are kept in, and where single numbers of their derivatives go.
#pragma once

#include <array>

#include "arena.h"
#include "boundary_call.h"
#include "core/adjoint/polarization.h"
#include "core/boundary/samples.h"

namespace tr {

// By number, up to three a slot: points that are glued to surfaces.
// clang-format off
#define TR_GLUED_COLUMNS(X) X(Index, slot) X(Point, at) X(Vector, p) X(Vector, p_bar)
// clang-format on
// By slot: the place on the lens, of `distant`, which sees a point through one of them.
#define TR_LENS_COLUMNS(X) X(Pair, lens)
template <class S>
struct LensColumns {
    TR_COLUMNS(TR_LENS_COLUMNS)
};
template <class S>
struct GluedColumns {
    TR_COLUMNS(TR_GLUED_COLUMNS)
    uint32_t n = 0;
};

// By slot, of polarised light: a row at the chosen vertex, for one of the film's Stokes components.
// clang-format off
#define TR_ROW_COLUMNS(X) X(Spectrum, i) X(Spectrum, q) X(Spectrum, u) X(Spectrum, v) X(Vector, axis)
// clang-format on
template <class S>
struct RowColumns {
    TR_COLUMNS(TR_ROW_COLUMNS)
    Stokes<S> get(size_t slot) const {
        Stokes<S> r{{}, axis.get(slot)};
        const SpectrumColumn<S> columns[] = {i, q, u, v};
        for (int k = 0; k < 4; ++k)
            for (int c = 0; c < SpectrumSize; ++c) r.at[k][c] = columns[k][c][slot];
        return r;
    }
};
// One for each of them.
template <class S>
using StokesRows = std::array<Stokes<S>, 4>;

// A sink of single numbers, beside that of packets.
template <class F>
struct PointSink {
    using S = ScalarOf<F>;
    const GradientSink<F> &sink;
    S derivative = 0;  // forward mode

    bool wants(uint32_t shape) const { return sink.shape_wanted[shape] != 0; }
    void vertex(uint32_t index, const Vec3<S> &g, VertexArray array = VertexArray::Positions) {
        const S *tangent = sink.vertex_tangent[size_t(array)];
        double *to = sink.vertices[size_t(array)];
        const S v[3] = {g.x, g.y, g.z};
        for (size_t i = 0; i < 3; ++i)
            if (!sink.forward && to)
                to[3 * size_t(index) + i] += double(v[i]);
            else if (sink.forward && tangent)
                derivative += tangent[3 * size_t(index) + i] * v[i];
    }
    void number(size_t offset, S g) {
        if (sink.forward)
            derivative += sink.tangent.constants[offset] * g;
        else
            sink.constants[offset] += double(g);
    }
    void matrix(uint32_t shape, const Vec3<S> &local, const Vec3<S> &g) {
        const S row[3] = {g.x, g.y, g.z}, column[4] = {local.x, local.y, local.z, S(1)};
        for (size_t i = 0; i < 12; ++i) number(sink.matrices + 12 * size_t(shape) + i, row[i / 4] * column[i % 4]);
    }
};

}  // namespace tr
