// Declarations of the shapes. What they are while rendering is in surface.h: a rectangle is a mesh of two triangles.
#pragma once

#include "../model.h"

namespace tr {

constexpr const char *GeometryEdges =
    "interior, without the motion of edges that are seen in mirrors or through glass, and of jumps of textures; zero "
    "where there are none or both sides of them are of equal colour";
constexpr const char *CurvedEdges =
    "interior, without the motion of its silhouettes, of edges that are seen in mirrors or through glass, and of jumps "
    "of textures; zero where there are none or both sides of them are of equal colour";
constexpr const char *GridEdges =
    "interior, without the motion of its silhouettes and, with analytic normals, of the creases between cells, of "
    "edges that are seen in mirrors or through glass, and of jumps of textures; zero where there are none or both "
    "sides of them are of equal colour";

struct MeshModel {
    enum { Vertices, Faces, Normals, Texcoords, FaceNormals, Flip, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"vertices", Kind::Tensor, None, -INFINITY, INFINITY, GeometryEdges, "positions (V, 3), world space"},
        {"faces", Kind::Indices, None, 0, INFINITY, "", "vertex indices (F, 3)"},
        {"normals", Kind::Tensor, -1, -INFINITY, INFINITY,
         "interior, without the motion of edges that are seen in mirrors or through glass; zero where there are none "
         "or both sides of them are of equal colour",
         "vertex normals (V, 3), world space", nullptr, Optional},
        {"texcoords", Kind::Tensor, -1, -INFINITY, INFINITY,
         "interior, without the jumps of nearest and checkerboard textures; zero where textures are bilinear",
         "texture coordinates (V, 2)", nullptr, Optional},
        {"face_normals", Kind::Int, 0, 0, 1, "", "shade flat although there are vertex normals", Boolean},
        {"flip_normals", Kind::Int, 0, 0, 1, "", "turn all normals round", Boolean},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", ""},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point away from"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point to"},
    };
    static constexpr Model model = {"shape", "mesh", "Triangles.", fields, 10};
};

struct SphereModel {
    enum { ToWorld, Center, Radius, Flip, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, GeometryEdges,
         "applied after center and radius; uniform scale only"},
        {"center", Kind::Point, 0, -INFINITY, INFINITY, GeometryEdges, ""},
        {"radius", Kind::Float, 1, 0, INFINITY, GeometryEdges, ""},
        {"flip_normals", Kind::Int, 0, 0, 1, "", "normals point inside", Boolean},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", ""},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point away from"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point to"},
    };
    static constexpr Model model = {"shape", "sphere", "A sphere.", fields, 8};
};

struct CylinderModel {
    enum { ToWorld, P0, P1, Radius, Flip, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, GeometryEdges,
         "applied after p0, p1 and radius; the cylinder has to stay round and right"},
        {"p0", Kind::Point, 0, -INFINITY, INFINITY, GeometryEdges, "where the axis begins"},
        {"p1", Kind::Point, None, -INFINITY, INFINITY, GeometryEdges, "where the axis ends; (0, 0, 1) unless given"},
        {"radius", Kind::Float, 1, 0, INFINITY, GeometryEdges, ""},
        {"flip_normals", Kind::Int, 0, 0, 1, "", "normals point inside", Boolean},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", ""},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point away from"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point to"},
    };
    static constexpr Model model = {"shape", "cylinder", "A cylinder, open at both ends.", fields, 9};
};

struct HeightFieldModel {
    static constexpr const char *Interpolations[] = {"bspline", "bilinear", nullptr};
    enum { ToWorld, Heights, Interpolation, Flip, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, GeometryEdges,
         "from the square [-1, 1]^2 and heights along +z to the world"},
        {"heights", Kind::Tensor, None, -INFINITY, INFINITY, GeometryEdges,
         "(H, W), over the square like the texels of a bitmap: row 0 at v = 0, clamped outside"},
        {"interpolation", Kind::Int, 0, 0, 1, "", "bspline: a cubic B-spline with these control values",
         Interpolations},
        {"flip_normals", Kind::Int, 0, 0, 1, "", "face -z", Boolean},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", "refused: height fields cannot emit"},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point away from"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point to"},
    };
    static constexpr Model model = {"shape", "heightfield", "Heights over the square [-1, 1]^2.", fields, 8,
                                    0,       "HeightField"};
};

// Both kinds of curves have the same fields.
struct CurveFields {
    enum { ControlPoints, Radii, Segments, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"control_points", Kind::Tensor, None, -INFINITY, INFINITY, CurvedEdges, "(N, 3), world space"},
        {"radii", Kind::Tensor, None, 0, INFINITY, CurvedEdges, "(N,), at the control points"},
        {"segments", Kind::Indices, None, 0, INFINITY, "", "the first control point of each segment (S,)"},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", "refused: curves cannot emit"},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "refused: rays do not meet a curve from inside"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "refused"},
    };
};

struct BSplineCurveModel : CurveFields {
    static constexpr Model model = {
        "shape", "bsplinecurve", "Tubes along uniform cubic B-splines.", CurveFields::fields, 7, 0, "BSplineCurve"};
};

struct LinearCurveModel : CurveFields {
    static constexpr Model model = {"shape", "linearcurve", "Cones between spheres.", CurveFields::fields, 7,
                                    0,       "LinearCurve"};
};

struct SdfGridModel {
    static constexpr const char *NormalKinds[] = {"smooth", "analytic", nullptr};
    enum { ToWorld, Grid, Normals, Flip, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, GridEdges, "from the unit cube [0, 1]^3 to the world"},
        {"grid", Kind::Tensor, None, -INFINITY, INFINITY, GridEdges,
         "(D, H, W, 1), signed distances at the corners of cells, negative inside"},
        {"normals", Kind::Int, 0, 0, 1, "", "smooth: shading normals that go on from cell to cell", NormalKinds},
        {"flip_normals", Kind::Int, 0, 0, 1, "", "normals point to negative values", Boolean},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", "refused: grids of distances cannot emit"},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point away from"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point to"},
    };
    static constexpr Model model = {"shape", "sdfgrid", "Where a grid of signed distances is zero.", fields, 8,
                                    0,       "SdfGrid"};
};

// Disk and rectangle have the same fields.
struct PlanarFields {
    enum { ToWorld, Flip, BsdfIndex, EmitterIndex, Interior, Exterior };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, GeometryEdges,
         "from the unit shape, facing +z, to the world"},
        {"flip_normals", Kind::Int, 0, 0, 1, "", "face -z", Boolean},
        {"bsdf", Kind::Bsdf, -1, 0, INFINITY, "", ""},
        {"emitter", Kind::Emitter, -1, 0, INFINITY, "", ""},
        {"interior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point away from"},
        {"exterior", Kind::Medium, -1, 0, INFINITY, "", "medium on the side that normals point to"},
    };
};

struct DiskModel : PlanarFields {
    static constexpr Model model = {"shape", "disk", "The unit disk in the plane z = 0.", PlanarFields::fields, 6};
};

struct RectangleModel : PlanarFields {
    static constexpr Model model = {"shape", "rectangle", "The square [-1, 1]^2 in the plane z = 0.",
                                    PlanarFields::fields, 6};
};

struct AttributeModel {
    enum { Name, ShapeIndex, Data, PerFace };
    static constexpr Field fields[] = {
        {"name", Kind::Int, None, 0, INFINITY, "", "number of the name"},
        {"shape", Kind::Shape, None, 0, INFINITY, "", "the mesh that has it"},
        {"data", Kind::Tensor, None, -INFINITY, INFINITY, "interior", "(V, C) or (F, C)"},
        {"per_face", Kind::Int, 0, 0, 1, "", "a row a face instead of a vertex", Boolean},
    };
    static constexpr Model model = {"attribute", "attribute", "Values on the vertices or faces of a mesh.", fields, 4};
};

}  // namespace tr
