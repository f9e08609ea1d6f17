#include "compiling_launcher.h"

#include <cstring>
#include <set>
#include <utility>

namespace tr::cuda {

namespace {

class CompilingLauncher final : public Launcher {
public:
    CompilingLauncher(const KernelCompiler &(*compiler)(), int capability, bool ptx)
        : compiler_(compiler), capability_(capability), ptx_(ptx) {}

    // Addresses that nobody follows.
    void *allocate(size_t bytes) override {
        const uintptr_t begin = next_;
        next_ += (bytes + 255) / 256 * 256 + 256;
        return reinterpret_cast<void *>(begin);
    }
    void release(void *) noexcept override {}
    void upload(void *, const void *, size_t) override {}
    void download(void *to, const void *, size_t bytes) override { std::memset(to, 0, bytes); }
    void copy(void *, const void *, size_t) override {}
    void synchronize() override {}
    void know(const SceneFacts &facts) override {
        facts_ = facts;
        known_.clear();
    }

private:
    const KernelCompiler &(*const compiler_)();
    const int capability_;
    const bool ptx_;
    uintptr_t next_ = 256;
    SceneFacts facts_;
    std::set<std::pair<const char *, int>> known_;  // compiled for these facts, by kernel and BSDF

    void launch(const Kernel &kernel, const void *, uint32_t, int bsdf) override {
        if (!knows_bsdf(kernel.knows)) bsdf = -1;
        if (!known_.insert({kernel.name, bsdf}).second) return;
        const std::vector<std::string> definitions = facts_.options(kernel.knows, bsdf);
        if (ptx_)
            compiler_().code(kernel, "compute_" + std::to_string(capability_), definitions);
        else
            compiler_().for_card(kernel, capability_, definitions);
    }
};

}  // namespace

std::unique_ptr<Launcher> make_compiling_launcher(const KernelCompiler &(*compiler)(), int capability, bool ptx) {
    return std::make_unique<CompilingLauncher>(compiler, capability, ptx);
}

}  // namespace tr::cuda
