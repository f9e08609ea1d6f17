#include "bend.h"

#include <stdexcept>

#include "cpu/bent_rays.h"

namespace tr {

template <class S>
void bend(const SceneView<S> *scene, const Accel *accel, const BendRequest &request) {
    auto number = [&](const char *name) { return request.numbers.at(name); };
    auto at = [&](const char *name) { return reinterpret_cast<S *>(request.arrays.at(name)); };
    auto given = [&](const char *name) { return request.arrays.count(name) ? at(name) : nullptr; };
    auto integers = [&](const char *name) { return reinterpret_cast<int32_t *>(request.arrays.at(name)); };
    auto indices = [&](const char *name) { return reinterpret_cast<uint32_t *>(request.arrays.at(name)); };
    const std::string &what = request.what;
    auto field = [&](const S *values, const char *kick) {
        BendField<S> f{values, {int32_t(number("x")), int32_t(number("y")), int32_t(number("z"))}, {}};
        if (const S *from = given(kick)) std::copy_n(from, 6, f.kick);
        return f;
    };
    BentRays<S> rays{};
    rays.field = field(at("values"), "kick"), rays.constant = S(number("constant"));
    rays.quadratic = number("quadratic") != 0, rays.threads = int(number("threads")), rays.n = request.n;
    rays.partials = number("partials") != 0;
    rays.q = at("q"), rays.u = given("u");
    if (what == "field") return evaluate_field<S>(rays, {at("value"), at("slope")});
    if (what == "field_reverse")
        return reverse_field<S>(rays, {at("value"), at("slope")}, at("q_bar"), given("values_bar"));
    // grids by their names, a tensor (Z, Y, X, channels) each
    constexpr const char *names[2] = {"extinction", "emission"};
    auto array = [&](int k, const char *suffix) { return given((names[k] + std::string(suffix)).c_str()); };
    auto view = [&](int k, const S *data) {
        auto size = [&](const char *axis) { return int32_t(number((names[k] + std::string(axis)).c_str())); };
        return TensorView<S>{data, {size("_y"), size("_x"), size("_channels"), size("_z")}, nullptr};
    };
    LightGrids<S> grids(S(request.numbers.count("step") ? number("step") : 0));
    for (int k = 0; k < 2; ++k)
        if (const S *data = array(k, "")) {
            auto setting = [&](const char *of) { return int(number((names[k] + std::string(of)).c_str())); };
            grids.set(k, view(k, data), setting("_filter"), setting("_wrap"), array(k, "_map"));
            rays.light = &grids;
        }
    rays.depth = given("depth"), rays.emitted = given("emitted");
    const BendField<S> tangent = field(given("values_tangent"), "kick_tangent");
    if (what == "field_forward")
        return forward_field<S>(
            rays, {tangent, at("q_tangent"), nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, {}, {}},
            {at("value"), at("slope")});
    rays.steps = integers("steps");
    if (what == "forward") {
        BentTangents<S> tangents{tangent,      at("q_tangent"), at("u_tangent"), at("last_q"),
                                 at("last_u"), at("sums"),      given("depth"),  given("emitted")};
        for (int k = 0; k < 2 && rays.light; ++k) {
            if (!array(k, "")) continue;
            tangents.grids[k] = view(k, array(k, "_tangent")), tangents.maps[k] = array(k, "_map_tangent");
        }
        return forward_bent<S>(rays, tangents);
    }
    rays.state = reinterpret_cast<BendInt<S> *>(request.arrays.at("state"));
    if (what == "reverse") {
        auto doubles = [&](const std::string &name) {
            return reinterpret_cast<double *>(request.arrays.count(name) ? request.arrays.at(name) : 0);
        };
        BentAdjoints<S> adjoints{at("last_q"),       at("last_u"),         at("sums"),
                                 given("depth_bar"), given("emitted_bar"), at("q_bar"),
                                 at("u_bar"),        given("values_bar"),  doubles("kick_bar")};
        for (int k = 0; k < 2; ++k)
            adjoints.grids[k] = array(k, "_bar"), adjoints.maps[k] = doubles(names[k] + std::string("_map_bar"));
        return reverse_bent<S>(rays, adjoints);
    }
    if (what != "trace") throw std::invalid_argument("bend: unknown: " + what);
    rays.last_q = at("last_q"), rays.last_u = at("last_u"), rays.sums = at("sums");
    BendMedium<S> medium = scene->bends[size_t(number("medium"))];
    medium.field = rays.field;  // of the same numbers, with the matrix that its derivative will have
    trace_bent<S>(medium, *accel, rays, at("offset"), {indices("shape_id"), indices("prim_id"), at("t")});
}

#define TR_INSTANTIATE(S) template void bend(const SceneView<S> *, const Accel *, const BendRequest &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
