#include "upsampling.h"

#include "host/parallel.h"
#include "packet_rows.h"

namespace tr {

namespace {

template <class F, class Visit>
void for_colours(const UpsamplingCall<ScalarOf<F>> &call, Visit &&visit) {
    for_ranges(call.n, call.threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; i += size_t(Lanes<F>::Width)) visit(PacketRows<F>(i, end));
    });
}

// With the derivatives by the three channels.
template <class F>
void differentiate(const UpsamplingCall<ScalarOf<F>> &call, const PacketRows<F> &rows,
                   Dual<F, 3> (&out)[SigmoidChannels]) {
    Dual<F, 3> rgb[3];
    for (int k = 0; k < 3; ++k) rgb[k] = Dual<F, 3>(rows.number(call.rgb, 3, size_t(k)), k);
    upsample_colour<F>(call.table, call.light, rgb, out);
}

}  // namespace

template <class S>
void upsample(const UpsamplingCall<S> &call, S *out) {
    using F = PacketOf<S>;
    for_colours<F>(call, [&](const PacketRows<F> &rows) {
        const F rgb[3] = {rows.number(call.rgb, 3, 0), rows.number(call.rgb, 3, 1), rows.number(call.rgb, 3, 2)};
        F found[SigmoidChannels];
        upsample_colour<F>(call.table, call.light, rgb, found);
        for (size_t c = 0; c < SigmoidChannels; ++c) rows.put(out, found[c], SigmoidChannels, c);
    });
}

template <class S>
void upsample_reverse(const UpsamplingCall<S> &call, const S *adjoint, S *out) {
    using F = PacketOf<S>;
    for_colours<F>(call, [&](const PacketRows<F> &rows) {
        Dual<F, 3> found[SigmoidChannels];
        differentiate(call, rows, found);
        F sum[3] = {F(0), F(0), F(0)};
        for (size_t c = 0; c < SigmoidChannels; ++c) {
            const F g = rows.number(adjoint, SigmoidChannels, c);
            for (int k = 0; k < 3; ++k) sum[k] = fmadd(g, found[c].d[k], sum[k]);
        }
        for (size_t k = 0; k < 3; ++k) rows.put(out, sum[k], 3, k);
    });
}

template <class S>
void upsample_forward(const UpsamplingCall<S> &call, const S *tangent, S *out) {
    using F = PacketOf<S>;
    for_colours<F>(call, [&](const PacketRows<F> &rows) {
        Dual<F, 3> found[SigmoidChannels];
        differentiate(call, rows, found);
        const F t[3] = {rows.number(tangent, 3, 0), rows.number(tangent, 3, 1), rows.number(tangent, 3, 2)};
        for (size_t c = 0; c < SigmoidChannels; ++c)
            rows.put(out, found[c].d[0] * t[0] + found[c].d[1] * t[1] + found[c].d[2] * t[2], SigmoidChannels, c);
    });
}

#define TR_INSTANTIATE(S)                                                      \
    template void upsample(const UpsamplingCall<S> &, S *);                    \
    template void upsample_reverse(const UpsamplingCall<S> &, const S *, S *); \
    template void upsample_forward(const UpsamplingCall<S> &, const S *, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
