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

    // The pieces of all elements that may be outlines: cut(element, weight, pieces) appends those of one, with their
    // lengths, which are not added up yet. `still`: the weight of those that rest. With `creases` these count, too.
    template <class Cut>
    OutlinePieces cut_all(const OutlineView<S> &view, float still, bool creases, Cut &&cut) const {
        const OutlineTree &tree = set_.tree();
        const Vec3<float> o{float(view.origin.x), float(view.origin.y), float(view.origin.z)};
        OutlinePieces r;
        collect(tree.n_leaves(), r, cut, [&](size_t leaf, auto &&add) {
            tree.for_outlines(leaf, o, view.parallel, float(view.beside), still > 0, [&](int32_t i) {
                const float weight = candidate(set_.element(scene_, size_t(i)), o, view, still, creases);
                if (weight > 0) add(size_t(i), weight);
            });
        });
        return r;
    }

    // Appends pieces of what visit(i, add) adds, an element and its weight, for i < n: in the same order for any number
    // of threads.
    template <class Cut, class Visit>
    void collect(size_t n, OutlinePieces &to, Cut &&cut, Visit &&visit) const {
        constexpr size_t few = 256;
        std::vector<OutlinePieces> found(size_t(std::max(1, threads_)));
        auto each = [&](size_t begin, size_t end, int range) {
            auto add = [&](size_t i, float weight) { cut(int32_t(i), weight, found[size_t(range)]); };
            for (size_t i = begin; i < end; ++i) visit(i, add);
        };
        for_ranges(n, threads_, each, few);
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
    // Whether an element can be an outline or a crease from there: a weight.
    static float candidate(const OutlineElement &e, const Vec3<float> &o, const OutlineView<S> &view, float still,
                           bool creases) {
        const float weight = e.moves ? 1.f : still;
        if (!(weight > 0) || !(e.weight > 0)) return 0;
        if (e.kind == OutlineElement::Round || e.kind == OutlineElement::Always) return weight;
        const Vec3<float> d = view.parallel ? o : e.a - o;
        const float s0 = dot(e.n0, d), s1 = dot(e.n1, d);
        const float margin = float(view.beside) + 1e-5f * std::sqrt(dot(d, d));
        const bool same = (s0 > margin && s1 > margin) || (s0 < -margin && s1 < -margin);
        if (!same) return weight;
        if (!creases || e.kind != OutlineElement::Crease || !(e.bend > 1e-6f)) return 0;
        return std::min(std::max(e.bend, 0.05f), 1.f);
    }
};

template <class S>
class OutlineCutter : OutlineCandidates<S> {
    using Base = OutlineCandidates<S>;
    using Base::outlines_, Base::scene_, Base::set_;
    using typename Base::V;
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
        auto cut = [&](int32_t element, float weight, OutlinePieces &to) { this->cut(element, weight, to); };
        OutlinePieces r = this->cut_all({origin_, parallel_, lens_}, glued_ ? 0.25f : 0.f, !glued_, cut);
        for (int32_t s = 0; s < scene_.n_shapes; ++s) {
            const ShapeInfo &info = scene_.shapes[s];
            if ((info.flags & IsCurved) || !(info.flags & HasNormals) || !set_.moves(uint32_t(s))) continue;
            this->collect(size_t(info.n_faces), r, cut, [&](size_t k, auto &&add) {
                const uint32_t face = uint32_t(info.face_offset) + uint32_t(k);
                if (Rim<S>(scene_, face, origin_, parallel_).possible(lens_))
                    add(set_.element_of_face(face), RimWeight);
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
            if (steps == 1 && is && was) r.x = (before[0] + at.x) / 2, r.y = (before[1] + at.y) / 2;
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

    // The lengths are not added up yet.
    void cut(int32_t element, float weight, OutlinePieces &to) const {
        if (outlines_.is_scattered(element)) {
            if (outlines_.may_be_seen(element, {origin_, parallel_, lens_}, !glued_))
                Base::scatter(element, double(weight) * double(Pixels), to);
            return;
        }
        auto add = [&](S begin, S end, const OnFilm &piece) {
            const S most = distant_ ? 2 * DistantPixels : S(call_.crop.height() + call_.crop.width());
            const S length = std::min(piece.length, most);
            if (!piece.seen || !(length > 0) || !(distant_ || is_near(piece, length))) return;
            Base::add(element, begin, end, double(weight) * double(length), to);
        };
        if (set_.is_edge(size_t(element)) && !distant_ && !panorama_) {  // of fine meshes: their ends say all
            const OnFilm ends = on_film(element, S(0), S(1), 1);
            if (std::isfinite(ends.x) && ends.length < Pixels / 2) return add(S(0), S(1), ends);
        }
        const OnFilm whole = on_film(element, S(0), S(1), 8);
        if (!whole.seen) return;
        int n = int(std::min(std::ceil(whole.length / Pixels), S(Most)));
        if (set_.is_curve(size_t(element))) n = std::max(n, Fewest);
        for (int i = 0; i < n; ++i) {
            const S begin = S(i) / S(n), end = S(i + 1) / S(n);
            add(begin, end, on_film(element, begin, end, 2));
        }
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
