// The models of this build, one line each. The position in a list is the model's kind. BSDFs, emitters and phase
// functions are known by their names alone: whoever uses one goes by its table (bsdf/bsdf.h, emitter/emitter.h,
// phase/phase.h).
#pragma once

#include "bsdf/blendbsdf.h"
#include "bsdf/bsdf.h"
#include "bsdf/bumpmap.h"
#include "bsdf/mask.h"
#include "bsdf/normalmap.h"
#include "bsdf/twosided.h"
#include "emitter/emitter.h"
#include "medium/medium.h"
#include "sensor/distant.h"
#include "sensor/fisheye.h"
#include "sensor/irradiancemeter.h"
#include "sensor/orthographic.h"
#include "sensor/panorama.h"
#include "sensor/perspective.h"
#include "sensor/radiancemeter.h"
#include "sensor/thinlens.h"
#include "shape/models.h"
#include "texture/texture.h"

// Those that scatter; each is a file in bsdf/.
#define TR_BSDFS(X)          \
    X(Diffuse)               \
    X(NullBsdf)              \
    X(Dielectric)            \
    X(Conductor)             \
    X(RoughDielectric)       \
    X(RoughConductor)        \
    X(Plastic)               \
    X(ThinDielectric)        \
    X(Principled)            \
    X(RoughPlastic)          \
    X(PolarimetricPlastic)   \
    X(PrincipledThin)        \
    X(RednerMaterial)        \
    X(Hair)                  \
    X(AnisotropicConductor)  \
    X(AnisotropicDielectric) \
    X(DispersiveDielectric)  \
    X(Polarizer)             \
    X(Retarder)              \
    X(CircularPolarizer)

namespace tr {

using Textures = TypeList<ConstantTexture, Bitmap, Checkerboard, MeshAttribute, VolumeTexture>;
// (Emitters: emitter/emitter.h, phase functions: phase/phase.h.)
using Shapes = TypeList<MeshModel, SphereModel, DiskModel, RectangleModel, HeightFieldModel, CylinderModel,
                        BSplineCurveModel, LinearCurveModel, SdfGridModel>;
using Sensors =
    TypeList<Perspective, IrradianceMeter, ThinLens, Orthographic, Fisheye, Panorama, RadianceMeter, Distant>;
using Volumes = TypeList<ConstantVolume, GridVolume>;
using Media = TypeList<HomogeneousMedium, HeterogeneousMedium, GradientIndexMedium>;
using Attributes = TypeList<AttributeModel>;

// BSDFs that are resolved to one of those they contain, where a path meets them (integrator/bsdf_stack.h).
using BsdfWrappers = TypeList<TwoSided, BlendBsdf, MaskBsdf, NormalMap, BumpMap>;

#define TR_NAME(M) struct M;
TR_BSDFS(TR_NAME)
#undef TR_NAME
struct MaskHole;
struct GradientDielectric;

// What a path can meet: the BSDFs, the holes of masks, and dielectrics around media that light bends in.
#define TR_NAME(M) M,
using Bsdfs = TypeList<TR_BSDFS(TR_NAME) MaskHole, GradientDielectric>;
#undef TR_NAME

constexpr int NullKind = kind_of_model<NullBsdf>(Bsdfs{}), MaskHoleKind = kind_of_model<MaskHole>(Bsdfs{});
constexpr int DielectricKind = kind_of_model<Dielectric>(Bsdfs{}),
              GradientDielectricKind = kind_of_model<GradientDielectric>(Bsdfs{});
// Records of wrappers have these kinds.
constexpr int FirstWrapper = GradientDielectricKind + 1;
constexpr int TwoSidedKind = FirstWrapper + kind_of_model<TwoSided>(BsdfWrappers{});
constexpr int BlendKind = FirstWrapper + kind_of_model<BlendBsdf>(BsdfWrappers{});
constexpr int MaskKind = FirstWrapper + kind_of_model<MaskBsdf>(BsdfWrappers{});
constexpr int NormalMapKind = FirstWrapper + kind_of_model<NormalMap>(BsdfWrappers{});
constexpr int BumpMapKind = FirstWrapper + kind_of_model<BumpMap>(BsdfWrappers{});
constexpr bool perturbs_normals(int kind) { return kind == NormalMapKind || kind == BumpMapKind; }

// The table of a BSDF, by its kind.
template <class F>
TR_HD const BsdfKernels<F> &bsdf_kernels(int kind);

}  // namespace tr
