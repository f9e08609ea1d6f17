// A scene as Python sees it: one class for all variants.
#pragma once

#include <algorithm>

#include "cpu/zeros.h"
#include "functions.h"
#include "host/normals.h"
#include "native_scene.h"
#include "read_config.h"

namespace tr {

inline SceneObjects read_objects(const Value &given) {
    SceneObjects objects;
    for (const auto &[category, entries] : given.dict()) {
        auto &to = objects[category];
        for (const Value &entry : entries.list()) {
            const Value::List &parts = entry.list();
            SceneObject object{parts.at(0).as<std::string>(), parts.at(1).as<std::vector<int64_t>>(), ""};
            if (parts.size() > 2) object.path = parts[2].as<std::string>();
            to.push_back(std::move(object));
        }
    }
    return objects;
}

inline ParameterValues values(const Addresses &params, const std::vector<bool> &dirty) {
    return {params, {dirty.begin(), dirty.end()}};
}

inline constexpr std::pair<const char *, RayKind> ray_kinds[] = {{"camera", RayKind::Camera},
                                                                 {"bounce", RayKind::Bounce},
                                                                 {"camera shadow", RayKind::CameraShadow},
                                                                 {"bounce shadow", RayKind::BounceShadow}};

// Of the class's members that render: the settings and what has changed come in front.
template <auto Call>
struct Rendering;

template <class... Given, RenderStats (NativeScene::*Call)(const Config &, const ParameterValues &, Given...)>
struct Rendering<Call> {
    static Value call(Progress progress, NativeScene &self, const Value &config, const Addresses &params,
                      const std::vector<bool> &dirty, std::decay_t<Given>... given) {
        return to_value((self.*Call)(read_config(config, progress), values(params, dirty), given...));
    }
};

inline void declare_scene(Functions &f) {
    // Of a mesh: the normals; or the product of their Jacobian ("jvp"), or its transpose ("vjp"), with what is given.
    f.add("vertex_normals",
          [](const std::string &what, const std::string &dtype, uintptr_t positions, size_t n_vertices, uintptr_t faces,
             size_t n_faces, uintptr_t given, uintptr_t result, int threads) {
              auto run = [&](auto zero) {
                  using S = decltype(zero);
                  const Triangles<S> mesh{reinterpret_cast<const S *>(positions), n_vertices,
                                          reinterpret_cast<const int32_t *>(faces), n_faces};
                  const auto *from = reinterpret_cast<const S *>(given);
                  auto *to = reinterpret_cast<S *>(result);
                  if (what == "vjp") return vertex_normals_vjp(mesh, from, to, threads);
                  if (what == "jvp") return vertex_normals_jvp(mesh, from, to, threads);
                  vertex_normals(mesh, to, threads);
              };
              dtype == "float64" ? run(0.0) : run(0.f);
          });
    f.add("use_large_pages",
          [](uintptr_t memory, size_t bytes) { use_large_pages(reinterpret_cast<void *>(memory), bytes); });

    f.add("RayRecord", [](size_t limit) { return made(std::make_shared<RayRecord>(limit)); });
    f.add("RayRecord.counts", [](RayRecord &self) {
        Value::Dict all;
        for (auto [name, kind] : ray_kinds) {
            RayRecord::Counts counts = self.counts(kind);
            all.emplace_back(name,
                             Value::Dict{{"rays", counts.rays}, {"hits", counts.hits}, {"left_out", counts.left_out}});
        }
        return Value(std::move(all));
    });
    f.add("FilmSums", [] { return made(std::make_shared<FilmSums>()); });
    f.add("FilmSums.spp", [](FilmSums &self) { return self.spp; });
    f.add("HitStore", [](int64_t limit) { return made(std::make_shared<HitStore>(limit)); });
    f.add("hit_bytes_in_use", [] { return StoredHits::in_use().load(); });
    // of scenes whose meshes have the same indices
    f.add("Outlines", [] { return made(std::make_shared<SceneOutlines>()); });

    f.add("Scene", [](const std::string &color, const std::string &dtype) {
        return made(std::shared_ptr<NativeScene>(make_scene(color, dtype)));
    });
    // `previous` may be left out
    f.add("Scene.build",
          [](NativeScene &self, const Value &objects, const std::vector<std::vector<int64_t>> &shapes,
             const std::vector<std::pair<uintptr_t, int64_t>> &indices, std::shared_ptr<NativeScene> previous) {
              std::vector<IndexArray> arrays;
              for (auto [address, rows] : indices) arrays.push_back({reinterpret_cast<const int32_t *>(address), rows});
              self.build(read_objects(objects), shapes, arrays, previous.get());
          });
    f.add("Scene.counters", [](NativeScene &self) { return self.counters(); });
    f.add("Scene.render", &Rendering<&NativeScene::render>::call);
    f.add("Scene.render_vjp", &Rendering<&NativeScene::reverse>::call);
    f.add("Scene.render_jvp", &Rendering<&NativeScene::forward>::call);
    f.add("Scene.response_vjp", &Rendering<&NativeScene::response_reverse>::call);
    f.add("Scene.pixel_weights", &Rendering<&NativeScene::weights>::call);
    f.add("Scene.render_aov", &Rendering<&NativeScene::aov>::call);
    f.add("Scene.aov_vjp", &Rendering<&NativeScene::aov_reverse>::call);
    f.add("Scene.aov_jvp", &Rendering<&NativeScene::aov_forward>::call);
    // The length in pixels of those that the camera sees.
    f.add("Scene.find_outlines", [](Progress progress, NativeScene &self, const Value &config, const Addresses &params,
                                    const std::vector<bool> &dirty, uintptr_t moves, SceneOutlines &outlines) {
        if (!self.find_outlines(read_config(config, progress), values(params, dirty), moves, outlines))
            throw Interrupted{};
        return outlines.pieces.total();
    });
    // requests: lists of configurations, parts and numbers
    f.add("Scene.boundary", [](Progress progress, NativeScene &self,
                               const std::tuple<Value::List, std::vector<std::string>,
                                                std::vector<std::map<std::string, double>>> &requests,
                               const Addresses &params, const std::vector<bool> &dirty, const Arrays &arrays,
                               const Arrays &outputs, SceneOutlines &outlines, const Addresses &slots, bool forward) {
        const auto &[settings, parts, numbers] = requests;
        std::vector<Config> configs;
        std::vector<BoundaryRequest> read;
        for (size_t i = 0; i < settings.size(); ++i) {
            configs.push_back(read_config(settings[i], progress));
            read.push_back({parts.at(i), arrays, numbers.at(i), outputs});
        }
        Value::List found;
        for (const RenderStats &each : self.boundary(configs, values(params, dirty), read, outlines, slots, forward))
            found.push_back(to_value(each));
        return Value(std::move(found));
    });
    f.add("Scene.ray_intersect",
          [](NativeScene &self, size_t n, uintptr_t o, uintptr_t d, uintptr_t tmax, const Arrays &out,
             const std::string &device, const Addresses &params,
             const std::vector<bool> &dirty) { self.intersect(n, {o, d, tmax}, out, device, values(params, dirty)); });
    f.add("Scene.ray_occluded", [](NativeScene &self, size_t n, uintptr_t o, uintptr_t d, uintptr_t tmax, uintptr_t out,
                                   const std::string &device, const Addresses &params, const std::vector<bool> &dirty) {
        self.occluded(n, {o, d, tmax}, out, device, values(params, dirty));
    });
    f.add("Scene.probe", [](NativeScene &self, const std::string &what, int index, size_t n, const Arrays &arrays,
                            const Addresses &params, const std::vector<bool> &dirty) {
        self.probe(what, index, n, arrays, values(params, dirty));
    });
    f.add("Scene.bend",
          [](NativeScene &self, const std::string &what, size_t n, const std::map<std::string, double> &numbers,
             const Arrays &arrays, const Addresses &params,
             const std::vector<bool> &dirty) { self.bend({what, n, numbers, arrays}, values(params, dirty)); });
    f.add("Scene.record_rays",
          [](NativeScene &self, std::shared_ptr<RayRecord> record) { self.record_rays(std::move(record)); });
    f.add("Scene.replay_rays", [](NativeScene &self, RayRecord &record, const std::string &kind, int width,
                                  bool coherent, int threads, int rounds) {
        const auto *found = std::find_if(std::begin(ray_kinds), std::end(ray_kinds),
                                         [&](const auto &known) { return kind == known.first; });
        if (found == std::end(ray_kinds))
            throw std::invalid_argument("kind: expected camera, bounce, camera shadow or bounce shadow, got " + kind);
        RayRecord::Replay replay = self.replay_rays(record, found->second, width, coherent, threads, rounds);
        return Value(Value::Dict{{"seconds", replay.seconds}, {"hits", replay.hits}});
    });
    f.add("Scene.bounding_box", [](NativeScene &self) { return self.bounds(); });
    f.add("Scene.emitter_probabilities", [](NativeScene &self) { return self.emitter_probabilities(); });
}

}  // namespace tr
