// What samples of outlines have in common, whichever way they are found: their random numbers, rays beside outlines,
// and what these tell. A sample is one scalar S of which everybody knows the number.
#pragma once

#include "../film/filter.h"
#include "../film/sums.h"
#include "../integrator/camera.h"
#include "outline_pieces.h"
#include "outline_points.h"

namespace tr {

// What a call wants of them; tables are those of whoever computes.
template <class S>
struct BoundaryView {
    OutlineTable outlines;
    OutlinePiecesView pieces;  // that the camera sees
    // Of a pass there are so many samples, and sample i takes a random place from i / samples to (i + 1) / samples: of
    // silhouettes along all pieces, else among the cells, (n_cells, 2): x and y of squares of the film.
    double samples;
    const int64_t *cells;
    uint64_t n_cells;
    uint64_t first;   // number of the first sample
    double total;     // samples in all passes
    double near;      // what counts as close
    double in_view;   // the share of the outlines that lights see which the camera sees
    bool glued;       // points move with their surfaces, as those of light paths do
    S width, height;  // of the film
    Rect crop, sampled;
    int32_t reach;  // of the filter

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        outlines.for_pointers(visit), pieces.for_pointers(visit), visit(cells);
    }
};

// A sample's number, 64 bits of it, in the places of a path's pixel and sample.
struct OutlineSample {
    uint32_t low, high;
    TR_HD OutlineSample(uint32_t low, uint32_t high) : low(low), high(high) {}
    TR_HD explicit OutlineSample(uint64_t number) : low(uint32_t(number)), high(uint32_t(number >> 32)) {}
    TR_HD uint64_t number() const { return uint64_t(high) << 32 | low; }
};

// Look-ups of light whose pixels' numbers differ from this bit on, or whose samples' do, belong to one sample.
constexpr int CopyBit = 27;

// A place on the film, in a pixel that it was rounded up from.
template <class S>
TR_HD S within_pixel(S place, uint32_t pixel) {
    return std::min(place, std::nextafter(S(int32_t(pixel) + 1), S(-INFINITY)));
}

// Beside an outline, and what it meets once that is known.
template <class S>
struct OutlineRay {
    Vec3<S> o, d;
    SurfacePoint<S> at{NoHit, 0, 0, 0};
    S t = S(INFINITY);
    Vec3<S> met_from{};  // where it was when it met that, beyond emitters that it has passed

    // From where it begins to what it has met.
    TR_HD S distance() const { return t + dot(met_from - o, d); }
    TR_HD void meet(const SurfacePoint<S> &found, S distance, const Vec3<S> &from) {
        at = found, met_from = from;
        t = at.shape == NoHit ? S(INFINITY) : distance;
    }
};

// A point of an edge as a ray sees it that begins at a distance of it, has a length, and passes it at `at`.
//
// Where fine meshes fold a little, as seen from somewhere, edges that turn back and forth cross each other at small
// angles, and for a part of their lengths are closer to each other than rays beside them can tell (least_side): those
// beside each of them see what is behind all, whose light would count more than once, 0.7 % of the silhouette of a
// monkey of 62976 faces. Of edges whose faces are narrow there rays look closer: they begin not far before the edge,
// where they are more precise, and tell which of the edges is covered. On the free side they may meet the edge's own
// faces, wrongly, and go on behind them.
template <class S>
struct CloserRay {
    int32_t element;
    Vec3<S> at, d;
    S distance, length, reach;
    bool free;  // on this side of the edge

    static constexpr int Rounds = 4;        // so often it may go on
    static constexpr S Closer = S(0x1p-5);  // times as far beside an edge as other rays
    TR_HD S before() const { return std::min(16 * reach, distance); }
    TR_HD OutlineRay<S> begin() const {
        OutlineRay<S> ray{at - d * before(), d};
        ray.met_from = ray.o;
        return ray;
    }
    // How far it goes on, for one that has come so far.
    TR_HD S left(const OutlineRay<S> &ray) const {
        return length - distance + before() - dot(ray.met_from - ray.o, ray.d);
    }
    // The one that has met something, from where the others begin.
    TR_HD OutlineRay<S> whole(OutlineRay<S> ray) const {
        ray.o = ray.o - ray.d * (distance - before());
        ray.t = ray.distance(), ray.met_from = ray.o;
        return ray;
    }
    TR_HD static void go_on(OutlineRay<S> &ray) {
        S length = 0;
        pass_behind(ray.met_from, ray.d, ray.t, length);
        ray.at.shape = NoHit, ray.t = S(INFINITY);
    }
};

template <class S>
class OutlineSamples {
public:
    using V = Vec3<S>;
    const SceneView<S> &scene;
    const PathConfig &config;
    const BoundaryView<S> &view;
    const Outlines<S> outlines;

    // `config`: that of paths, whose sampler does not matter to them.
    TR_HD OutlineSamples(const SceneView<S> &scene, const PathConfig &config, const BoundaryView<S> &view)
        : scene(scene), config(config), view(view), outlines(scene, view.outlines) {}

    // -------------------------------------------------------------------------------------------------------- numbers
    // Random numbers of a sample that paths do not use: two for choices (0, 1), and a seed.
    static constexpr uint32_t OutlineBlock = 0x60000000u, PlaceBlock = OutlineBlock + 1;
    TR_HD RandomBits4<S> bits(const OutlineSample &sample, uint32_t block = OutlineBlock) const {
        return random_bits4<S>(config.seed, config.sensor, sample.low, sample.high, UIntOf<S>(block));
    }
    TR_HD S number(const OutlineSample &sample, int which) const { return uniform_of<S>(bits(sample).bits[which]); }
    TR_HD uint64_t tree_seed(const OutlineSample &sample) const {
        const RandomBits4<S> r = bits(sample);
        return uint64_t(r.bits[2]) << 32 | r.bits[3];
    }
    // The cell that its path begins in: where that is.
    TR_HD const int64_t *cell(const OutlineSample &sample) const {
        const double each = double(view.n_cells) / view.samples;  // cells that a sample stands for
        const double u = double(uniform_of<S>(bits(sample, PlaceBlock).bits[1]));
        const double at = (double(sample.number() % uint64_t(view.samples)) + u) * each;
        return view.cells + 2 * std::min(size_t(at), size_t(view.n_cells) - 1);
    }

    // ----------------------------------------------------------------------------------------------------- the camera
    TR_HD const Record &sensor() const { return scene.sensors[config.sensor]; }
    TR_HD bool is_distant() const { return sensor().kind == kind_of_model<Distant>(Sensors{}); }
    // Where on the lens it looks through; of `distant` the place decides.
    TR_HD CameraSample<S> lens_of(const OutlineSample &sample) const {
        CameraSample<S> r{S(0), S(0)};
        if (is_distant()) return {S(0), S(0), S(0), S(0)};
        if (uses_lens(sensor())) r.choose_lens(lens_numbers<S>(config, sample.low, sample.high));
        return r;
    }
    // Area perpendicular to a camera ray along d, at that distance from where it comes from, of what a pixel sees.
    TR_HD S pixel_area(const CameraSample<S> &place, const V &d, S distance) const {
        if (is_pinhole(sensor())) {
            const Perspective::FilmPoint<S, S> film(scene, sensor(), place.x, place.y, view.width, view.height);
            const S cosine = rsqrt(squared_norm(film.direction()));
            return distance * distance * cosine * cosine * cosine * 4 * film.slope * film.rise /
                   (view.width * view.height);
        }
        if (is_distant()) {
            const S radius = DistantBase<S>(scene, sensor()).radius;
            return S(Pi) * radius * radius;
        }
        const S step = S(0.05);
        auto end = [&](S x, S y) {
            CameraSample<S> moved = place;
            moved.x += x, moved.y += y;
            const CameraRay<S> ray = camera_ray<S>(scene, sensor(), moved, view.width, view.height);
            return ray.center + ray.ray.d * distance;
        };
        const V x = (end(step, 0) - end(-step, 0)) * (1 / (2 * step)),
                y = (end(0, step) - end(0, -step)) * (1 / (2 * step));
        return std::fabs(dot(cross(x, y), d));
    }
    // Whether a pixel that is wanted may get something of a place that the camera sees p at, which it is if true.
    // (Beyond the part of the film that has samples nothing is seen.)
    TR_HD bool sees(const V &p, CameraSample<S> &place) const {
        if (!film_place<S>(scene, sensor(), p, view.width, view.height, place)) return false;
        if (!is_finite(place.x) || !is_finite(place.y)) return false;
        const S reach = S(view.reach);
        const Rect &there = view.sampled, &crop = view.crop;
        if (!(place.x >= S(there.x0) && place.x < S(there.x1) && place.y >= S(there.y0) && place.y < S(there.y1)))
            return false;
        return place.x >= S(crop.x0) - reach && place.x < S(crop.x1) + reach && place.y >= S(crop.y0) - reach &&
               place.y < S(crop.y1) + reach;
    }
    TR_HD CameraRay<S> ray_of(const CameraSample<S> &place) const {
        return camera_ray<S>(scene, sensor(), place, view.width, view.height);
    }

    // ----------------------------------------------------------------------------------------------------------- rays
    TR_HD static S length(const V &v) { return std::sqrt(dot(v, v)); }
    TR_HD static V unit(const V &v) { return v * (1 / std::max(length(v), S(1e-30))); }
    TR_HD static bool is_finite(S x) { return x - x == 0; }
    TR_HD static Vec3<float> single(const V &v) { return {float(v.x), float(v.y), float(v.z)}; }

    // From a point (of a surface with this normal) past b, beside it on the side of the unit vector `across`.
    TR_HD static OutlineRay<S> beside(const V &origin, const V &ng, const V &b, const V &across, S room, S reach,
                                      S rim) {
        const V at = b + across * (side_of(length(b - origin), b, room, reach) + rim),
                o = offset_origin(origin, ng, unit(at - origin));
        return {o, unit(at - o)};
    }
    TR_HD static S side_of(S distance, const V &b, S room, S reach) {
        return std::max(std::min(distance * S(0x1p-17), room / 8), least_side(b, distance, reach));
    }
    // How far beside b rays can be told apart that begin at a distance, and pass triangles that reach so far: they are
    // traced in single precision, and Embree's robust test takes what is up to 12 * 2^-24 of a triangle's extent beside
    // it, as was measured.
    TR_HD static S least_side(const V &b, S distance, S reach) {
        return S(0x1p-24) * (8 * (max_abs(b) + distance) + 24 * reach);
    }
    // Nothing is before an outline's point, r away, on the free side (a sphere is met before its contour on the other);
    // beside creases rays have to meet the crease's own faces. t: what rays on the side of -n and of n meet.
    TR_HD static bool is_open(S front, S r, const S (&t)[2], S tolerance) {
        for (int side = 0; side < 2; ++side) {
            const bool free = side == 0 ? front >= 0 : front <= 0;
            if (free && t[side] < r * (1 - tolerance)) return false;
            if (front == 0 && !(std::fabs(t[side] - r) < S(5e-3) * r)) return false;
        }
        return true;
    }

    // The weight of outlines that rest, as what moves or rests sees them: they count to the latter where light of what
    // moves ends there.
    TR_HD static float still(bool moves) { return moves ? 1.f : 0.05f; }
    // The share of what a point gets from another, at a distance, that samples from lights find.
    TR_HD double apart(double distance) const {
        const double square = distance * distance;
        return square / (square + view.near * view.near);
    }

    // -------------------------------------------------------------------------------------------- folds, see CloserRay
    // Whether faces of an outline are narrow beside the distance `side` at which it is looked past.
    TR_HD bool is_folded(int32_t element, S front, S room, S side) const {
        return front != 0 && view.outlines.is_edge(size_t(element)) && room < 64 * side;
    }
    TR_HD bool is_face_of(int32_t edge, const SurfacePoint<S> &at) const {
        const OutlineTable &set = view.outlines;
        for (size_t i = 0; i < set.count(size_t(edge)); ++i) {
            const HalfEdge h = set.half(scene, size_t(edge), i);
            const uint32_t shape = set.shape_of(h);
            if (shape == at.shape && h.face - uint32_t(scene.shapes[shape].face_offset) == at.primitive) return true;
        }
        return false;
    }
    // On the side of -1 or 1, beside an edge's point b, for rays from o; across: from the side of -1 to that of 1.
    TR_HD static CloserRay<S> closer(S sign, int32_t element, const V &b, const V &across, const V &o, const V &d,
                                     S length, S reach, S front, S side) {
        return {element,      b + across * (side * sign * CloserRay<S>::Closer), d, dot(b - o, d), length, reach,
                front != sign};
    }
    // Whether it goes on behind what `ray` has met.
    TR_HD bool passes_own(const CloserRay<S> &x, const OutlineRay<S> &ray) const {
        return x.free && (std::fabs(ray.distance() - x.before()) < S(5e-4) * x.reach || is_face_of(x.element, ray.at));
    }
    // False if what hides is not this edge's but another one's; else the ray on the free side is replaced if it passes
    // what covers that edge. Of both sides: what was looked for, and what was found.
    TR_HD bool is_seen(const CloserRay<S> *wanted, const OutlineRay<S> *found, S front, S room, S side,
                       OutlineRay<S> *beside) const {
        const int hiding = front > 0 ? 1 : 0;
        const CloserRay<S> &x = wanted[hiding];
        const OutlineRay<S> &hides = found[hiding], &past = found[1 - hiding];
        if (room > S(1.25) * side * CloserRay<S>::Closer && hides.distance() < x.distance - S(2e-3) * x.reach &&
            !is_face_of(x.element, hides.at))
            return false;
        if (past.distance() < beside[1 - hiding].distance() * S(1 - 1e-5)) beside[1 - hiding] = past;
        return true;
    }
};

// What the density of vertices' samples counts beside that of lights' ones. Less where the outline is close to the
// surface: a vertex is seldom found there, and what it brings grows as one over the distance; a light finds such places
// as often as others. More where light grazes the surface, at this cosine, and the BSDF, of this density, is of a
// normal that does not: a light seldom finds such places, and what it brings is one over the cosine. `near`: what is
// close.
template <class T>
TR_INLINE T beside_lights(double near, const T &distance, const T &cosine, const T &pdf) {
    using S = ScalarOf<T>;
    const T shaded = min(T(S(Pi)) * pdf, T(S(1)));  // the cosine to the normal, where a BSDF is diffuse
    const T grazed = max(T(S(0.3)) * shaded / max(abs(cosine), T(S(1e-4))), T(S(1)));
    return distance / (distance + T(S(5 * near))) * grazed * grazed;
}

}  // namespace tr
