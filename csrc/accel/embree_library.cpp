#include "embree_library.h"

#include <dlfcn.h>
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <map>
#include <stdexcept>
#include <utility>
#include <vector>

namespace tr {

namespace {

using rtc::Api;

constexpr const char *Remedy = "; install embreex 4.4 or newer, or give the path of an Embree 4 library (4.4 or newer)";

struct Library {
    Api api;
    EmbreeInfo info;
    std::shared_ptr<const EmbreeDevice> device;
    pid_t process = 0;  // that the device was made in
};

// Libraries stay loaded for the life of the process: scenes refer to them.
struct Libraries {
    std::mutex mutex;
    std::map<std::string, std::unique_ptr<Library>> loaded;
    Library *used = nullptr;
    std::vector<std::pair<std::shared_ptr<const EmbreeDevice>, const void *>> left;
};

Libraries &libraries() {
    static Libraries *instance = new Libraries;  // never destroyed: threads may outlive static objects
    return *instance;
}

Api resolve(const std::string &path) {
    void *handle = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!handle) {
        const char *why = dlerror();
        throw std::runtime_error("the library cannot be loaded (" + std::string(why ? why : "unknown reason") + ")" +
                                 Remedy);
    }
    Api api;
    const char *missing = nullptr;
#define TR_RESOLVE(result, name, arguments)                                      \
    api.name = reinterpret_cast<decltype(api.name)>(dlsym(handle, "rtc" #name)); \
    if (!api.name && !missing) missing = "rtc" #name;
    TR_EMBREE_FUNCTIONS(TR_RESOLVE)
#undef TR_RESOLVE
    if (missing) {
        dlclose(handle);
        throw std::runtime_error("the library has no function " + std::string(missing) + ", so it is not Embree 4" +
                                 Remedy);
    }
    return api;
}

std::string check_version(const Api &api, rtc::Device device) {
    int version = int(api.GetDeviceProperty(device, rtc::PropertyVersion));
    std::string text = std::to_string(version / 10000) + "." + std::to_string(version / 100 % 100) + "." +
                       std::to_string(version % 100);
    if (version < 40400 || version >= 50000)
        throw std::runtime_error("the library is Embree " + text + ", expected at least 4.4 and below 5" + Remedy);
    for (auto [property, name] : {std::pair(rtc::PropertyTriangles, "triangles"),
                                  {rtc::PropertyCurves, "curves"},
                                  {rtc::PropertyUserGeometry, "user geometries"},
                                  {rtc::PropertyFilters, "filters"}})
        if (!api.GetDeviceProperty(device, property))
            throw std::runtime_error("the library was built without " + std::string(name) + Remedy);
    return text;
}

// Even lanes hit the second triangle at distance 2 with u = 1/4, v = 1/2; odd lanes pass beside it; the last lane is
// switched off, as the lanes of an incomplete packet are.
template <int N>
bool answers_rightly(const Api &api, rtc::Scene scene, uint32_t geometry) {
    alignas(64) int valid[N];
    rtc::RayHit<N> q;
    std::memset(&q, 0, sizeof(q));
    for (int i = 0; i < N; ++i) {
        valid[i] = N > 1 && i == N - 1 ? 0 : -1;
        q.ray.org_x[i] = i % 2 ? 0.75f : 0.25f;
        q.ray.org_y[i] = i % 2 ? 0.75f : 0.5f;
        q.ray.org_z[i] = 2;
        q.ray.dir_z[i] = -1;
        q.ray.tfar[i] = INFINITY;
        q.ray.mask[i] = 0xffffffffu;
        q.hit.geometry[i] = q.hit.instance[i] = rtc::InvalidGeometry;
    }
    rtc::Ray<N> shadow = q.ray;
    rtc::QueryArguments arguments;
    api.intersect<N>(valid, scene, q, arguments);
    api.occluded<N>(valid, scene, shadow, arguments);
    bool right = true;
    for (int i = 0; i < N; ++i) {
        bool hit = valid[i] && i % 2 == 0;
        right &= (q.hit.geometry[i] == (hit ? geometry : rtc::InvalidGeometry));
        right &= (shadow.tfar[i] < 0) == hit;
        if (hit)
            right &= q.hit.primitive[i] == 1 && std::abs(q.ray.tfar[i] - 2) < 1e-5f &&
                     std::abs(q.hit.u[i] - 0.25f) < 1e-5f && std::abs(q.hit.v[i] - 0.5f) < 1e-5f;
    }
    return right;
}

void check_rays(const EmbreeDevice &device) {
    static const float positions[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 5, 5, 0, 6, 5, 0, 5, 6, 0};
    static const uint32_t faces[] = {3, 4, 5, 0, 1, 2};
    constexpr uint32_t id = 3;
    const Api &api = device.api;
    rtc::Scene scene = api.NewScene(device.handle);
    rtc::Geometry mesh = api.NewGeometry(device.handle, rtc::GeometryTriangle);
    void *vertex = api.SetNewGeometryBuffer(mesh, rtc::BufferVertex, 0, rtc::FormatFloat3, 12, 6);
    void *index = api.SetNewGeometryBuffer(mesh, rtc::BufferIndex, 0, rtc::FormatUInt3, 12, 2);
    if (vertex && index) {
        std::memcpy(vertex, positions, sizeof(positions));
        std::memcpy(index, faces, sizeof(faces));
    }
    api.CommitGeometry(mesh);
    api.AttachGeometryByID(scene, mesh, id);
    api.ReleaseGeometry(mesh);
    api.CommitScene(scene);
    bool right = vertex && index && answers_rightly<1>(api, scene, id) && answers_rightly<4>(api, scene, id);
    if (device.widest_query >= 8) right = right && answers_rightly<8>(api, scene, id);
    if (device.widest_query >= 16) right = right && answers_rightly<16>(api, scene, id);
    api.ReleaseScene(scene);
    device.check("in the test of the library");
    if (!right)
        throw std::runtime_error("rays at a known triangle came back wrong from the library" + std::string(Remedy));
}

}  // namespace

EmbreeDevice::EmbreeDevice(const Api &functions, const char *config)
    : api(functions),
      handle(functions.NewDevice(config)),
      widest_query(!handle                                                         ? 0
                   : functions.GetDeviceProperty(handle, rtc::PropertyNativeRay16) ? 16
                   : functions.GetDeviceProperty(handle, rtc::PropertyNativeRay8)  ? 8
                                                                                   : 4) {
    if (!handle)
        throw std::runtime_error("Embree cannot be started on this processor (error " +
                                 std::to_string(functions.GetDeviceError(nullptr)) + ")" + Remedy);
    api.SetDeviceErrorFunction(handle, on_error, this);
}

EmbreeDevice::~EmbreeDevice() { api.ReleaseDevice(handle); }

void EmbreeDevice::on_error(void *self, int code, const char *message) {
    auto *device = static_cast<EmbreeDevice *>(self);
    std::lock_guard<std::mutex> lock(device->mutex_);
    if (device->error_.empty()) device->error_ = (message ? message : "") + (" (error " + std::to_string(code) + ")");
}

void EmbreeDevice::check(const char *doing) const {
    std::lock_guard<std::mutex> lock(mutex_);
    if (error_.empty()) return;
    std::string message = "Embree reported, " + std::string(doing) + ": " + error_;
    error_.clear();
    throw std::runtime_error(message);
}

EmbreeInfo load_embree(const std::string &path) {
    Libraries &all = libraries();
    std::lock_guard<std::mutex> lock(all.mutex);
    auto known = all.loaded.find(path);
    if (known == all.loaded.end()) {
        auto library = std::make_unique<Library>();
        library->api = resolve(path);
        auto device = std::make_shared<EmbreeDevice>(library->api, "");
        library->info = {check_version(library->api, device->handle), path};
        check_rays(*device);
        library->device = device;
        library->process = getpid();
        known = all.loaded.emplace(path, std::move(library)).first;
    }
    all.used = known->second.get();
    return all.used->info;
}

std::shared_ptr<const EmbreeDevice> embree_device() {
    Libraries &all = libraries();
    std::lock_guard<std::mutex> lock(all.mutex);
    if (!all.used) throw std::runtime_error("Embree is not loaded; call torchrender.backends.embree() first");
    Library &library = *all.used;
    if (library.process != getpid()) {
        all.left.emplace_back(library.device, nullptr);
        library.device = std::make_shared<EmbreeDevice>(library.api, "threads=1");
        library.process = getpid();
    }
    return library.device;
}

void leave_to_parent(std::shared_ptr<const EmbreeDevice> device, const void *made_with_it) {
    Libraries &all = libraries();
    std::lock_guard<std::mutex> lock(all.mutex);
    all.left.emplace_back(std::move(device), made_with_it);
}

}  // namespace tr
