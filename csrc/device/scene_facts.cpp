#include "scene_facts.h"

#include <stdexcept>

#include "core/integrator/medium.h"
#include "core/phase/blend.h"
#include "core/registry.h"
#include "core/sensor/camera.h"

namespace tr {

namespace {

struct BsdfSource {
    const char *name, *file;
};

// In the order of the registry.
constexpr BsdfSource Sources[] = {{"Diffuse", "diffuse"},
                                  {"NullBsdf", "null"},
                                  {"Dielectric", "dielectric"},
                                  {"Conductor", "conductor"},
                                  {"RoughDielectric", "roughdielectric"},
                                  {"RoughConductor", "roughconductor"},
                                  {"Plastic", "plastic"},
                                  {"ThinDielectric", "thindielectric"},
                                  {"Principled", "principled"},
                                  {"RoughPlastic", "roughplastic"},
                                  {"PolarimetricPlastic", "pplastic"},
                                  {"PrincipledThin", "principledthin"},
                                  {"RednerMaterial", "redner"},
                                  {"Hair", "hair"},
                                  {"AnisotropicConductor", "anisotropicconductor"},
                                  {"AnisotropicDielectric", "anisotropicdielectric"},
                                  {"DispersiveDielectric", "dispersivedielectric"},
                                  {"Polarizer", "polarizer"},
                                  {"Retarder", "retarder"},
                                  {"CircularPolarizer", "circular"},
                                  {"MaskHole", "null"},
                                  {"GradientDielectric", "dielectric"}};
#define TR_NAME(M) #M,
constexpr const char *Names[] = {TR_BSDFS(TR_NAME) "MaskHole", "GradientDielectric"};
#undef TR_NAME

constexpr bool same_order() {
    if (std::size(Sources) != std::size(Names)) return false;
    for (size_t i = 0; i < std::size(Names); ++i)
        if (!same_name(Sources[i].name, Names[i])) return false;
    return true;
}
static_assert(same_order(), "a BSDF more? it needs a line");

uint32_t kinds_of(const Record *records, int n) {
    uint32_t kinds = 0;
    for (int i = 0; i < n; ++i) kinds |= 1u << records[i].kind;
    return kinds;
}

}  // namespace

template <class S>
SceneFacts::SceneFacts(const SceneView<S> &scene, const PathConfig &config) {
    for (int i = 0; i < scene.n_shapes; ++i) shape_flags |= scene.shapes[i].flags;
    textures = kinds_of(scene.textures, scene.n_textures), emitters = kinds_of(scene.emitters, scene.n_emitters);
    const Record &sensor = scene.sensors[config.sensor];
    sensors = 1u << sensor.kind, pinhole = is_pinhole(sensor);
    volumetric = config.volumetric;
    for (int m = 0; m < scene.n_media; ++m) {
        const Record &phase = scene.phases[scene.media[m].phase];
        phases |= 1u << phase.kind;
        if (phase.kind == kind_of_model<BlendPhase>(Phases{}))
            for (const int part : {BlendPhase::First, BlendPhase::Second})
                phases |= 1u << scene.phases[phase.field[part]].kind;
    }
    chromatic = MediumContext<S>(scene, nullptr).chromatic;
    textured = scene.textured, stacks = scene.has_stacks, tangents = scene.follows_tangent;
    sampler = int32_t(config.sampler.kind);
}
template SceneFacts::SceneFacts(const SceneView<float> &, const PathConfig &);
template SceneFacts::SceneFacts(const SceneView<double> &, const PathConfig &);

std::vector<std::string> SceneFacts::options(Knowledge knowledge, int bsdf) const {
    if (knowledge == Knowledge::Nothing) return {};
    std::vector<std::string> r{"-DTR_ONE_SCENE"};
    const auto define = [&](const char *name, const std::string &value) {
        r.push_back(std::string("-DTR_") + name + "=" + value);
    };
    const auto number = [&](const char *name, int64_t value) { define(name, std::to_string(value)); };
    const bool all = knows_light(knowledge);
    number("SHAPE_FLAGS", shape_flags);
    define("TEXTURE_KINDS", std::to_string(all ? textures : 0) + "u");
    define("EMITTER_KINDS", std::to_string(all ? emitters : 0) + "u");
    define("SENSOR_KINDS", std::to_string(all ? sensors : 0) + "u");
    number("TEXTURED", all && textured), number("PINHOLE", all && pinhole);
    number("STACKS", all && stacks), number("TANGENTS", all && tangents);
    number("SAMPLER", all ? sampler : 0);
    define("PHASE_KINDS", std::to_string(all && volumetric ? phases : 0) + "u");
    number("VOLUMETRIC", all && volumetric), number("CHROMATIC", all && volumetric && chromatic);
    number("LIGHT_PATHS", all && light_paths);
    if (knows_paths(knowledge)) number("RECORDS", records), number("MOTION", motion);
    number("DERIVATIVES", knowledge == Knowledge::Derivative);
    number("FORWARD", knowledge == Knowledge::Derivative && forward);
    number("FIXED_SUMS", knowledge == Knowledge::Derivative && fixed_sums);
    if (!knows_bsdf(knowledge)) return r;
    number("BSDF_KIND", bsdf);
    if (bsdf < 0 || size_t(bsdf) >= std::size(Sources)) return r;
    define("ONE_BSDF", Sources[bsdf].name);
    define("BSDF_SOURCE", std::string("\"core/bsdf/") + Sources[bsdf].file + ".cpp\"");
    return r;
}

}  // namespace tr
