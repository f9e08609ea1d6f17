// Rays that look closer at edges of narrow faces, see CloserRay, many at once.
#pragma once

#include "boundary_tile.h"

namespace tr {

template <class F>
class BoundaryFolds : public BoundaryTile<F> {
    using Base = BoundaryTile<F>;

protected:
    using Base::samples_;
    using typename Base::Ray, typename Base::S, typename Base::V;
    std::vector<CloserRay<S>> wanted_;
    std::vector<Ray> closer_;  // for each of them

    using Base::Base;

    // Room for two more that are wanted.
    CloserRay<S> *want_both() {
        wanted_.resize(wanted_.size() + 2);
        return &wanted_[wanted_.size() - 2];
    }

    // Rays that are wanted go on behind shapes that passes(shape) is true of, too. (They are not among those that are
    // counted, which tell how deep paths are.)
    template <class Passes>
    void look_closer(Passes &&passes, bool coherent) {
        closer_.clear(), left_.clear();
        for (const CloserRay<S> &x : wanted_) left_.push_back(uint32_t(closer_.size())), closer_.push_back(x.begin());
        for (int round = 0; round < CloserRay<S>::Rounds && !left_.empty(); ++round) {
            PathQueue<S> &queue = this->light_.wavefront.queues[0];
            for (size_t j = 0; j < left_.size(); ++j) {
                const Ray &ray = closer_[left_[j]];
                queue.o.set(j, ray.met_from), queue.d.set(j, ray.d);
                queue.length[j] = wanted_[left_[j]].left(ray);
            }
            this->queries().intersect(rays_of(queue), left_.size(), coherent);
            size_t kept = 0;
            for (size_t j = 0; j < left_.size(); ++j) {
                Ray &ray = closer_[left_[j]];
                this->keep_hit(j, ray);
                if (ray.at.shape == NoHit) continue;
                if (!passes(ray.at.shape) && !samples_.passes_own(wanted_[left_[j]], ray)) continue;
                CloserRay<S>::go_on(ray);
                left_[kept++] = left_[j];
            }
            left_.resize(kept);
        }
        for (size_t i = 0; i < closer_.size(); ++i) closer_[i] = wanted_[i].whole(closer_[i]);
    }

private:
    std::vector<uint32_t> left_;  // of the list, those whose rays go on
};

}  // namespace tr
