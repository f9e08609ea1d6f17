// The models of this build, one line each. The position in a list is the model's kind.
#pragma once

#include "bsdf/anisotropicconductor.h"
#include "bsdf/anisotropicdielectric.h"
#include "bsdf/blendbsdf.h"
#include "bsdf/bumpmap.h"
#include "bsdf/conductor.h"
#include "bsdf/dielectric.h"
#include "bsdf/diffuse.h"
#include "bsdf/mask.h"
#include "bsdf/normalmap.h"
#include "bsdf/null.h"
#include "bsdf/plastic.h"
#include "bsdf/principled.h"
#include "bsdf/principledthin.h"
#include "bsdf/redner.h"
#include "bsdf/roughconductor.h"
#include "bsdf/roughdielectric.h"
#include "bsdf/roughplastic.h"
#include "bsdf/thindielectric.h"
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

namespace tr {

using Textures = TypeList<ConstantTexture, Bitmap, Checkerboard, MeshAttribute, VolumeTexture>;
// The ones that scatter, and those that are resolved to one of them at a hit.
using Bsdfs =
    TypeList<Diffuse, NullBsdf, Dielectric, Conductor, RoughDielectric, RoughConductor, Plastic, ThinDielectric,
             Principled, RoughPlastic, PrincipledThin, RednerMaterial, AnisotropicConductor, AnisotropicDielectric>;
using BsdfWrappers = TypeList<TwoSided, BlendBsdf, MaskBsdf, NormalMap, BumpMap>;
// (Emitters: emitter/emitter.h, which chooses among them.)
using Shapes = TypeList<MeshModel, SphereModel, DiskModel, RectangleModel, HeightFieldModel, CylinderModel>;
using Sensors =
    TypeList<Perspective, IrradianceMeter, ThinLens, Orthographic, Fisheye, Panorama, RadianceMeter, Distant>;
using Volumes = TypeList<ConstantVolume, GridVolume>;
using Phases = TypeList<Isotropic, HenyeyGreenstein, Rayleigh, TabulatedPhase, BlendPhase>;
using Media = TypeList<HomogeneousMedium, HeterogeneousMedium>;
using Attributes = TypeList<AttributeModel>;

// Records of wrappers have these kinds.
constexpr int TwoSidedKind = Bsdfs::Size + kind_of_model<TwoSided>(BsdfWrappers{});
constexpr int BlendKind = Bsdfs::Size + kind_of_model<BlendBsdf>(BsdfWrappers{});
constexpr int MaskKind = Bsdfs::Size + kind_of_model<MaskBsdf>(BsdfWrappers{});
constexpr int NormalMapKind = Bsdfs::Size + kind_of_model<NormalMap>(BsdfWrappers{});
constexpr int BumpMapKind = Bsdfs::Size + kind_of_model<BumpMap>(BsdfWrappers{});
constexpr bool turns_normals(int kind) { return kind == NormalMapKind || kind == BumpMapKind; }

// What a path can meet: the BSDFs, and the holes of masks.
template <class... Ts>
constexpr auto with_openings(TypeList<Ts...>) {
    return TypeList<Ts..., Opening>{};
}
using LeafBsdfs = decltype(with_openings(Bsdfs{}));
constexpr int OpeningKind = kind_of_model<Opening>(LeafBsdfs{});

}  // namespace tr
