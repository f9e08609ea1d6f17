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
    rays.q = at("q"), rays.u = given("u");
    if (what == "field") return evaluate_field<S>(rays, {at("value"), at("slope")});
    if (what == "field_reverse")
        return reverse_field<S>(rays, {at("value"), at("slope")}, at("q_bar"), given("values_bar"));
    const BendField<S> tangent = field(given("values_tangent"), "kick_tangent");
    if (what == "field_forward")
        return forward_field<S>(rays, {tangent, at("q_tangent"), nullptr, nullptr, nullptr, nullptr},
                                {at("value"), at("slope")});
    rays.steps = integers("steps");
    if (what == "forward")
        return forward_bent<S>(rays,
                               {tangent, at("q_tangent"), at("u_tangent"), at("last_q"), at("last_u"), at("sums")});
    rays.state = reinterpret_cast<BendInt<S> *>(request.arrays.at("state"));
    if (what == "reverse")
        return reverse_bent<S>(rays, {at("last_q"), at("last_u"), at("sums"), at("q_bar"), at("u_bar"),
                                      given("values_bar"), reinterpret_cast<double *>(request.arrays.at("kick_bar"))});
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
