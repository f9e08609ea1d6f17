// Outlines that a camera, or a small light, may see, cut into pieces.
#pragma once

#include <cmath>
#include <numeric>
#include <vector>

#include "core/boundary/outline_points.h"
#include "core/sensor/camera.h"
#include "host/outline_set.h"
#include "host/parallel.h"
#include "outline_pieces.h"
#include "render.h"

namespace tr {

template <class S>
class OutlineCandidates {
protected:
    using V = Vec3<S>;
    const SceneView<S> &scene_;
    const OutlineTable &table_;
    const OutlineTree &tree_;
    const Outlines<S> outlines_;
    const int threads_;

    OutlineCandidates(const SceneView<S> &scene, const OutlineSet &set, int threads)
        : scene_(scene), table_(set.table()), tree_(set.tree()), outlines_(scene, set.table()), threads_(threads) {}

    using Elements = OutlineLeaf;
    using Weights = float[OutlineWide];

    // The pieces of all elements that may be outlines: cut(leaf, elements, weights, pieces) appends those of a leaf,
    // but for those of no weight, with their lengths, which are not added up yet. `still`: the weight of those that
    // rest. With `creases` these count, too.
    template <class Cut>
    OutlinePieces cut_all(const OutlineView<S> &view, float still, bool creases, Cut &&cut) const {
        const Vec3<float> o{float(view.origin.x), float(view.origin.y), float(view.origin.z)};
        OutlinePieces r;
        collect(tree_.n_leaves(), r, [&](size_t leaf, OutlinePieces &to) {
            tree_.if_outlines(leaf, o, view.parallel, float(view.beside), still > 0,
                              [&](const auto &all, auto &rounding) {
                                  alignas(64) Weights weights;
                                  if (find_candidates(all, rounding, o, view, still, creases, weights))
                                      cut(leaf, all, weights, to);
                              });
        });
        return r;
    }

    // Appends pieces that visit(i, to) appends, for i < n: in the same order for any number of threads.
    template <class Visit>
    void collect(size_t n, OutlinePieces &to, Visit &&visit) const {
        constexpr size_t few = 256;
        std::vector<OutlinePieces> found(size_t(std::max(1, threads_)));
        auto each = [&](size_t begin, size_t end, int range) {
            for (size_t i = begin; i < end; ++i) visit(i, found[size_t(range)]);
        };
        for_ranges(n, threads_, each, few);
        double sum = to.total();
        for (const OutlinePieces &part : found) {
            const int32_t leaves = int32_t(to.leaves.size());
            for (OutlinePiece piece : part.all) {
                if (piece.element < 0) piece.element -= leaves;
                to.all.push_back(piece);
            }
            to.leaves.insert(to.leaves.end(), part.leaves.begin(), part.leaves.end());
            for (double length : part.cdf) to.cdf.push_back(sum += length);
        }
    }

    // A piece; one of short edges of a leaf, with these lengths; and all pieces of what is scattered over a shape, with
    // the same length each.
    static void add(int32_t element, S begin, S end, double length, OutlinePieces &to) {
        to.all.push_back({element, float(begin), float(end)});
        to.cdf.push_back(length);
    }
    static void add_leaf(size_t leaf, const Weights &lengths, OutlinePieces &to) {
        const double sum = std::accumulate(lengths, lengths + OutlineWide, 0.0);
        if (!(sum > 0)) return;
        add(-1 - int32_t(to.leaves.size()), S(0), S(1), sum, to);
        to.leaves.push_back(leaf_piece(leaf, lengths));
    }
    static void scatter(int32_t element, double length, OutlinePieces &to) {
        constexpr int n = 64;
        for (int i = 0; i < n; ++i) add(element, S(i) / n, S(i + 1) / n, length, to);
    }

private:
    // Whether elements can be outlines or creases from there: weights; false if none can.
    static bool find_candidates(const Elements &all, const LeafRounding &rounding, const Vec3<float> &o,
                                const OutlineView<S> &view, float still, bool creases, Weights &weights) {
        using F = PacketOf<float>;
        using M = MaskOf<F>;
        bool some = false;
        for (size_t i = 0; i < OutlineWide; i += size_t(Lanes<F>::Width)) {
            const F given = load<F>(&all.weight[i]), bend = load<F>(&all.bend[i]);
            const F weight = select(mask<F>(given > F(0)), F(1), select(mask<F>(given < F(0)), F(still), F(0)));
            const Vec3<F> from{F(o.x), F(o.y), F(o.z)}, d = view.parallel ? from : load_vector<F>(all.a, i) - from;
            const F s0 = dot(load_vector<F>(all.n0, i), d), s1 = dot(load_vector<F>(all.n1, i), d);
            const F margin = F(float(view.beside) + std::max(rounding.place, 0.f)) +
                             F(std::max(rounding.normal, 1e-5f)) * sqrt(squared_norm(d));
            const M same =
                (mask<F>(s0 > margin) && mask<F>(s1 > margin)) || (mask<F>(s0 < -margin) && mask<F>(s1 < -margin));
            const M crease = all.are<F>(OutlineElement::Crease, i) && mask<F>(bend > F(1e-6f));
            const M always = all.are<F>(OutlineElement::Round, i) || all.are<F>(OutlineElement::Always, i);
            const F folded = creases ? select(crease, max(F(0.05f), min(bend, F(1))), F(0)) : F(0);
            const F r = select(mask<F>(weight > F(0)), select(always || !same, weight, folded), F(0));
            store(&weights[i], r);
            some |= any(mask<F>(r > F(0)));
        }
        return some;
    }
};

template <class S>
class OutlineCutter : OutlineCandidates<S> {
    using Base = OutlineCandidates<S>;
    using Base::outlines_, Base::scene_, Base::table_;
    using typename Base::Elements, typename Base::V, typename Base::Weights;
    static constexpr S Pixels = 16;                // length of a piece on the film
    static constexpr S DistantPixels = 64;         // what counts as so many, of `distant`, whose one pixel sees all
    static constexpr float RimWeight = 0.25f;      // many are hidden, and narrow faces have long ones
    static constexpr int Most = 256, Fewest = 32;  // pieces of an outline, and of a curve

public:
    // `glued`: where what is behind an outline moves with its surface, those that rest count, too, and creases do not.
    OutlineCutter(const RenderCall<S> &call, const OutlineSet &set, bool glued)
        : Base(*call.scene, set, call.threads),
          call_(call),
          record_(call.scene->sensors[call.config.sensor]),
          glued_(glued) {
        const S width = S(call.film_width), height = S(call.film_height);
        CameraSample<S> middle{width / 2, height / 2};
        const CameraRay<S> ray = camera_ray<S>(scene_, record_, middle, width, height);
        parallel_ = is_parallel(record_), distant_ = record_.kind == kind_of_model<Distant>(Sensors{});
        origin_ = parallel_ ? ray.ray.d : ray.center;
        if (record_.kind == kind_of_model<ThinLens>(Sensors{}))
            lens_ = call.scene->values.constants[record_.field[ThinLens::ApertureRadius]];
        panorama_ = record_.kind == kind_of_model<Panorama>(Sensors{});
        if (call.pixels) find_near();
    }

    OutlinePieces cut() const {
        auto cut = [&](size_t leaf, const auto &all, const auto &weights, OutlinePieces &to) {
            cut_leaf(leaf, all, weights, to);
        };
        OutlinePieces r = this->cut_all({origin_, parallel_, lens_}, glued_ ? 0.25f : 0.f, !glued_, cut);
        for (int32_t s = 0; s < scene_.n_shapes; ++s) {
            const ShapeInfo &info = scene_.shapes[s];
            if ((info.flags & IsCurved) || !(info.flags & HasNormals) || !table_.moves(uint32_t(s))) continue;
            this->collect(size_t(info.n_faces), r, [&](size_t k, OutlinePieces &to) {
                const uint32_t face = uint32_t(info.face_offset) + uint32_t(k);
                if (Rim<S>(scene_, face, origin_, parallel_).possible(lens_))
                    this->cut(int32_t(table_.element_of_face(face)), RimWeight, to);
            });
        }
        return r;
    }

private:
    const RenderCall<S> &call_;
    const Record &record_;
    const bool glued_;
    bool parallel_, distant_, panorama_;
    V origin_;  // of rays, or, `parallel_`, their direction
    S lens_ = 0;
    std::vector<uint32_t> near_;  // with a list of pixels: how many of it are above and to the left, in the crop

    template <class F>
    struct OnFilm {
        F length, x, y;  // of it, roughly, 0 if nothing is seen, and the place of its middle, if it has one there
    };
    OnFilm<S> on_film(int32_t element, S begin, S end, int steps) const {
        const S width = S(call_.film_width), height = S(call_.film_height);
        OnFilm<S> r{0, S(NAN), S(NAN)};
        S before[2] = {};
        bool was = false;
        for (int i = 0; i <= steps; ++i) {
            const V p = outlines_.place(element, begin + (end - begin) * S(i) / S(steps), origin_, parallel_);
            CameraSample<S> at{S(0), S(0)};
            const bool is =
                film_place<S>(scene_, record_, p, width, height, at) && std::isfinite(at.x) && std::isfinite(at.y);
            if (distant_) at.x = at.lens_x * DistantPixels, at.y = at.lens_y * DistantPixels;
            if (i > 0 && is && was) {
                S step = std::sqrt((at.x - before[0]) * (at.x - before[0]) + (at.y - before[1]) * (at.y - before[1]));
                r.length += panorama_ ? std::min(step, width / 4) : step;  // (around the seam)
            } else if (i > 0 && is != was) {
                r.length += Pixels * 2;  // nobody knows
            }
            before[0] = at.x, before[1] = at.y, was = is;
            if (2 * i == steps && is) r.x = at.x, r.y = at.y;
        }
        return r;
    }

    // Of edges, whose length is infinite where both ends do not tell.
    template <class F>
    OnFilm<F> ends_on_film(const Elements &all, size_t i) const {
        if (distant_ || panorama_) return {F(S(INFINITY)), F(S(0)), F(S(0))};
        const S width = S(call_.film_width), height = S(call_.film_height);
        auto place = [&](const auto &columns, MaskOf<F> &seen) {
            auto column = [&](size_t c) { return convert<F>(load<PacketOf<float>>(&columns[c][i])); };
            CameraSample<F> at{F(0), F(0)};
            seen = film_place<F>(scene_, record_, Vec3<F>{column(0), column(1), column(2)}, width, height, at);
            seen = seen && isfinite(at.x) && isfinite(at.y);
            return Vec2<F>{at.x, at.y};
        };
        MaskOf<F> seen_a, seen_b;
        const Vec2<F> a = place(all.a, seen_a), b = place(all.b, seen_b);
        const F dx = b.x - a.x, dy = b.y - a.y;
        return {select(seen_a && seen_b, sqrt(dx * dx + dy * dy), F(S(INFINITY))), (a.x + b.x) * F(0.5),
                (a.y + b.y) * F(0.5)};
    }

    // Of edges in fine meshes their ends, many at once, say all.
    void cut_leaf(size_t leaf, const Elements &all, const Weights &weights, OutlinePieces &to) const {
        using F = PacketOf<S>;
        using M = MaskOf<F>;
        constexpr size_t W = size_t(Lanes<F>::Width);
        alignas(64) Weights lengths;
        for (size_t i = 0; i < OutlineWide; i += W) {
            const OnFilm<F> at = ends_on_film<F>(all, i);
            const F weight = convert<F>(load<PacketOf<float>>(&weights[i]));
            const M some = mask<F>(weight > F(0)), edge = !all.template are<F>(OutlineElement::Round, i);
            const M brief = edge && mask<F>(at.length < F(Pixels / 2));
            store(&lengths[i], convert<PacketOf<float>>(select(some && brief, weight * counted(at), F(0))));
            if (!any(some && !brief)) continue;
            alignas(64) S others[W];
            store(others, select(some && !brief, F(1), F(0)));
            for (size_t k = 0; k < W; ++k)
                if (others[k] > 0) cut(all.index[i + k], weights[i + k], to);
        }
        Base::add_leaf(leaf, lengths, to);
    }

    void cut(int32_t element, float weight, OutlinePieces &to) const {
        if (outlines_.is_scattered(element)) {
            if (outlines_.may_be_seen(element, {origin_, parallel_, lens_}, !glued_))
                Base::scatter(element, double(weight) * double(Pixels), to);
            return;
        }
        const OnFilm<S> whole = on_film(element, S(0), S(1), 8);
        if (!(whole.length > 0 || lens_ > 0)) return;
        int n = int(std::min(std::ceil(whole.length / Pixels), S(Most)));
        if (table_.is_curve(size_t(element))) n = std::max(n, Fewest);
        for (int i = 0; i < n; ++i) {
            const S begin = S(i) / S(n), end = S(i + 1) / S(n);
            add(element, begin, end, on_film(element, begin, end, 2), weight, to);
        }
    }
    void add(int32_t element, S begin, S end, const OnFilm<S> &piece, float weight, OutlinePieces &to) const {
        const double length = double(weight) * double(counted(piece));
        if (length > 0) Base::add(element, begin, end, length, to);
    }

    // The lengths of what wanted pixels may get something of.
    template <class F>
    F counted(const OnFilm<F> &at) const {
        const Rect &crop = call_.crop;
        const S around = S(crop.height() + crop.width());
        const F length = min(at.length, F(distant_ ? 2 * DistantPixels : around));
        MaskOf<F> counts = mask<F>(length > F(0));
        if (!distant_) {
            const F margin = length + F(S(call_.filter.reach() + 1) + (lens_ > 0 ? around / 2 : S(0)));
            const F x = at.x - F(S(crop.x0)), y = at.y - F(S(crop.y0));
            auto within = [&](const F &z, int size) {
                return !isfinite(z) || (mask<F>(z > -margin) && mask<F>(z < F(S(size)) + margin));
            };
            counts = counts && within(x, crop.width()) && within(y, crop.height());
            if (!near_.empty()) counts = counts && are_listed(x, y, margin);
        }
        return select(counts, length, F(0));
    }
    template <class F>
    MaskOf<F> are_listed(const F &x, const F &y, const F &margin) const {
        constexpr size_t W = size_t(Lanes<F>::Width);
        alignas(64) S columns[W], rows[W], margins[W], found[W];
        store(columns, x), store(rows, y), store(margins, margin);
        for (size_t k = 0; k < W; ++k) found[k] = S(is_listed(columns[k], rows[k], margins[k]));
        return mask<F>(load<F>(found) > F(0));
    }
    bool is_listed(S x, S y, S margin) const {
        if (!std::isfinite(x) || !std::isfinite(y)) return true;
        const Rect &crop = call_.crop;
        const S most = S(crop.height() + crop.width());
        auto pixels = [&](S z) { return int(std::clamp(z, -2 * most, 2 * most)); };
        const int reach = pixels(margin) + int(Pixels), row = pixels(y), column = pixels(x);
        auto count = [&](int r, int c) {
            r = std::clamp(r, 0, crop.height()), c = std::clamp(c, 0, crop.width());
            return near_[size_t(r) * size_t(crop.width() + 1) + size_t(c)];
        };
        return count(row + reach + 1, column + reach + 1) + count(row - reach, column - reach) >
               count(row - reach, column + reach + 1) + count(row + reach + 1, column - reach);
    }
    void find_near() {
        const size_t width = size_t(call_.crop.width()) + 1, height = size_t(call_.crop.height()) + 1;
        near_.assign(width * height, 0);
        for (const Pixel &p : *call_.pixels)
            ++near_[size_t(p.y - call_.crop.y0 + 1) * width + size_t(p.x - call_.crop.x0 + 1)];
        for (size_t y = 1; y < height; ++y)
            for (size_t x = 1; x < width; ++x)
                near_[y * width + x] +=
                    near_[(y - 1) * width + x] + near_[y * width + x - 1] - near_[(y - 1) * width + x - 1];
    }
};

}  // namespace tr
