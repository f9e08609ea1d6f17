// Compiled kernels in a folder of the disk, by the hash of all that they depend on.
#pragma once

#include <optional>
#include <string>

namespace tr {

class KernelCache {
public:
    // `folder` is made when something is first put there; `limit`: bytes of all files. The folder may be used by
    // several processes at once.
    explicit KernelCache(std::string folder, size_t limit = size_t(512) << 20);

    // Nothing where there is none, or a file that is not whole.
    std::optional<std::string> find(const std::string &key) const;
    // Removes the files that have not been used for longest if there are too many. A folder that cannot be written to
    // is like one of size 0.
    void put(const std::string &key, const std::string &content) const;

private:
    std::string folder_;
    size_t limit_;
    std::string path(const std::string &key) const { return folder_ + "/" + key + ".cubin"; }
    void shrink() const;
};

// $TORCHRENDER_CACHE, else torchrender in $XDG_CACHE_HOME or ~/.cache, and in it "kernels".
std::string default_kernel_folder();

}  // namespace tr
