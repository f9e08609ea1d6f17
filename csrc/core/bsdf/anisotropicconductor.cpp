// `roughconductor` whose roughness differs along the surface: alpha_u in the direction of dp/du, made orthogonal to the
// shading normal, and alpha_v in the direction orthogonal to both, as of brushed metal. Below 0.001 either counts as
// that. (In Python it is the class that RoughConductor makes of alpha_u and alpha_v.)
#include "microfacet_conductor.h"

namespace tr {

struct AnisotropicConductor : MicrofacetConductor<AnisotropicConductor> {
    static constexpr Field fields[] = {
        {"alpha_u", Kind::Scalar, 0.1, 0, 10, "interior", "roughness along the tangent dp/du, at least 0.001"},
        {"alpha_v", Kind::Scalar, 0.1, 0, 10, "interior", "roughness across it, at least 0.001"},
        {"eta", Kind::Texture, 0, 0, INFINITY, "interior", "real part of the index of refraction"},
        {"k", Kind::Texture, 1, 0, INFINITY, "interior", "imaginary part (absorption)"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"distribution", Kind::Int, 0, 0, 1, "", "of the microfacets' normals", MicrofacetDistributions},
    };
    static constexpr int AlphaU = number_index(fields, "alpha_u"), AlphaV = number_index(fields, "alpha_v");
    static constexpr int Eta = color_index(fields, "eta"), K = color_index(fields, "k"),
                         Reflectance = color_index(fields, "specular_reflectance");
    static constexpr int Distribution = choice_index(fields, "distribution");
    static constexpr Model model = {"bsdf",
                                    "anisotropicconductor",
                                    "Rough conductor, brushed, one-sided.",
                                    fields,
                                    6,
                                    HasSmoothLobes | FollowsTangent,
                                    "AnisotropicConductor"};
    static constexpr int Albedo = field_index(fields, "specular_reflectance");

    template <class T, class P>
    TR_INLINE static Vec2<T> alpha(const P &params) {
        return {T(params.number[AlphaU]), T(params.number[AlphaV])};
    }
};

TR_BSDF(AnisotropicConductor)

}  // namespace tr
