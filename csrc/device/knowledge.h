// What of a scene a kernel has to know when it is compiled: nothing; its shapes; the models of what it has; and of its
// BSDFs the one that the kernel shades.
#pragma once

namespace tr {

enum class Knowledge { Nothing, Shapes, Scene, Bsdf };

}  // namespace tr
