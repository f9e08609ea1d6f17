// Lights that show an image: the cells by which points on them are chosen, see core/emitter/on_shape.h.
#include <algorithm>
#include <cmath>

#include "../core/registry.h"
#include "models.h"
#include "scene_data.h"

namespace tr {

namespace {

constexpr int MaxCells = 256;  // along a side; each has the mean of the texels in it
// What cells keep of the mean of all: black texels have a derivative, and brightness is not all that decides.
constexpr double UniformShare = 0.25;

// The image that two triangles of one size show, as a function on the unit square.
template <class S>
struct ShownImage {
    const SceneView<S> &scene;
    const Record &texture;
    const TensorView<S> &texels;
    const S *to_uv;
    uint32_t shape;

    ShownImage(const SceneView<S> &view, const Record &emitter, const Record &of)
        : scene(view),
          texture(of),
          texels(view.values.tensors[of.field[Bitmap::Data]]),
          to_uv(view.values.constants + of.field[Bitmap::ToUv]),
          shape(uint32_t(emitter.field[EmitterShape])) {}

    Vec2<S> coordinates(double x, double y) const {
        const bool second = y > x;
        const SurfacePoint<S> point{shape, second ? 1u : 0u, S(second ? x : x - y), S(second ? y - x : y)};
        return lookup_coordinates<S>(scene, point, true);
    }

    // The largest channel; of a spectrum's coefficients the scale, which is about that.
    double brightness(uint32_t texel) const {
        const int channels = texels.shape[2];
        const S *c = texels.data + size_t(texel) * size_t(channels);
        if (channels == SigmoidChannels) return std::abs(double(c[3]));
        double most = 0;
        for (int k = 0; k < channels; ++k) most = std::max(most, std::abs(double(c[k])));
        return most;
    }
    double brightness(double x, double y) const {
        const Footprint<S, 4> taps = Bitmap::footprint<S>(scene, texture, coordinates(x, y));
        double sum = 0;
        for (int t = 0; t < 4; ++t) sum += double(taps.weight[t]) * brightness(taps.texel[t]);
        return sum;
    }

    // How many texels there are from the square's corner to (x, y), by columns or rows.
    double texels_to(double x, double y) const {
        const Vec2<S> a = coordinates(0, 0), b = coordinates(x, y);
        const double u = double(b.x) - double(a.x), v = double(b.y) - double(a.y);
        return std::max(std::abs(double(to_uv[0]) * u + double(to_uv[1]) * v) * texels.shape[1],
                        std::abs(double(to_uv[3]) * u + double(to_uv[4]) * v) * texels.shape[0]);
    }

    // All that cells depend on.
    void describe(std::vector<double> &to, int64_t size) const {
        to.push_back(double(fingerprint(texels.data, size)));
        to.insert(to.end(), to_uv, to_uv + 6);
        for (int corner = 0; corner < 4; ++corner) {
            const Vec2<S> uv = coordinates(corner & 1, corner >> 1);
            to.push_back(double(uv.x)), to.push_back(double(uv.y));
        }
    }
};

// A side of the square: in how many cells it is divided, and how many points of each are looked up. Two at least, since
// between texels the image is interpolated.
struct Side {
    int cells, points;
    explicit Side(double texels)
        : cells(int(std::clamp(std::ceil(texels - 1e-3), 1.0, double(MaxCells)))),
          points(int(std::clamp(std::ceil(texels / cells), 2.0, 8.0))) {}
    double place(int cell, int point) const { return (cell + (point + 0.5) / points) / cells; }
};

}  // namespace

// Null of those that show none.
template <class S>
const Record *SceneData<S>::shown_image(const Record &emitter) const {
    const Model &model = model_of("emitter", emitter);
    if (!model.is(IsOnShape)) return nullptr;
    const ShapeInfo &shape = shapes_[size_t(emitter.field[EmitterShape])];
    const Record &texture = layout_.records.at("texture")[size_t(emitter.field[field_named(model, "radiance")])];
    const bool shows = !(shape.flags & IsCurved) && shape.n_faces == 2 &&
                       std::abs(double(area_cdf_[size_t(shape.cdf_offset)]) - 0.5) < 1e-5 &&
                       texture.kind == int32_t(TextureKind::Bitmap);
    return shows ? &texture : nullptr;
}

template <class S>
void SceneData<S>::update_light_cells() {
    const std::vector<Record> &emitters = layout_.records.at("emitter");
    std::vector<double> from;
    for (const Record &emitter : emitters) {
        const Record *texture = shown_image(emitter);
        from.push_back(texture ? 1 : 0);
        if (texture)
            ShownImage<S>(view_, emitter, *texture)
                .describe(from, layout_.slot_sizes[size_t(texture->field[Bitmap::Data])]);
    }
    if (from != cells_made_from_) {
        light_cells_.assign(emitters.size(), LightCells{});
        cell_marginal_.clear(), cell_conditional_.clear();
        for (size_t e = 0; e < emitters.size(); ++e)
            if (const Record *texture = shown_image(emitters[e])) make_light_cells(e, *texture);
        cells_made_from_ = std::move(from);
    }
    view_.light_cells = cell_marginal_.empty() ? nullptr : light_cells_.data();
    view_.cell_marginal = cell_marginal_.data();
    view_.cell_conditional = cell_conditional_.data();
}

template <class S>
void SceneData<S>::make_light_cells(size_t emitter, const Record &texture) {
    const ShownImage<S> image(view_, layout_.records.at("emitter")[emitter], texture);
    const double along_x = image.texels_to(1, 0), along_y = image.texels_to(0, 1);
    if (!std::isfinite(along_x) || !std::isfinite(along_y)) return;
    const Side x(along_x), y(along_y);
    std::vector<double> weights(size_t(y.cells) * size_t(x.cells));
    double total = 0;
    for (int i = 0; i < y.cells; ++i)
        for (int j = 0; j < x.cells; ++j) {
            double &sum = weights[size_t(i) * size_t(x.cells) + size_t(j)];
            for (int k = 0; k < x.points * y.points; ++k)
                sum += image.brightness(x.place(j, k % x.points), y.place(i, k / x.points));
            total += sum;
        }
    if (!(total > 0) || !std::isfinite(total)) return;
    const double scale = (1 - UniformShare) * double(weights.size()) / total;
    const size_t first_row = cell_marginal_.size(), first_cell = cell_conditional_.size();
    build_cells(
        y.cells, x.cells, cell_marginal_, cell_conditional_,
        [&](int i, int j) { return weights[size_t(i) * size_t(x.cells) + size_t(j)] * scale + UniformShare; },
        [](int) { return 1.0; });
    light_cells_[emitter] = {y.cells, x.cells, int32_t(first_row), int32_t(first_cell)};
}

#define TR_INSTANTIATE(S) template void SceneData<S>::update_light_cells();
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
