// Which parts of a derivative a call needs: what depends on the parameters that are differentiated.
#pragma once

#include <initializer_list>
#include <string>
#include <vector>

#include "../core/adjoint/needs.h"
#include "../core/bsdf/bsdf.h"
#include "../core/model.h"
#include "gradient.h"
#include "layout.h"

namespace tr {

class GradientRequirements {
public:
    // `needs_grad`: by slot of the flat parameter list
    GradientRequirements(const SceneLayout &layout, const std::vector<bool> &needs_grad);

    // A value that an object of this category looks up.
    bool values(const char *category, size_t index) const;
    // Of the variables of a BSDF, whose model this is, those whose derivative counts, a bit each: what they are looked
    // up in is differentiated, or with `moves` varies from place to place.
    uint32_t variables(size_t bsdf, const BsdfInfo &info, bool moves) const;
    // The position of a light at a point.
    bool point_position() const;
    // Properties of a medium.
    MediumNeeds medium(size_t index) const;
    // Something that moves a camera ray.
    bool camera(size_t sensor) const;
    // A shape, its normals or texture coordinates.
    bool shape(size_t index) const;
    bool shape_matrix(size_t index) const;  // where it is, or its size
    // Anything that moves a ray, a hit or a look-up.
    bool motion(size_t sensor) const;
    // Whether what an emitter looks up changes when the place of the look-up does.
    bool emitters_vary() const;
    GeometrySizes geometry_sizes() const;

private:
    const SceneLayout &layout_;
    const std::vector<bool> &needs_grad_;
    std::vector<int32_t> offsets_;       // sorted: in the block of small parameters
    std::vector<uint8_t> moved_shapes_;  // by shape: one of its tensors is differentiated

    bool number(int32_t offset) const;
    bool tensor(int32_t slot) const { return slot >= 0 && needs_grad_[size_t(slot)]; }
    bool lookup_varies(size_t texture) const;
    bool any_number(const char *category, size_t index, std::initializer_list<Kind> kinds) const;
};

}  // namespace tr
