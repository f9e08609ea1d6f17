// What of a scene a kernel knows when it is compiled: nothing; its shapes; the models of what it has; also
// whether its paths are recorded, and for what; and of its BSDFs the one that the kernel shades, or whose derivatives
// it takes.
#pragma once

namespace tr {

// `Tracing`: what the scene has, of kernels that trace rays.
enum class Knowledge { Nothing, Shapes, Tracing, Scene, Paths, Bsdf, Derivative };

constexpr bool knows_light(Knowledge of) { return of != Knowledge::Nothing && of != Knowledge::Shapes; }
constexpr bool knows_paths(Knowledge of) { return of >= Knowledge::Paths; }
constexpr bool knows_bsdf(Knowledge of) { return of == Knowledge::Bsdf || of == Knowledge::Derivative; }

}  // namespace tr
