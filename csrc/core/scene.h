// The scene as the renderer sees it: flat tables, indices instead of pointers, so that packets gather from it and a
// device copy is a copy. Filled by csrc/host.
#pragma once

#include "color/spectral.h"
#include "math/facts.h"
#include "model.h"

namespace tr {

// A large tensor where it lies; shape (rows, columns, channels) and, of a grid, slices; (n, channels) is n rows.
template <class S>
struct TensorView {
    const S *data;
    int32_t shape[4];
    const S *base;  // of a tangent: the values themselves, where look-ups are not linear in them; else null
};

// Parameter values. The tangent of a forward-mode derivative has the same layout.
template <class S>
struct Values {
    const S *constants;            // the small parameters, colours expanded to SpectrumSize numbers, or to tables
    const TensorView<S> *tensors;  // by slot in the flat parameter list
};

// A shape is a mesh unless it is curved.
enum ShapeFlags : int32_t {
    HasNormals = 1,
    HasTexcoords = 2,
    FlipNormals = 4,
    IsSphere = 8,
    IsDisk = 16,
    IsHeightField = 32,
    IsCylinder = 64,
    IsCurve = 128,
    IsSdfGrid = 256,
    IsStraight = 512,  // a curve of linear segments
    HasMatrix = IsSphere | IsDisk | IsHeightField | IsCylinder | IsSdfGrid,
    IsCurved = HasMatrix | IsCurve
};

struct ShapeInfo {
    int32_t flags, face_offset, bsdf, emitter;  // ShapeLanes
    int32_t n_faces, cdf_offset, first_vertex, first_attribute;
    int32_t interior, exterior;      // media, -1: none; none on both sides: the medium goes on behind the shape
    int32_t heights, interpolation;  // of a height field or a grid of distances: the slot of its tensor
    int32_t reserved[4];
};
static_assert(sizeof(ShapeInfo) == 64, "gathered with a stride of 16 integers");

// All that belongs to a vertex of a mesh, so that it is one load a lane. Numbers that a mesh does not have are zero. Of
// a curve's control point n[0] is the radius.
template <class S>
struct alignas(8 * sizeof(S)) VertexRow {
    S p[3], n[3], uv[2];
    static constexpr uint32_t Size = 8, Texcoords = 6;  // in numbers
};
static_assert(sizeof(VertexRow<float>) == 32, "gathered with a stride of 8 numbers");

struct AttributeInfo {
    int32_t name, tensor, per_face, next;  // a list a shape: next = -1 ends it
};

// Cells of an emitter that shows an image, see emitter/cells.h; no rows: it has none.
struct LightCells {
    int32_t rows, columns, first_row, first_cell;
};

struct MediumInfo;
template <class S>
struct BendMedium;

template <class S>
struct SceneView {
    Values<S> values;

    const Record *textures, *bsdfs, *emitters, *sensors, *volumes, *phases;
    int32_t n_textures, n_bsdfs, n_emitters, n_sensors;

    // geometry: all meshes and curves one after the other, indices global; a curve's segment has that of its first
    // control point
    const S *vertices;  // VertexRow
    const uint32_t *faces;
    const ShapeInfo *shapes;
    const S
        *shape_matrices;  // 24 a shape: to_world and its inverse, 3 rows of 4 each (curved shapes: of the unit shape)
    const S *shape_areas;
    const S *area_cdf;  // of the faces of emitting meshes
    const AttributeInfo *attributes;
    int32_t n_shapes;
    TR_FACT(bool, textured, TR_TEXTURED);         // there is a texture that is not constant
    TR_FACT(bool, has_stacks, TR_STACKS);         // there is a BSDF that chooses by chance, or perturbs normals
    TR_FACT(bool, follows_tangent, TR_TANGENTS);  // ... whose frame follows the texture coordinates
    TR_FACT(bool, polarized_lights, false);       // there is an emitter whose light is polarised
    TR_INLINE bool has_tangents() const { return has_stacks || follows_tangent || polarized_lights; }

    // choosing an emitter
    const S *emitter_cdf, *emitter_pmf;
    int32_t environment;  // emitter index or -1

    const LightCells *light_cells;  // by emitter; null: there are none
    const S *cell_marginal, *cell_conditional;

    // boxes of the shapes that emit, lower and upper corner, a little larger than they are; -1: too many, or light
    // comes from everywhere
    const S *light_boxes;
    int32_t n_light_boxes;

    S center[3], radius;  // of a ball around everything

    // environment map: cells between texels, chosen by row, then by column
    const S *env_marginal, *env_conditional, *env_to_local, *env_to_world;
    int32_t env_columns, env_rows;

    const S *bsdf_tables;      // see bsdf/rough_transmittance.h
    const int32_t *bsdf_aovs;  // what outputs show of each BSDF, see ShownParameter

    // media: see medium/medium.h
    const MediumInfo *media;
    int32_t n_media;
    const S *volume_to_local;  // 12 a volume
    const S *majorants;
    const S *phase_tables;  // see phase/tabulated.h
    // by medium, see medium/bend_medium.h; null: light goes straight in all of them
    TR_FACT(const BendMedium<S> *, bends, nullptr);

    // Calls visit(pointer) for all tables.
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(values.constants), visit(values.tensors);
        visit(textures), visit(bsdfs), visit(emitters), visit(sensors), visit(volumes), visit(phases);
        visit(vertices), visit(faces), visit(shapes), visit(shape_matrices), visit(shape_areas), visit(area_cdf);
        visit(attributes), visit(emitter_cdf), visit(emitter_pmf), visit(light_cells), visit(cell_marginal);
        visit(cell_conditional), visit(light_boxes), visit(env_marginal), visit(env_conditional);
        visit(env_to_local), visit(env_to_world), visit(bsdf_tables), visit(bsdf_aovs), visit(media);
        visit(volume_to_local), visit(majorants), visit(phase_tables), visit(bends);
    }
};

template <class F>
using SceneOf = SceneView<ScalarOf<F>>;

// ------------------------------------------------------------------------------------------------- reading records
template <class F>
TR_INLINE IntOf<F> record_field(const Record *table, int field, const IntOf<F> &index, const MaskOf<F> &active) {
    IntOf<F> r[1];
    gather_few_rows<F>(&table->kind + 1 + field, UIntOf<F>(index * Record::Stride), active, r);
    return r[0];
}
template <class F>
TR_INLINE IntOf<F> record_kind(const Record *table, const IntOf<F> &index, const MaskOf<F> &active) {
    return record_field<F>(table, -1, index, active);
}

// The kind of a record and its first fields.
template <class F>
struct RecordLanes {
    IntOf<F> number[4];
    TR_INLINE RecordLanes(const Record *table, const IntOf<F> &index, const MaskOf<F> &active) {
        gather_few_rows<F>(&table->kind, UIntOf<F>(index * Record::Stride), active, number);
    }
    TR_INLINE const IntOf<F> &kind() const { return number[0]; }
    TR_INLINE const IntOf<F> &field(int i) const { return number[1 + i]; }
};

// What rendering needs of the shape that every lane has hit.
template <class F>
struct ShapeLanes {
    IntOf<F> flags, face_offset, bsdf, emitter;

    ShapeLanes() = default;
    TR_INLINE ShapeLanes(const ShapeInfo *table, const UIntOf<F> &shape, const MaskOf<F> &active) {
        IntOf<F> row[4];
        gather_few_rows<F>(&table->flags, shape * 16u, active, row);
        flags = row[0], face_offset = row[1], bsdf = row[2], emitter = row[3];
    }
    TR_INLINE MaskOf<F> has(int32_t some) const { return mask<F>((flags & (some & facts::ShapeFlags)) != 0); }
};

// A colour in the block of small parameters.
template <class F, class S>
TR_INLINE Spectrum<F> constant_spectrum(const Values<S> &values, const Wavelengths<F> &waves, const IntOf<F> &offset,
                                        const MaskOf<F> &active) {
    if (waves.spectral()) return table_spectrum(values.constants, waves, UIntOf<F>(offset), active);
    Spectrum<F> r;
    gather_few_rows<F>(values.constants, UIntOf<F>(offset), active, r.c);
    return r;
}

// The same of one colour for all lanes.
template <class F, class S>
TR_INLINE Spectrum<F> constant_spectrum(const Values<S> &values, const Wavelengths<F> &waves, int32_t offset) {
    if (waves.spectral()) return table_spectrum(values.constants, waves, UIntOf<F>(uint32_t(offset)), MaskOf<F>(true));
    Spectrum<F> r;
    for (int c = 0; c < SpectrumSize; ++c) r[c] = F(values.constants[offset + c]);
    return r;
}

// The first of low .. high, whose number behind cdf[offset] is larger than u; `high` if none is.
template <class F, class S>
TR_INLINE UIntOf<F> search_cdf_between(const S *cdf, const UIntOf<F> &offset, UIntOf<F> low, UIntOf<F> high, const F &u,
                                       const MaskOf<F> &active) {
    using U = UIntOf<F>;
    auto open = mask<F>(low < high) && active;
    while (any(open)) {
        U middle = (low + high) >> 1;
        auto right = mask<F>(gather<F>(cdf, offset + middle, open) <= u);
        low = select(right && open, middle + 1u, low);
        high = select(!right && open, middle, high);
        open = mask<F>(low < high) && active;
    }
    return low;
}
// ... of all n.
template <class F, class S>
TR_INLINE UIntOf<F> search_cdf(const S *cdf, const UIntOf<F> &offset, const UIntOf<F> &n, const F &u,
                               const MaskOf<F> &active) {
    return search_cdf_between<F>(cdf, offset, UIntOf<F>(0u), n - 1u, u, active);
}

}  // namespace tr
