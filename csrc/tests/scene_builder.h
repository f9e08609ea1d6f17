// Scenes for native tests: what Python does for users, in a few lines. Parameters live as long as the builder.
#pragma once

#include <deque>
#include <random>
#include <stdexcept>
#include <utility>
#include <vector>

#include "cpu/derivative_call.h"
#include "cpu/render.h"
#include "harness.h"
#include "host/models.h"
#include "host/scene_data.h"

namespace tr::testing {

using Fields = std::vector<std::pair<const char *, int64_t>>;

template <class S>
class SceneBuilder {
public:
    explicit SceneBuilder(int channels) : channels(channels) {}

    const int channels;
    SceneObjects objects;
    std::vector<std::vector<int64_t>> shapes;
    std::deque<std::vector<S>> values;
    std::deque<std::vector<int32_t>> indices;

    // Adds a parameter; returns its slot.
    int64_t param(std::vector<int64_t> shape, std::vector<S> numbers) {
        shapes.push_back(std::move(shape));
        values.push_back(std::move(numbers));
        return int64_t(values.size()) - 1;
    }
    int64_t number(S x) { return param({}, {x}); }
    int64_t color(S r, S g, S b) { return channels == 3 ? param({3}, {r, g, b}) : param({1}, {(r + g + b) / 3}); }
    // A tensor of uniform random numbers.
    int64_t random(std::vector<int64_t> shape, S low, S high) {
        std::uniform_real_distribution<S> uniform(low, high);
        int64_t n = 1;
        for (int64_t k : shape) n *= k;
        std::vector<S> numbers;
        for (int64_t i = 0; i < n; ++i) numbers.push_back(uniform(generator_));
        return param(std::move(shape), std::move(numbers));
    }
    // Scale, then translation.
    int64_t matrix(S x, S y, S z, S scale = 1) {
        return param({4, 4}, {scale, 0, 0, x, 0, scale, 0, y, 0, 0, scale, z, 0, 0, 0, 1});
    }
    int64_t faces(std::vector<int32_t> numbers) {
        indices.push_back(std::move(numbers));
        return int64_t(indices.size()) - 1;
    }

    // Adds an object; fields that are not named get their defaults. Returns its index.
    int64_t add(const char *category, const char *type, const Fields &given = {}) {
        const ModelEntry *entry = find_model(category, type);
        if (!entry) throw std::logic_error(std::string("no model ") + category + " " + type);
        SceneObject object{type, {}, std::string(category) + "." + type};
        for (int i = 0; i < entry->model->n_fields; ++i) {
            const Field &field = entry->model->fields[i];
            object.ints.push_back(field.kind == Kind::Int ? int64_t(field.fallback) : -1);
        }
        for (const auto &[name, value] : given) {
            int found = -1;
            for (int i = 0; i < entry->model->n_fields; ++i)
                if (std::string(name) == entry->model->fields[i].name) found = i;
            if (found < 0) throw std::logic_error(std::string(type) + " has no field " + name);
            object.ints[size_t(found)] = value;
        }
        objects[category].push_back(std::move(object));
        return int64_t(objects[category].size()) - 1;
    }
    int64_t constant(S r, S g, S b) { return add("texture", "constant", {{"value", color(r, g, b)}}); }
    int64_t diffuse(S r, S g, S b) { return add("bsdf", "diffuse", {{"reflectance", constant(r, g, b)}}); }
    // Looks along +z from (x, y, z).
    int64_t camera(S x, S y, S z, S fov) {
        return add("sensor", "perspective", {{"to_world", matrix(x, y, z)}, {"x_fov", number(fov)}});
    }

    std::vector<IndexArray> index_arrays() const {
        std::vector<IndexArray> r;
        for (const auto &a : indices) r.push_back({a.data(), int64_t(a.size() / 3)});
        return r;
    }
    std::vector<const S *> addresses() const {
        std::vector<const S *> r;
        for (const auto &v : values) r.push_back(v.data());
        return r;
    }
    void build(SceneData<S> &scene) const {
        scene.build(objects, shapes, index_arrays(), channels);
        scene.update(addresses(), std::vector<uint8_t>(values.size(), 1));
    }

private:
    std::mt19937 generator_{1};
};

struct Settings {
    int height = 12, width = 16, max_depth = 6, threads = 2, emitter_samples = 1, bsdf_samples = 1;
    int64_t spp = 16;
    bool hide_emitters = false;
    uint64_t seed = 1;
    Filter filter;
};

template <class S>
RenderCall<S> make_call(const SceneData<S> &scene, const Settings &s) {
    RenderCall<S> call{};
    call.scene = &scene.view();
    call.accel = &scene.accel();
    call.config.max_depth = s.max_depth;
    call.config.rr_depth = 5;
    call.config.hide_emitters = s.hide_emitters;
    call.config.emitter_samples = s.emitter_samples;
    call.config.bsdf_samples = s.bsdf_samples;
    call.config.seed = s.seed;
    call.config.sensor = 0;
    call.filter = s.filter;
    call.film_height = s.height;
    call.film_width = s.width;
    call.crop = call.samples = {0, 0, s.height, s.width};
    call.values = scene.layout().channels;
    call.spp = s.spp;
    call.threads = s.threads;
    call.interrupted = [](double) { return false; };
    return call;
}

// Numbers of an image.
template <class S>
size_t n_values(const SceneData<S> &scene, const Settings &s) {
    return size_t(s.height * s.width * scene.layout().channels);
}

template <class S>
std::vector<S> render(const SceneData<S> &scene, const Settings &s, RenderStats *stats = nullptr) {
    std::vector<S> image(n_values(scene, s)), alpha(size_t(s.height * s.width));
    RenderStats result = render_primal<S>(make_call(scene, s), {{image.data(), alpha.data()}});
    if (stats) *stats = result;
    return image;
}

// Addresses of what is stored by slot.
template <class S>
Addresses addresses_of(const std::vector<std::vector<S>> &values) {
    Addresses r;
    for (const auto &v : values) r.push_back(reinterpret_cast<uintptr_t>(v.data()));
    return r;
}

// Gradients of all parameters, by slot, for the image's adjoint. `light`: of light tracing.
template <class S>
std::vector<std::vector<S>> reverse(const SceneData<S> &scene, const Settings &s, const std::vector<S> &adjoint,
                                    bool light = false, RenderStats *stats = nullptr) {
    std::vector<std::vector<S>> gradients;
    for (int64_t n : scene.layout().slot_sizes) gradients.emplace_back(size_t(n), S(0));
    const RenderCall<S> call = make_call(scene, s);
    DerivativeCall<S> d = reverse_call(scene, call.config, light, addresses_of(gradients));
    d.adjoint = adjoint.data();
    RenderStats result = light ? trace_light_reverse<S>(call, d) : render_reverse<S>(call, d);
    add_gradients(scene, d, addresses_of(gradients), s.threads);
    if (stats) *stats = result;
    return gradients;
}

// Derivative of the image along tangents of all parameters, by slot.
template <class S>
std::vector<S> forward(const SceneData<S> &scene, const Settings &s, const std::vector<std::vector<S>> &tangents,
                       bool light = false) {
    const RenderCall<S> call = make_call(scene, s);
    const ForwardCall<S> d(scene, call.config, light, addresses_of(tangents));
    std::vector<S> image(n_values(scene, s));
    light ? trace_light_forward<S>(call, d.call, image.data()) : render_forward<S>(call, d.call, image.data());
    return image;
}

}  // namespace tr::testing
