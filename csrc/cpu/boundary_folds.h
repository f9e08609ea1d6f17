// Where fine meshes fold a little, as seen from somewhere, edges that turn back and forth cross each other at small
// angles, and for a part of their lengths are closer to each other than rays beside them can tell (least_side): those
// beside each of them see what is behind all, whose light would count more than once, 0.7 % of the silhouette of a
// monkey of 62976 faces. Of edges whose faces are narrow there rays look closer: they begin not far before the edge,
// where they are more precise, and tell which of the edges is covered. On the free side they may meet the edge's own
// faces, wrongly, and go on behind them.
#pragma once

#include "boundary_tile.h"

namespace tr {

template <class F>
class BoundaryFolds : public BoundaryTile<F> {
    using Base = BoundaryTile<F>;

protected:
    using Base::boundary_, Base::scene_;
    using typename Base::OutlineRay, typename Base::S, typename Base::V;
    static constexpr S Closer = S(0x1p-5);  // times as far beside an edge

    // A point of an edge as a ray sees it that begins at a distance of it, has a length, and passes it at `at`.
    struct CloserRay {
        int32_t element;
        V at, d;
        S distance, length, reach;
        bool free;  // on this side of the edge
    };
    std::vector<CloserRay> wanted_;
    std::vector<OutlineRay> closer_;  // for each of them; their origins are at the distance

    using Base::BoundaryTile;

    // Whether faces of an outline are narrow beside the distance `side` at which it is looked past.
    bool is_folded(int32_t element, S front, S room, S side) const {
        return front != 0 && boundary_.outlines->is_edge(size_t(element)) && room < 64 * side;
    }
    bool is_face_of(int32_t edge, const SurfacePoint<S> &at) const {
        const OutlineSet &set = *boundary_.outlines;
        for (size_t i = 0; i < set.count(size_t(edge)); ++i) {
            const HalfEdge h = set.half(scene_, size_t(edge), i);
            const uint32_t shape = set.shape_of(h);
            if (shape == at.shape && h.face - uint32_t(scene_.shapes[shape].face_offset) == at.primitive) return true;
        }
        return false;
    }

    // Both, beside an edge's point b, for rays from o; across: from the side of -1 to that of 1.
    void want(int32_t element, const V &b, const V &across, const V &o, const V &d, S length, S reach, S front,
              S side) {
        for (S sign : {S(-1), S(1)})
            wanted_.push_back(
                {element, b + across * (side * sign * Closer), d, dot(b - o, d), length, reach, front != sign});
    }
    // Of those that are at `at` in the list: false if what hides is not this edge's but another one's; else the ray on
    // the free side is replaced if it passes what covers that edge.
    bool is_seen(size_t at, S front, S room, S side, OutlineRay (&beside)[2]) const {
        const size_t hiding = front > 0 ? 1 : 0;
        const CloserRay &x = wanted_[at + hiding];
        const OutlineRay &hides = closer_[at + hiding], &past = closer_[at + 1 - hiding];
        if (room > S(1.25) * side * Closer && distance(hides) < x.distance - S(2e-3) * x.reach &&
            !is_face_of(x.element, hides.at))
            return false;
        if (distance(past) < distance(beside[1 - hiding]) * S(1 - 1e-5)) beside[1 - hiding] = past;
        return true;
    }

    // Rays that are wanted go on behind shapes that passes(shape) is true of, too. (They are not among those that are
    // counted, which tell how deep paths are.)
    template <class Passes>
    void look_closer(Passes &&passes, bool coherent) {
        closer_.clear(), left_.clear();
        for (const CloserRay &x : wanted_) {
            left_.push_back(uint32_t(closer_.size()));
            closer_.push_back({x.at - x.d * before(x), x.d});
            closer_.back().met_from = closer_.back().o;
        }
        for (int round = 0; round < 4 && !left_.empty(); ++round) {
            PathQueue<S> &queue = this->light_.wavefront.queues[0];
            for (size_t j = 0; j < left_.size(); ++j) {
                const CloserRay &x = wanted_[left_[j]];
                const OutlineRay &ray = closer_[left_[j]];
                queue.o.set(j, ray.met_from), queue.d.set(j, ray.d);
                queue.length[j] = x.length - x.distance + before(x) - dot(ray.met_from - ray.o, ray.d);
            }
            this->queries().intersect(rays_of(queue), left_.size(), coherent);
            size_t kept = 0;
            for (size_t j = 0; j < left_.size(); ++j) {
                const CloserRay &x = wanted_[left_[j]];
                OutlineRay &ray = closer_[left_[j]];
                this->keep_hit(j, ray);
                if (ray.at.shape == NoHit || !goes_on(x, ray, passes)) continue;
                S length = 0;
                pass_behind(ray.met_from, ray.d, ray.t, length);
                ray.at.shape = NoHit, ray.t = S(INFINITY);
                left_[kept++] = left_[j];
            }
            left_.resize(kept);
        }
        for (size_t i = 0; i < closer_.size(); ++i) {
            OutlineRay &ray = closer_[i];
            ray.o = ray.o - ray.d * (wanted_[i].distance - before(wanted_[i]));
            ray.t = distance(ray), ray.met_from = ray.o;
        }
    }
    // From where a ray begins to what it has met.
    static S distance(const OutlineRay &ray) { return ray.t + dot(ray.met_from - ray.o, ray.d); }

private:
    std::vector<uint32_t> left_;  // of the list, those whose rays go on

    template <class Passes>
    bool goes_on(const CloserRay &x, const OutlineRay &ray, Passes &&passes) const {
        if (passes(ray.at.shape)) return true;
        return x.free && (std::fabs(distance(ray) - before(x)) < S(5e-4) * x.reach || is_face_of(x.element, ray.at));
    }
    static S before(const CloserRay &x) { return std::min(16 * x.reach, x.distance); }
};

}  // namespace tr
