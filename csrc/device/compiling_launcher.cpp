#include "compiling_launcher.h"

#include <cstring>
#include <set>
#include <utility>
#include <vector>

#include "compile_beside.h"

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
    void download(void *to, const void *, size_t bytes) override {
        finish();
        std::memset(to, 0, bytes);
    }
    void copy(void *, const void *, size_t) override {}
    void synchronize() override { finish(); }
    void know(const SceneFacts &facts) override { facts_ = facts; }

private:
    const KernelCompiler &(*const compiler_)();
    const int capability_;
    const bool ptx_;
    uintptr_t next_ = 256;
    SceneFacts facts_;
    // Kernels, with all that they are compiled for, and by which compiler.
    std::set<std::pair<const KernelCompiler *, std::vector<std::string>>> begun_;
    std::vector<std::shared_ptr<CompileBeside::Job>> waited_for_;
    CompileBeside compiling_;

    void launch(const Kernel &kernel, const void *, uint32_t, int bsdf) override {
        const std::vector<std::string> definitions = facts_.options(kernel.knows, bsdf);
        const KernelCompiler &compiler = compiler_();
        std::vector<std::string> key = definitions;
        key.emplace_back(kernel.name);
        if (!begun_.insert({&compiler, std::move(key)}).second) return;
        waited_for_.push_back(compiling_.begin([this, definitions, &kernel, &compiler] {
            return ptx_ ? compiler.code(kernel, "compute_" + std::to_string(capability_), definitions)
                        : compiler.for_card(kernel, capability_, definitions);
        }));
    }
    void finish() {
        const std::vector<std::shared_ptr<CompileBeside::Job>> all = std::exchange(waited_for_, {});
        try {
            for (const auto &each : all) compiling_.wait(*each);
        } catch (...) {
            compiling_.drop(), begun_.clear();  // whoever asks again is told again
            throw;
        }
    }
};

}  // namespace

std::unique_ptr<Launcher> make_compiling_launcher(const KernelCompiler &(*compiler)(), int capability, bool ptx) {
    return std::make_unique<CompilingLauncher>(compiler, capability, ptx);
}

}  // namespace tr::cuda
