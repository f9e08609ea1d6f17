// `roughconductor`: a metal that is as rough in all directions.
#include "microfacet_conductor.h"

namespace tr {

struct RoughConductor : MicrofacetConductor<RoughConductor> {
    static constexpr Field fields[] = {
        {"alpha", Kind::Scalar, 0.1, 0, 10, "interior",
         "roughness of the microfacet distribution; below 0.001 it counts as that"},
        {"eta", Kind::Texture, 0, 0, INFINITY, "interior", "real part of the index of refraction"},
        {"k", Kind::Texture, 1, 0, INFINITY, "interior", "imaginary part (absorption)"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"distribution", Kind::Int, 0, 0, 1, "", "of the microfacets' normals", MicrofacetDistributions},
    };
    static constexpr int Alpha = number_index(fields, "alpha");
    static constexpr int Eta = color_index(fields, "eta"), K = color_index(fields, "k"),
                         Reflectance = color_index(fields, "specular_reflectance");
    static constexpr int Distribution = choice_index(fields, "distribution");
    static constexpr Model model = {"bsdf",         "roughconductor", "Rough conductor, one-sided.", fields, 5,
                                    HasSmoothLobes, "RoughConductor"};
    static constexpr int Albedo = field_index(fields, "specular_reflectance");

    template <class T, class P>
    TR_INLINE static T alpha(const P &params) {
        return T(params.number[Alpha]);
    }
};

TR_BSDF(RoughConductor)

}  // namespace tr
