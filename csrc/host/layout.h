// From the description that Python gives to what follows from its structure alone: records, where the small parameters
// are stored, faces. Everything is checked here, before anything is built; values are not looked at.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "../core/medium/medium.h"

namespace tr {

struct SceneObject {
    std::string type;
    std::vector<int64_t> ints;  // one a declared field: a slot, an index, or the number itself; -1: not given
    std::string path;           // its name in messages
};
using SceneObjects = std::map<std::string, std::vector<SceneObject>>;  // by category

struct IndexArray {
    const int32_t *data;  // (rows, 3), or of a curve (rows)
    int64_t rows;
};

// A small parameter in the block of constants. `count` numbers of the parameter are stored as `stored` numbers at
// `offset`: a colour of shape () as a number a channel or a wavelength, a (4, 4) matrix as its first 3 rows, others as
// they are.
struct ConstantEntry {
    int slot, offset, stored, count;
};

// Where a parameter is used, for messages: "scene.path: field 'name'".
struct ParameterUse {
    int slot;
    std::string where;
};

// A texture that stands in where none was given.
inline bool is_default(const Record &texture) { return texture.field[Record::Extra] == 1; }

struct MeshSource {
    int shape, vertices, normals, texcoords;  // slots or -1; a rectangle has none
    int first_vertex, n_vertices;
    int radii = -1;  // of a curve, whose control points are its vertices
};

struct SceneLayout {
    int channels = 3;       // of colours
    bool spectral = false;  // colours are spectra: tables, and texels with SigmoidChannels
    int stored_spectrum() const { return spectral ? SpectrumSamples : SpectrumSize; }
    int texel_channels() const { return spectral ? SigmoidChannels : channels; }
    std::map<std::string, std::vector<Record>> records;
    std::map<std::string, std::vector<std::string>> paths;

    std::vector<double> constants;  // defaults; what slots fill in is 0
    std::vector<ConstantEntry> entries;
    std::vector<std::string> entry_where;               // an entry's ParameterUse::where
    std::vector<ParameterUse> tensors;                  // large tensors in use
    std::vector<std::array<int32_t, 4>> tensor_shapes;  // of every slot, see TensorView
    std::vector<int64_t> slot_sizes;

    std::vector<ShapeInfo> shapes;  // flags as given, without what a mirroring transformation adds
    std::vector<MeshSource> meshes;
    std::vector<uint32_t> faces;  // indices into the vertices of all meshes
    std::vector<AttributeInfo> attributes;
    int n_vertices = 0, n_cdf_faces = 0;
    int environment = -1;
    std::vector<MediumInfo> media;
    int n_majorants = 0;
    int n_phase_numbers = 0;         // in the tables of tabulated phase functions
    int n_bsdf_numbers = 0;          // in the tables of rough coatings
    std::vector<int32_t> bsdf_aovs;  // see SceneView
};

// std::invalid_argument: "scene.path: field 'x': expected ..., got ...".
SceneLayout lay_out(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &param_shapes,
                    const std::vector<IndexArray> &index_arrays, int channels, bool spectral);

// Of that, the phase functions: checks, and where their tables lie. The rest is there.
void lay_out_phases(SceneLayout &layout, const std::vector<std::vector<int64_t>> &param_shapes);

// Where the tables of BSDFs lie, and what outputs show of them.
void lay_out_bsdfs(SceneLayout &layout);

}  // namespace tr
