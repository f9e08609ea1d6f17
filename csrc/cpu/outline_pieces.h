// Outlines that a camera, or a small light, may see, cut into pieces, from which one is chosen by its length there.
#pragma once

#include <cmath>
#include <vector>

#include "core/sensor/camera.h"
#include "host/parallel.h"
#include "outline_points.h"
#include "render.h"

namespace tr {

struct OutlinePiece {
    int32_t element;
    float begin, end;  // of its parameter
};

struct OutlinePieces {
    std::vector<OutlinePiece> all;
    std::vector<double> cdf;  // lengths on the film in pixels, added up

    double total() const { return cdf.empty() ? 0 : cdf.back(); }
};

// One of them, for a number in [0, 1): which, a number in [0, 1) that is left, and one over the density of a place on
// it by the parameter.
struct ChosenPiece {
    const OutlinePiece *piece;
    double left, inverse_density;

    ChosenPiece(const OutlinePieces &pieces, double number) {
        const double *cdf = pieces.cdf.data(), *end = cdf + pieces.cdf.size(), total = pieces.total();
        const double at = number * total, *found = std::min(std::upper_bound(cdf, end, at), end - 1);
        piece = &pieces.all[size_t(found - cdf)];
        const double before = found > cdf ? found[-1] : 0, mass = *found - before;
        left = std::clamp((at - before) / mass, 0.0, 1 - 0x1p-53);
        inverse_density = total * (double(piece->end) - double(piece->begin)) / mass;
    }
    double place(double u) const { return piece->begin + (double(piece->end) - double(piece->begin)) * u; }
};

template <class S>
class OutlineCandidates {
protected:
    using V = Vec3<S>;
    const SceneView<S> &scene_;
    const OutlineSet &set_;
    const Outlines<S> outlines_;
    const int threads_;

    OutlineCandidates(const SceneView<S> &scene, const OutlineSet &set, int threads)
        : scene_(scene), set_(set), outlines_(scene, set), threads_(threads) {}

    using Elements = OutlineLeaves::Elements;
    using Weights = float[OutlineTree::Wide];

    // The pieces of all elements that may be outlines: cut(elements, weights, pieces) appends those of a leaf, but for
    // those of no weight, with their lengths, which are not added up yet. `still`: the weight of those that rest. With
    // `creases` these count, too.
    template <class Cut>
    OutlinePieces cut_all(const OutlineView<S> &view, float still, bool creases, Cut &&cut) const {
        const OutlineTree &tree = set_.tree();
        const Vec3<float> o{float(view.origin.x), float(view.origin.y), float(view.origin.z)};
        OutlinePieces r;
        collect(tree.n_leaves(), r, [&](size_t leaf, OutlinePieces &to) {
            tree.if_outlines(leaf, o, view.parallel, float(view.beside), still > 0,
                             [&](const auto &all, auto &rounding) {
                                 alignas(64) Weights weights;
                                 if (find_candidates(all, rounding, o, view, still, creases, weights))
                                     cut(all, weights, to);
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
        if (to.all.empty()) std::swap(to.all, found[0].all);
        double sum = to.total();
        for (const OutlinePieces &part : found) {
            to.all.insert(to.all.end(), part.all.begin(), part.all.end());
            for (double length : part.cdf) to.cdf.push_back(sum += length);
        }
    }

    // A piece; and all pieces of what is scattered over a shape, with the same length each.
    static void add(int32_t element, S begin, S end, double length, OutlinePieces &to) {
        to.all.push_back({element, float(begin), float(end)});
        to.cdf.push_back(length);
    }
    static void scatter(int32_t element, double length, OutlinePieces &to) {
        constexpr int n = 64;
        for (int i = 0; i < n; ++i) add(element, S(i) / n, S(i + 1) / n, length, to);
    }

private:
    // Whether elements can be outlines or creases from there: weights; false if none can.
    static bool find_candidates(const Elements &all, const OutlineLeaves::Rounding &rounding, const Vec3<float> &o,
                                const OutlineView<S> &view, float still, bool creases, Weights &weights) {
        using F = PacketOf<float>;
        using M = MaskOf<F>;
        bool some = false;
        for (size_t i = 0; i < OutlineTree::Wide; i += size_t(Lanes<F>::Width)) {
            const F given = load<F>(&all.weight[i]), bend = load<F>(&all.bend[i]);
            const IntOf<F> kind(load_uint<F>(reinterpret_cast<const uint32_t *>(&all.kind[i])));
            const F weight = select(mask<F>(given > F(0)), F(1), select(mask<F>(given < F(0)), F(still), F(0)));
            const Vec3<F> from{F(o.x), F(o.y), F(o.z)}, d = view.parallel ? from : load_vector<F>(all.a, i) - from;
            const F s0 = dot(load_vector<F>(all.n0, i), d), s1 = dot(load_vector<F>(all.n1, i), d);
            const F margin = F(float(view.beside) + std::max(rounding.place, 0.f)) +
                             F(std::max(rounding.normal, 1e-5f)) * sqrt(squared_norm(d));
            const M same =
                (mask<F>(s0 > margin) && mask<F>(s1 > margin)) || (mask<F>(s0 < -margin) && mask<F>(s1 < -margin));
            const M crease = mask<F>(kind == int32_t(OutlineElement::Crease)) && mask<F>(bend > F(1e-6f));
            const M always =
                mask<F>(kind == int32_t(OutlineElement::Round)) || mask<F>(kind == int32_t(OutlineElement::Always));
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
    using Base::outlines_, Base::scene_, Base::set_;
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
        auto cut = [&](const auto &all, const auto &weights, OutlinePieces &to) { cut_leaf(all, weights, to); };
        OutlinePieces r = this->cut_all({origin_, parallel_, lens_}, glued_ ? 0.25f : 0.f, !glued_, cut);
        for (int32_t s = 0; s < scene_.n_shapes; ++s) {
            const ShapeInfo &info = scene_.shapes[s];
            if ((info.flags & IsCurved) || !(info.flags & HasNormals) || !set_.moves(uint32_t(s))) continue;
            this->collect(size_t(info.n_faces), r, [&](size_t k, OutlinePieces &to) {
                const uint32_t face = uint32_t(info.face_offset) + uint32_t(k);
                if (Rim<S>(scene_, face, origin_, parallel_).possible(lens_))
                    this->cut(int32_t(set_.element_of_face(face)), RimWeight, to);
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

    struct OnFilm {
        S length, x, y;  // of it, roughly, and the place of its middle, if it has one there
        bool seen;
    };
    OnFilm on_film(int32_t element, S begin, S end, int steps) const {
        const S width = S(call_.film_width), height = S(call_.film_height);
        OnFilm r{0, S(NAN), S(NAN), false};
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
            r.seen |= is;
            before[0] = at.x, before[1] = at.y, was = is;
            if (2 * i == steps && is) r.x = at.x, r.y = at.y;
        }
        r.seen |= lens_ > 0;
        return r;
    }

    // Lengths of edges on the film, roughly, and the places of their middles; infinite where both ends do not tell.
    template <class F>
    void ends_on_film(const Elements &all, size_t i, S *x, S *y, S *length) const {
        if (distant_ || panorama_) return std::fill_n(length, size_t(Lanes<F>::Width), S(INFINITY)), void();
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
        store(x, (a.x + b.x) * F(0.5)), store(y, (a.y + b.y) * F(0.5));
        store(length, select(seen_a && seen_b, sqrt(dx * dx + dy * dy), F(S(INFINITY))));
    }

    // The lengths are not added up yet. Of edges in fine meshes their ends, many at once, say all.
    void cut_leaf(const Elements &all, const Weights &weights, OutlinePieces &to) const {
        using F = PacketOf<S>;
        constexpr size_t W = size_t(Lanes<F>::Width);
        alignas(64) S x[W], y[W], length[W];
        for (size_t i = 0; i < OutlineTree::Wide; i += W) {
            ends_on_film<F>(all, i, x, y, length);
            for (size_t k = 0; k < W; ++k) {
                if (!(weights[i + k] > 0)) continue;
                const int32_t element = all.index[i + k];
                if (length[k] < Pixels / 2 && set_.is_edge(size_t(element)))
                    add(element, S(0), S(1), {length[k], x[k], y[k], true}, weights[i + k], to);
                else
                    cut(element, weights[i + k], to);
            }
        }
    }

    void cut(int32_t element, float weight, OutlinePieces &to) const {
        if (outlines_.is_scattered(element)) {
            if (outlines_.may_be_seen(element, {origin_, parallel_, lens_}, !glued_))
                Base::scatter(element, double(weight) * double(Pixels), to);
            return;
        }
        const OnFilm whole = on_film(element, S(0), S(1), 8);
        if (!whole.seen) return;
        int n = int(std::min(std::ceil(whole.length / Pixels), S(Most)));
        if (set_.is_curve(size_t(element))) n = std::max(n, Fewest);
        for (int i = 0; i < n; ++i) {
            const S begin = S(i) / S(n), end = S(i + 1) / S(n);
            add(element, begin, end, on_film(element, begin, end, 2), weight, to);
        }
    }
    void add(int32_t element, S begin, S end, const OnFilm &piece, float weight, OutlinePieces &to) const {
        const S most = distant_ ? 2 * DistantPixels : S(call_.crop.height() + call_.crop.width());
        const S length = std::min(piece.length, most);
        if (!piece.seen || !(length > 0) || !(distant_ || is_near(piece, length))) return;
        Base::add(element, begin, end, double(weight) * double(length), to);
    }

    // Whether wanted pixels may get something of it.
    bool is_near(const OnFilm &piece, S length) const {
        if (!std::isfinite(piece.x) || !std::isfinite(piece.y)) return true;
        const Rect &crop = call_.crop;
        const S margin =
            length + S(call_.filter.reach() + 1) + (lens_ > 0 ? S(crop.height() + crop.width()) / 2 : S(0));
        const S x = piece.x - S(crop.x0), y = piece.y - S(crop.y0);
        if (!(x > -margin && x < S(crop.width()) + margin && y > -margin && y < S(crop.height()) + margin))
            return false;
        if (near_.empty()) return true;
        const int reach = int(margin) + int(Pixels);
        auto count = [&](int row, int column) {
            row = std::clamp(row, 0, crop.height()), column = std::clamp(column, 0, crop.width());
            return near_[size_t(row) * size_t(crop.width() + 1) + size_t(column)];
        };
        const int row = int(y), column = int(x);
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
