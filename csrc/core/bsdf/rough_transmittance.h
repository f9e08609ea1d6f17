// What a rough coating lets through, tabulated by the cosine: the part of the light that its microfacets refract and
// that reaches the base, and what the coating throws back of diffuse light from below. Rows of 4 numbers: a value, its
// derivatives in the index and in the roughness, and nothing; the first row is of internal reflection, the others are
// of transmission at equally spaced cosines from 0 to 1.
#pragma once

#include "../math/dual.h"

namespace tr {

struct RoughTransmittanceSize {
    static constexpr int Cosines = 64, Rows = 1 + Cosines, Numbers = 4 * Rows;
};

template <class T>
struct RoughTransmittance {
    using F = std::decay_t<decltype(value_of(std::declval<T>()))>;
    using S = ScalarOf<F>;

    const S *numbers;
    const IntOf<F> &first;  // where the table of each lane begins
    T eta, alpha;           // for which it was made
    MaskOf<F> active;

    TR_INLINE T internal_reflectance() const {
        F row[4];
        gather_few_rows<F>(numbers, UIntOf<F>(first), active, row);
        return assemble(T(F(0)), row[0], F(0), row[1], row[2]);
    }
    // Linear between cosines.
    TR_INLINE T transmittance(const T &cosine) const {
        constexpr int n = RoughTransmittanceSize::Cosines;
        F x = min(max(value_of(cosine), F(0)), F(1)) * F(n - 1), cell = min(floor(x), F(n - 2)), t = x - cell;
        UIntOf<F> at = UIntOf<F>(first) + (UIntOf<F>(IntOf<F>(cell)) + 1u) * 4u;
        F a[4], b[4];
        gather_few_rows<F>(numbers, at, active, a);
        gather_few_rows<F>(numbers, at + 4u, active, b);
        F slope = (b[0] - a[0]) * F(n - 1);
        for (int i = 0; i < 3; ++i) a[i] = fmadd(t, b[i] - a[i], a[i]);
        return assemble(cosine, a[0], slope, a[1], a[2]);
    }

private:
    TR_INLINE T assemble(const T &cosine, const F &value, const F &by_cosine, const F &by_eta,
                         const F &by_alpha) const {
        return with_value(cosine * T(by_cosine) + eta * T(by_eta) + alpha * T(by_alpha), value);
    }
};

}  // namespace tr
