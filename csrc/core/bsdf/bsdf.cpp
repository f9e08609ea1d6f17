// The tables of all BSDFs.
#include "../registry.h"

namespace tr {

template <class M, class F>
TR_DEVICE_CONSTEXPR BsdfKernels<F> bsdf_kernels_of();

template <class F>
TR_HD const BsdfKernels<F> &bsdf_kernels([[maybe_unused]] int kind) {
#if defined(TR_ONE_BSDF)  // of the one that a kernel is compiled for
    static const BsdfKernels<F> only = bsdf_kernels_of<TR_ONE_BSDF, F>();
    return only;
#else
#define TR_TABLE(M) bsdf_kernels_of<M, F>(),
    static const BsdfKernels<F> all[] = {TR_BSDFS(TR_TABLE) bsdf_kernels_of<MaskHole, F>(),
                                         bsdf_kernels_of<GradientDielectric, F>()};
#undef TR_TABLE
    return all[kind];
#endif
}

#define TR_INSTANTIATE(F, S) template const BsdfKernels<F> &bsdf_kernels(int);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
