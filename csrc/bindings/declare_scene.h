// A scene as Python sees it: one class for all variants.
#pragma once

#include <pybind11/stl.h>

#include <algorithm>

#include "cpu/zeros.h"
#include "host/normals.h"
#include "native_scene.h"
#include "read_config.h"

namespace tr {

inline SceneObjects read_objects(const py::dict &given) {
    SceneObjects objects;
    for (const auto &[category, list] : given) {
        auto &to = objects[category.cast<std::string>()];
        for (const py::handle &h : list) {
            py::tuple entry = py::reinterpret_borrow<py::object>(h);
            SceneObject object{entry[0].cast<std::string>(), entry[1].cast<std::vector<int64_t>>(), ""};
            if (entry.size() > 2) object.path = entry[2].cast<std::string>();
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

using Release = py::call_guard<py::gil_scoped_release>;

// A call of the renderer: the lock of the interpreter is released while it runs.
template <class... Given>
auto rendering(RenderStats (NativeScene::*call)(const Config &, const ParameterValues &, Given...)) {
    return [call](NativeScene &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                  std::decay_t<Given>... given) {
        const Config c = read_config(config);
        RenderStats stats;
        {
            py::gil_scoped_release release;
            stats = (self.*call)(c, values(params, dirty), given...);
        }
        return to_dict(stats);
    };
}

inline void declare_scene(py::module_ &m) {
    m.def(
        "vertex_normals",
        [](const std::string &dtype, uintptr_t positions, size_t n_vertices, uintptr_t faces, size_t n_faces,
           uintptr_t normals) {
            auto run = [&](auto zero) {
                using S = decltype(zero);
                vertex_normals(reinterpret_cast<const S *>(positions), n_vertices,
                               reinterpret_cast<const int32_t *>(faces), n_faces, reinterpret_cast<S *>(normals));
            };
            dtype == "float64" ? run(0.0) : run(0.f);
        },
        Release());
    m.def(
        "use_large_pages",
        [](uintptr_t memory, size_t bytes) { use_large_pages(reinterpret_cast<void *>(memory), bytes); }, Release());
    // the modules of other instruction sets have one, too
    py::class_<RayRecord, std::shared_ptr<RayRecord>>(m, "RayRecord", py::module_local())
        .def(py::init<size_t>(), py::arg("limit"))
        .def("counts", [](const RayRecord &self) {
            py::dict all;
            for (auto [name, kind] : ray_kinds) {
                RayRecord::Counts counts = self.counts(kind);
                py::dict d;
                d["rays"] = counts.rays;
                d["hits"] = counts.hits;
                d["left_out"] = counts.left_out;
                all[name] = d;
            }
            return all;
        });
    // As a buffer, of one byte, it lives as long as a tensor that is made of it.
    py::class_<FilmSums>(m, "FilmSums", py::module_local()).def(py::init()).def_readonly("spp", &FilmSums::spp);
    py::class_<HitStore>(m, "HitStore", py::buffer_protocol(), py::module_local())
        .def(py::init<int64_t>(), py::arg("limit"))
        .def_property_readonly("bytes", &HitStore::bytes)
        .def_static("bytes_in_use", [] { return StoredHits::in_use().load(); })
        .def_buffer([](HitStore &store) { return py::buffer_info(&store.handle, 1); });
    // of scenes whose meshes have the same indices
    py::class_<SceneOutlines>(m, "Outlines", py::module_local()).def(py::init());
    py::class_<NativeScene>(m, "Scene", py::module_local())
        .def(py::init(&make_scene), py::arg("color"), py::arg("dtype"))
        .def(
            "build",
            [](NativeScene &self, const py::dict &objects, const std::vector<std::vector<int64_t>> &shapes,
               const std::vector<std::pair<uintptr_t, int64_t>> &indices, NativeScene *previous) {
                SceneObjects read = read_objects(objects);
                std::vector<IndexArray> arrays;
                for (auto [address, rows] : indices)
                    arrays.push_back({reinterpret_cast<const int32_t *>(address), rows});
                py::gil_scoped_release release;
                self.build(read, shapes, arrays, previous);
            },
            py::arg("objects"), py::arg("shapes"), py::arg("indices"), py::arg("previous") = nullptr)
        .def("counters", &NativeScene::counters, Release())
        .def("render", rendering(&NativeScene::render))
        .def("render_vjp", rendering(&NativeScene::reverse))
        .def("render_jvp", rendering(&NativeScene::forward))
        .def("response_vjp", rendering(&NativeScene::response_reverse))
        .def("find_outlines",
             [](NativeScene &self, const py::dict &config, const Addresses &params, const std::vector<bool> &dirty,
                uintptr_t moves, SceneOutlines &outlines) {
                 const Config c = read_config(config);
                 bool found;
                 {
                     py::gil_scoped_release release;
                     found = self.find_outlines(c, values(params, dirty), moves, outlines);
                 }
                 if (!found) throw py::error_already_set();
                 return outlines.pieces.total();  // the length in pixels of those that the camera sees
             })
        .def("boundary",
             // requests: lists of configurations, parts and numbers
             [](NativeScene &self, const py::tuple &requests, const Addresses &params, const std::vector<bool> &dirty,
                const Arrays &arrays, const Arrays &outputs, const SceneOutlines &outlines, const Addresses &slots,
                bool forward) {
                 std::vector<Config> configs;
                 for (const py::handle &config : requests[0])
                     configs.push_back(read_config(py::reinterpret_borrow<py::dict>(config)));
                 const auto parts = requests[1].cast<std::vector<std::string>>();
                 const auto numbers = requests[2].cast<std::vector<std::map<std::string, double>>>();
                 std::vector<BoundaryRequest> read;
                 for (size_t i = 0; i < configs.size(); ++i)
                     read.push_back({parts.at(i), arrays, numbers.at(i), outputs});
                 std::vector<RenderStats> stats;
                 {
                     py::gil_scoped_release release;
                     stats = self.boundary(configs, values(params, dirty), read, outlines, slots, forward);
                 }
                 py::list found;
                 for (const RenderStats &each : stats) found.append(to_dict(each));
                 return found;
             })
        .def("render_aov", rendering(&NativeScene::aov))
        .def("aov_vjp", rendering(&NativeScene::aov_reverse))
        .def("aov_jvp", rendering(&NativeScene::aov_forward))
        .def(
            "ray_intersect",
            [](NativeScene &self, size_t n, uintptr_t o, uintptr_t d, uintptr_t tmax, const Arrays &out,
               const Addresses &params,
               const std::vector<bool> &dirty) { self.intersect(n, {o, d, tmax}, out, values(params, dirty)); },
            Release())
        .def(
            "ray_occluded",
            [](NativeScene &self, size_t n, uintptr_t o, uintptr_t d, uintptr_t tmax, uintptr_t out,
               const Addresses &params,
               const std::vector<bool> &dirty) { self.occluded(n, {o, d, tmax}, out, values(params, dirty)); },
            Release())
        .def(
            "probe",
            [](NativeScene &self, const std::string &what, int index, size_t n, const Arrays &arrays,
               const Addresses &params,
               const std::vector<bool> &dirty) { self.probe(what, index, n, arrays, values(params, dirty)); },
            Release())
        .def(
            "bend",
            [](NativeScene &self, const std::string &what, size_t n, const std::map<std::string, double> &numbers,
               const Arrays &arrays, const Addresses &params,
               const std::vector<bool> &dirty) { self.bend({what, n, numbers, arrays}, values(params, dirty)); },
            Release())
        .def("record_rays", &NativeScene::record_rays, py::arg("record").none(true), Release())
        .def(
            "replay_rays",
            [](NativeScene &self, const RayRecord &record, const std::string &kind, int width, bool coherent,
               int threads, int rounds) {
                const auto *found = std::find_if(std::begin(ray_kinds), std::end(ray_kinds),
                                                 [&](const auto &known) { return kind == known.first; });
                if (found == std::end(ray_kinds))
                    throw std::invalid_argument("kind: expected camera, bounce, camera shadow or bounce shadow, got " +
                                                kind);
                RayRecord::Replay replay = [&, which = found->second] {
                    py::gil_scoped_release release;
                    return self.replay_rays(record, which, width, coherent, threads, rounds);
                }();
                py::dict d;
                d["seconds"] = replay.seconds;
                d["hits"] = replay.hits;
                return d;
            },
            py::arg("record"), py::arg("kind"), py::arg("width"), py::arg("coherent"), py::arg("threads"),
            py::arg("rounds"))
        .def("bounding_box", &NativeScene::bounds, Release())
        .def("emitter_probabilities", &NativeScene::emitter_probabilities, Release());
}

}  // namespace tr
