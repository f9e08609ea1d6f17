#include "kernel_cache.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <utility>
#include <vector>

#include "sha256.h"

namespace tr {

namespace {

constexpr size_t Digits = 64;  // of the hash that stands in front of a file's content
constexpr const char *Suffix = ".cubin";

std::string variable(const char *name) {
    const char *value = std::getenv(name);
    return value ? value : "";
}

void make_folders(const std::string &path) {
    for (size_t i = path.find('/', 1); i != std::string::npos; i = path.find('/', i + 1))
        mkdir(path.substr(0, i).c_str(), 0777);
    mkdir(path.c_str(), 0777);
}

}  // namespace

std::string default_kernel_folder() {
    std::string base = variable("TORCHRENDER_CACHE");
    if (base.empty()) {
        const std::string xdg = variable("XDG_CACHE_HOME");
        base = (xdg.empty() ? variable("HOME") + "/.cache" : xdg) + "/torchrender";
    }
    return base + "/kernels";
}

KernelCache::KernelCache(std::string folder, size_t limit) : folder_(std::move(folder)), limit_(limit) {}

std::optional<std::string> KernelCache::find(const std::string &key) const {
    std::ifstream file(path(key), std::ios::binary);
    const std::string all{std::istreambuf_iterator<char>(file), {}};
    if (!file || all.size() < Digits) return {};
    std::string content = all.substr(Digits);
    if (sha256(content) != all.substr(0, Digits)) return {};
    utimensat(AT_FDCWD, path(key).c_str(), nullptr, 0);  // used now
    return content;
}

void KernelCache::put(const std::string &key, const std::string &content) const {
    make_folders(folder_);
    // Under a name of its own first, so that others see it whole or not at all.
    static std::atomic<unsigned> number{0};
    const std::string fresh = path(key) + "." + std::to_string(getpid()) + "." + std::to_string(number++);
    {
        std::ofstream file(fresh, std::ios::binary);
        file << sha256(content) << content;
        file.close();
        if (file.fail()) {
            std::remove(fresh.c_str());
            return;
        }
    }
    if (std::rename(fresh.c_str(), path(key).c_str()) != 0) std::remove(fresh.c_str());
    shrink();
}

void KernelCache::shrink() const {
    struct Entry {
        std::pair<int64_t, int64_t> used;  // seconds, nanoseconds
        std::string path;
        size_t bytes;
    };
    std::vector<Entry> all;
    size_t total = 0;
    DIR *folder = opendir(folder_.c_str());
    if (!folder) return;
    while (const dirent *found = readdir(folder)) {
        const std::string name = found->d_name;
        const size_t end = name.rfind(Suffix);
        if (end == std::string::npos || end + std::strlen(Suffix) != name.size()) continue;
        struct stat state;
        const std::string file = folder_ + "/" + name;
        if (stat(file.c_str(), &state) != 0) continue;
#if defined(__APPLE__)
        const timespec used = state.st_mtimespec;
#else
        const timespec used = state.st_mtim;
#endif
        all.push_back({{used.tv_sec, used.tv_nsec}, file, size_t(state.st_size)});
        total += size_t(state.st_size);
    }
    closedir(folder);
    std::sort(all.begin(), all.end(), [](const Entry &a, const Entry &b) { return a.used < b.used; });
    for (const Entry &entry : all) {
        if (total <= limit_) return;
        std::remove(entry.path.c_str());
        total -= entry.bytes;
    }
}

}  // namespace tr
