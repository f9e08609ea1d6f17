// NVRTC, the compiler of CUDA as a library: loaded from a path, for which it needs neither a driver nor a card.
#pragma once

#include <memory>
#include <string>
#include <vector>

namespace tr::cuda {

class Nvrtc {
public:
    // std::runtime_error with one sentence if the library at `path` cannot be used or is older than 12.0.
    explicit Nvrtc(const std::string &path);
    ~Nvrtc();
    Nvrtc(const Nvrtc &) = delete;
    Nvrtc &operator=(const Nvrtc &) = delete;

    // "12.2"
    const std::string &version() const { return version_; }

    // Machine code for the architecture that `options` name (-arch=sm_90), or, of one that no card has
    // (-arch=compute_80), PTX, which drivers compile for it and all that came later. std::runtime_error with what the
    // compiler says; `log` is told that where it goes well, too.
    std::string compile(const std::string &source, const std::vector<std::string> &options,
                        std::string *log = nullptr) const;

private:
    struct Api;
    std::unique_ptr<Api> api_;
    std::string version_;
};

}  // namespace tr::cuda
