// The Embree library: found by Python, loaded here, tested before it is trusted.
#pragma once

#include <memory>
#include <mutex>
#include <string>

#include "embree_api.h"

namespace tr {

struct EmbreeInfo {
    std::string version, path;
};

// Loads the library at `path`, checks its version (4.4 or newer, below 5) and its answers to rays of every width at
// known triangles, and makes it the one that is used from now on. Once per path, from any thread. std::runtime_error
// with one sentence if it cannot be used; the one used before then stays.
EmbreeInfo load_embree(const std::string &path);

// A device of the library in use. There is one a process: in a child process, which has none of the library's threads,
// a new one is made, which builds on the calling thread only.
class EmbreeDevice {
public:
    const rtc::Api &api;
    const rtc::Device handle;
    const int widest_query;  // of the widths the library has code for: 16, 8 or 4

    EmbreeDevice(const rtc::Api &api, const char *config);
    ~EmbreeDevice();
    EmbreeDevice(const EmbreeDevice &) = delete;
    EmbreeDevice &operator=(const EmbreeDevice &) = delete;

    // std::runtime_error if the library has reported an error since the last call.
    void check(const char *doing) const;

private:
    static void on_error(void *self, int code, const char *message);
    mutable std::mutex mutex_;
    mutable std::string error_;
};

std::shared_ptr<const EmbreeDevice> embree_device();

// For a child process: keeps a device of the parent, and something made with it, for ever. Releasing it would wait for
// threads that do not exist here.
void leave_to_parent(std::shared_ptr<const EmbreeDevice> device, const void *made_with_it);

}  // namespace tr
