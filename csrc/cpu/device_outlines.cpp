#include "device_outlines.h"

namespace tr {

OutlineTable DeviceOutlines::table(Launcher &launcher, const OutlineSet &set) {
    if (revision_ == set.revision()) return table_;
    revision_ = 0;  // until it is there
    const OutlineTable &host = set.table();
    const auto put = [&](auto &array, const auto *from, size_t n) {
        array.upload(launcher, from, n);
        return array.get();
    };
    OutlineTable r = host;
    const uint32_t n_corners = host.n_edges > 0 ? host.begin[host.n_edges] : 0;
    r.corners = put(corners_, host.corners, n_corners), r.begin = put(begin_, host.begin, size_t(host.n_edges) + 1);
    r.around = put(around_, host.around, host.n_edges), r.meshes = put(meshes_, host.meshes, host.n_meshes);
    r.curves = put(curves_, host.curves, host.n_curves), r.moving = put(moving_, host.moving, set.n_shapes());
    const OutlineLeaves &leaves = host.tree.leaves;
    r.tree.leaves.exact = put(exact_, leaves.exact, leaves.n_exact);
    r.tree.leaves.rounded = put(rounded_, leaves.rounded, leaves.n_rounded);
    levels_.resize(std::max(levels_.size(), size_t(host.tree.n_levels)));
    size_t n = leaves.size();
    for (int l = 0; l < host.tree.n_levels; ++l) {
        n = (n + OutlineWide - 1) / OutlineWide;
        r.tree.levels[l] = put(levels_[size_t(l)], host.tree.levels[l], n);
    }
    revision_ = set.revision();
    return table_ = r;
}

OutlinePiecesView DeviceOutlines::Pieces::upload(Launcher &launcher, const OutlinePieces &given) {
    all.upload(launcher, given.all.data(), given.all.size()), cdf.upload(launcher, given.cdf.data(), given.cdf.size());
    leaves.upload(launcher, given.leaves.data(), given.leaves.size());
    return {all.get(), cdf.get(), leaves.get(), uint32_t(given.all.size())};
}

OutlinePiecesView DeviceOutlines::pieces(Launcher &launcher, const OutlinePieces &given) {
    return pieces_.upload(launcher, given);
}

const OutlinePiecesView *DeviceOutlines::shadows(Launcher &launcher, const ShadowPieces &given) {
    std::vector<OutlinePiecesView> views(given.of.size());
    if (shadows_.size() < views.size()) shadows_.resize(views.size());
    for (size_t i = 0; i < views.size(); ++i) views[i] = shadows_[i].upload(launcher, given.of[i]);
    views_.upload(launcher, views.data(), views.size());
    return views_.get();
}

}  // namespace tr
