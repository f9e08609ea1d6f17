// A scene on the host: built from the description that Python gives, brought up to date with the tensors of each call,
// seen by the renderer as a SceneView.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "../accel/accel.h"
#include "../core/scene.h"
#include "bend_blocks.h"
#include "distribution.h"
#include "gradient.h"
#include "layout.h"
#include "rough_transmittance.h"
#include "values.h"

namespace tr {

// Corners of the rectangle, counterclockwise seen from +z.
constexpr double RectangleCorner[4][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};

// S: the type of all parameters, float or double. Not thread safe; while nobody calls build or update, view() and
// accel() may be used from any thread.
template <class S>
class SceneData {
public:
    using Object = SceneObject;
    using Objects = SceneObjects;

    // Structure: which objects there are, the shapes of all parameters, the faces (copied). Throws
    // std::invalid_argument with "scene.path: field 'x': expected ..., got ..." before anything has changed;
    // std::runtime_error without Embree.
    // `previous`: a scene of the same objects with other shapes of parameters. What those do not change is taken from
    // it: geometry with its acceleration structure, the tables of the environment. It makes its own again when it is
    // used again. The first update then goes by `dirty`, which is relative to the previous scene's last one.
    void build(const Objects &objects, const std::vector<std::vector<int64_t>> &param_shapes,
               const std::vector<IndexArray> &index_arrays, int channels, SceneData *previous = nullptr,
               bool spectral = false);

    // Values: `params` has an address for every parameter (they stay in use until the next call), dirty[i] != 0 says
    // that the contents of a tensor have changed since the last call. The first call after build takes all as changed,
    // and so does the first after a call that failed. std::invalid_argument for values that cannot be rendered.
    // `look`: for what was written without a word, too; without if a call just before has looked. `elsewhere`, by slot
    // or empty: numbers that the host does not reach, of textures that BSDFs alone have.
    void update(const std::vector<const S *> &params, const std::vector<uint8_t> &dirty, bool look = true,
                const std::vector<uint8_t> &elsewhere = {});

    // How emitters are chosen until the next update: by their weights, or by those times their power. An update goes
    // back to weights.
    void choose_emitters(bool by_power);

    const SceneView<S> &view() const { return view_; }
    const Accel &accel() const { return *accel_; }
    // See Accel::walk.
    void walk(const RayWalk *walk) {
        if (accel_) accel_->walk(walk);
    }
    // How often what follows from the parameters was made; goes on counting over takeovers.
    struct Counters {
        Accel::Counters accel;
        uint64_t meshes = 0, quadrics = 0;  // shapes whose geometry was set
        uint64_t environments = 0;          // tables of an environment map
        uint64_t height_fields = 0;         // ranges of heights
        uint64_t sdf_grids = 0;             // empty space around surfaces
    };
    Counters counters() const;

    void bounds(S out[6]) const;  // lower corner, upper corner; (inf, -inf) without shapes

    // Another number, of all scenes, after each change of where shapes are.
    uint64_t geometry_version() const { return geometry_version_; }

    // For derivatives: where the small parameters are in the block of constants. A parameter that is used twice has
    // two entries.
    const std::vector<ConstantEntry> &constant_entries() const { return layout_.entries; }
    size_t n_constants() const { return layout_.constants.size(); }
    size_t n_params() const { return layout_.slot_sizes.size(); }

    // Tangents in the layout of Values: null addresses become zeros, or a TensorView without data.
    void fill_values(const std::vector<const S *> &tangents, std::vector<S> &constants,
                     std::vector<TensorView<S>> &tensors) const;

    // Tangents of geometry: adds the matrices of curved shapes to `to.constants`, which fill_values has filled, and
    // fills the vertex arrays. Back: adds the sums of the reverse sweep to the gradients of vertex arrays, by slot, and
    // those of matrices and rectangles to the small parameters in sums.constants.
    void fill_geometry(const std::vector<const S *> &tangents, const GeometrySizes &sizes, GeometryArrays<S> &to) const;
    void spread_geometry(GradientSums &sums, const std::vector<S *> &gradients, int threads) const;

    // Calls visit(&SceneView<S>::table, its memory, how many entries) for the tables of the view that are as large as
    // the scene; those of `values` and what bends light are not among them. Of vertices entries are numbers.
    template <class Visit>
    void for_tables(Visit &&visit) const {
        using View = SceneView<S>;
        auto table = [&](auto View::*member, const auto &of) { visit(member, of.data(), of.size()); };
        auto records = [&](const Record *View::*member, const char *category) {
            table(member, layout_.records.at(category));
        };
        records(&View::textures, "texture"), records(&View::bsdfs, "bsdf"), records(&View::emitters, "emitter");
        records(&View::sensors, "sensor"), records(&View::volumes, "volume"), records(&View::phases, "phase");
        visit(&View::vertices, reinterpret_cast<const S *>(vertices_.data()), vertices_.size() * VertexRow<S>::Size);
        table(&View::faces, layout_.faces), table(&View::shapes, shapes_);
        table(&View::shape_matrices, matrices_), table(&View::shape_areas, areas_);
        table(&View::area_cdf, area_cdf_), table(&View::attributes, layout_.attributes);
        visit(&View::emitter_cdf, view_.emitter_cdf, by_weight_.cdf.size());
        visit(&View::emitter_pmf, view_.emitter_pmf, by_weight_.pmf.size());
        visit(&View::light_cells, view_.light_cells, view_.light_cells ? light_cells_.size() : 0);
        table(&View::cell_marginal, cell_marginal_), table(&View::cell_conditional, cell_conditional_);
        table(&View::light_boxes, light_boxes_);
        table(&View::env_marginal, environment_.marginal), table(&View::env_conditional, environment_.conditional);
        visit(&View::env_to_local, &env_to_local_[0], 12), visit(&View::env_to_world, &env_to_world_[0], 12);
        table(&View::bsdf_tables, bsdf_tables_), table(&View::bsdf_aovs, layout_.bsdf_aovs);
        table(&View::media, layout_.media);
        table(&View::volume_to_local, volume_to_local_), table(&View::majorants, majorants_);
        table(&View::phase_tables, phase_tables_);
    }

    // Of the shapes with a BSDF for which bsdfs[i] is not 0, itself or in one that holds it: six numbers each. None:
    // there are many, or it is not known where they are.
    std::optional<std::vector<float>> boxes_with(const std::vector<int32_t> &bsdfs) const;

    const SceneLayout &layout() const { return layout_; }
    // The name of an object: category "shape", "bsdf", ... and its index.
    const std::string &path(const char *category, int index) const {
        return layout_.paths.at(category).at(size_t(index));
    }

private:
    SceneLayout layout_;
    SceneView<S> view_{};
    std::unique_ptr<Accel> accel_;
    // what has to be made whatever `dirty` says
    bool all_dirty_ = true, geometry_dirty_ = true, environment_dirty_ = true;
    uint64_t geometry_version_ = 0;
    bool rebuilt_ = false;  // from another scene: the acceleration structure is made the fast way
    Counters counters_;

    std::vector<S> constants_;
    std::vector<TensorView<S>> tensors_;
    std::vector<VertexRow<S>> vertices_;
    std::vector<ShapeInfo> shapes_;
    std::vector<S> matrices_, areas_, area_cdf_;
    std::vector<uint8_t> dark_;  // emitting meshes without any area
    // Of a height field or a grid of distances, by shape: its heights in single precision where they are in double, and
    // what they were.
    struct HeightsCopy {
        std::vector<float> single;
        uint64_t fingerprint = 0;
    };
    std::vector<HeightsCopy> heights_;
    struct EmitterTable {
        std::vector<S> cdf, pmf;
        EmitterTable() = default;
        explicit EmitterTable(const std::vector<double> &weights);
    };
    EmitterTable by_weight_, by_power_;  // the latter is made when it is wanted
    std::map<int, double> mean_texels_;  // mean luminance by slot, of what has been asked for
    std::vector<S> light_boxes_;
    int n_light_boxes_ = -1;
    std::vector<BendMedium<S>> bends_;  // by medium
    std::vector<std::unique_ptr<BendBlocks>> blocks_;
    EnvironmentTables<S> environment_;
    // Of the lights that show an image: cells by emitter, tables of all of them, and what they were made from.
    std::vector<LightCells> light_cells_;
    std::vector<S> cell_marginal_, cell_conditional_;
    std::vector<double> cells_made_from_;
    S env_to_local_[12]{}, env_to_world_[12]{};
    std::vector<S> volume_to_local_, majorants_, phase_tables_, bsdf_tables_;
    std::vector<Coating> coatings_;  // of which bsdf_tables_ was made

    void allocate_geometry();
    void take_over(SceneData &previous);
    bool same_geometry(const SceneData &other) const;
    void read_constants(const std::vector<const S *> &params);
    void update_shapes(const std::vector<const S *> &params, const std::vector<uint8_t> &dirty,
                       const std::vector<S> &old, bool first);
    bool update_mesh(const MeshSource &mesh, const std::vector<const S *> &params, const std::vector<uint8_t> &dirty,
                     bool first);
    // Whether a column of the vertices begin .. end of a mesh is what an array (n_vertices, N) has.
    template <size_t N>
    bool same_rows(const MeshSource &mesh, S (VertexRow<S>::*column)[N], const S *from, int32_t begin,
                   int32_t end) const {
        const VertexRow<S> *rows = &vertices_[size_t(mesh.first_vertex)];
        bool same = true;
        for (size_t i = size_t(begin); i < size_t(end); ++i)
            for (size_t k = 0; k < N; ++k) same &= (rows[i].*column)[k] == from[N * i + k];
        return same;
    }
    bool same_radii(const MeshSource &curve, const S *from) const {
        const VertexRow<S> *rows = &vertices_[size_t(curve.first_vertex)];
        bool same = true;
        for (size_t i = 0; i < size_t(curve.n_vertices); ++i) same &= rows[i].n[0] == from[i];
        return same;
    }
    bool update_curve(const MeshSource &curve, const std::vector<const S *> &params, const std::vector<uint8_t> &dirty,
                      bool first);
    void update_rectangle(const MeshSource &mesh, bool first);
    void update_quadric(int shape);
    void update_heights(int shape, const S *heights, bool changed, bool moved);
    void update_sdf_grid(int shape, const S *values, bool changed, bool moved);
    const float *in_single(int shape, const S *values, bool changed);
    Affine set_matrices(int shape);
    void set_mesh(const MeshSource &mesh, const S *positions, bool first);
    void update_environment(const std::vector<const S *> &params, const std::vector<uint8_t> &dirty);
    std::vector<uint8_t> with_silent_changes(const std::vector<const S *> &params, std::vector<uint8_t> dirty) const;
    void update_emitters();
    const Record *shown_image(const Record &emitter) const;
    void update_light_cells();
    void make_light_cells(size_t emitter, const Record &texture);
    void check_frames() const;
    double mean_of_texture(int32_t texture, int32_t shape);
    double mean_color(int32_t offset) const;
    double mean_of_tensor(int32_t slot);
    double mean_of_environment(int32_t slot);
    double power_of(const Record &record);
    template <class B>
    bool add_shape_box(size_t shape, int most_vertices, std::vector<B> &boxes) const;
    void update_light_boxes();
    void update_ball();
    void update_media(const std::vector<uint8_t> &dirty);
    void update_bends();
    void update_phases(const std::vector<uint8_t> &dirty);
    void update_bsdfs();
    void refresh_view();
};

}  // namespace tr
