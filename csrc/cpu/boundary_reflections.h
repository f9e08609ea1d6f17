// Samples of outlines that vertices of paths see, see core/boundary/vertex_sights.h.
#pragma once

#include "boundary_folds.h"
#include "core/boundary/outline_choice.h"
#include "core/boundary/vertex_sights.h"

namespace tr {

template <class F>
class ReflectionTile : public BoundaryFolds<F> {
    using Base = BoundaryFolds<F>;
    using Base::anchors_, Base::boundary_, Base::call_, Base::light_, Base::path_call_, Base::paths_, Base::scene_,
        Base::towards_, Base::view_;
    using typename Base::Ray, typename Base::S, typename Base::U, typename Base::V;

    struct Sight : VertexSight<S> {
        Spectrum<S> jump[2][4];  // on both sides, by part
        uint32_t rows;           // their number, of polarised light
    };
    const VertexSamples<S> samples_{scene_, path_call_.config, view_};
    std::vector<Sight> sights_;
    size_t first_ = 0;  // of those that are looked for
    std::vector<Ray> rays_;
    std::vector<double> u_, inverse_, total_;
    std::vector<uint32_t> copies_;
    std::vector<size_t> begins_;          // by slot, of its
    std::vector<OutlineChoice> choices_;  // one a copy
    std::vector<StokesRows<S>> rows_;     // for what arrives past an outline

public:
    using Base::Base;

    // Samples `first` .. `first` + n of the call.
    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, const Stop &stop) {
        trace(first, n, stop);
        if (boundary_.weighs)
            return this->tell_weights(first, sights_, [](const Sight &x, int part, int c) {
                return double(x.jump[0][part][c]) + double(x.jump[1][part][c]);
            });
        const auto &slots = paths_.slots;
        if (!sink.forward)
            return add(slots, sink, [&](const Sight &x, size_t h) {
                return this->contracted(slots.film_x[x.slot], slots.film_y[x.slot],
                                        [&](int part) { return x.jump[h][part]; });
            });
        this->for_parts(n, slots, sink, [&](int part, int c, const SlotColumns<S> &to) {
            add(to, sink, [&](const Sight &x, size_t h) { return x.jump[h][part][c]; });
        });
        for (uint32_t k = 0; k < n; ++k) this->write_value(first + k, slots, k);
    }

private:
    void trace(uint64_t first, uint32_t n, const Stop &stop) {
        this->identify(first, n);
        this->trace_paths(n, stop);
        u_.resize(n), inverse_.resize(n);
        for (uint32_t k = 0; k < n; ++k) u_[k] = double(this->number(k, 0));
        this->choose_vertices(n, u_, inverse_, total_, [](const V &, uint32_t) { return 1.0; });
        this->find_lobes();
        this->find_normals();
        this->find_rows(n);
        share_out(n);
        choose(n);
        sights_.clear(), rows_.clear();
        for (uint32_t copy = 0; find_sights(n, copy); ++copy) {
            this->scatter_chosen();
            weigh();
        }
        look_past();
        look_up(stop);
    }

    // How many outlines each vertex looks past, see share_out.
    void share_out(uint32_t n) {
        for (uint32_t k = 0; k < n; ++k) {
            if (anchors_.level[k] == NoVertex) total_[k] = 0;
            if (!(total_[k] > 0)) continue;
            const V seen = this->level_of(k).columns.arrival.segment.get(anchors_.entry[k]);
            total_[k] = samples_.sliding(total_[k], this->vertex(k).moves(boundary_.moves), seen, anchors_.ng.get(k));
        }
        copies_.resize(n);
        const double u = double(uniform_of<S>(this->bits(0, samples_.PlaceBlock).bits[0]));
        tr::share_out(total_.data(), n, u, inverse_.data(), copies_.data());
    }

    // All outlines of a vertex are chosen at once.
    void choose(uint32_t n) {
        choices_.clear(), begins_.resize(n);
        for (uint32_t k = 0; k < n; ++k) {
            begins_[k] = choices_.size();
            if (copies_[k] == 0) continue;
            choices_.resize(begins_[k] + copies_[k]);
            const OutlineAnchor from =
                this->vertex(k).anchor(anchors_, k, samples_.still(this->vertex(k).moves(boundary_.moves)));
            choose_outlines(view_.outlines.tree, from, samples_.tree_seed(this->sample_of(k)), MostOutlineDescents,
                            &choices_[begins_[k]], copies_[k]);
        }
    }

    // For vertices that look past more than `copy` outlines; false if there is none.
    bool find_sights(uint32_t n, uint32_t copy) {
        bool some = false;
        first_ = sights_.size();
        for (uint32_t k = 0; k < n; ++k) {
            towards_.d.set(k, {S(0), S(0), S(1)});
            if (copies_[k] <= copy) continue;
            some = true;
            Sight x{};
            x.slot = k, x.copy = copy, x.from = this->vertex(k).place();
            V d;
            if (!samples_.find(choices_[begins_[k] + copy], this->vertex(k).point(), S(inverse_[k]), x, d)) continue;
            towards_.d.set(k, d);
            sights_.push_back(x);
        }
        return some;
    }

    // What the last sights bring, by light of one; those that bring nothing are left out.
    void weigh() {
        size_t kept = first_;
        for (size_t k = first_; k < sights_.size(); ++k) {
            Sight &x = sights_[k];
            const TapeLevel<S> &level = this->level_of(x.slot);
            const uint32_t e = anchors_.entry[x.slot];
            const S geometry = x.carried[0];
            Spectrum<S> f, beta;
            for (int c = 0; c < SpectrumSize; ++c)
                f[c] = towards_.f[c][x.slot], beta[c] = level.columns.vertex.beta[c][e];
            if (!samples_.weigh(x, f, beta)) continue;
            if (this->polarized()) {
                x.rows = uint32_t(rows_.size());
                rows_.push_back(this->rows_towards(x.slot));
                for (Stokes<S> &row : rows_.back())
                    for (Spectrum<S> &part : row.at) part = part * geometry;
            }
            x.density = samples_.density(x, this->sample_of(x.slot), towards_.pdf[x.slot], anchors_.ng.get(x.slot),
                                         towards_.d.get(x.slot), anchors_.level[x.slot] == 0,
                                         [&] { return seen_from(x.slot); });
            sights_[kept++] = x;
        }
        sights_.resize(kept);
    }
    // From how far a smooth BSDF's sample has found this vertex; below zero if another one has.
    double seen_from(uint32_t slot) {
        const TapeLevel<S> &level = this->level_of(slot),
                           &before = paths_.wavefront.tape[int(anchors_.level[slot]) - 1];
        const uint32_t parent = level.columns.vertex.parent[anchors_.entry[slot]];
        for (const KindRange &range : before.ranges) {
            if (parent < range.begin || parent >= range.begin + range.count) continue;
            if (!bsdf_kernels<F>(range.kind).is(HasSmoothLobes) || before.columns.outgoing.lobe[parent] != 0) return -1;
            return double(samples_.length(level.columns.arrival.segment.get(anchors_.entry[slot])));
        }
        return -1;
    }

    // Rays beside the outlines, and where nothing hides these what is behind.
    void look_past() {
        rays_.clear();
        for (const Sight &x : sights_)
            for (S side : {S(-1), S(1)}) rays_.push_back(samples_.ray_beside(x, anchors_.ng.get(x.slot), side));
        this->intersect(rays_);
        this->wanted_.clear();
        for (uint32_t k = 0; k < sights_.size(); ++k) {
            if (sights_[k].folded) samples_.look_closer(sights_[k], rays_[2 * k].o, this->want_both());
        }
        this->look_closer([](uint32_t) { return false; }, false);
        size_t kept = 0;
        for (size_t k = 0, i = 0; k < sights_.size(); ++k) {
            Sight &x = sights_[k];
            Ray beside[2] = {rays_[2 * k], rays_[2 * k + 1]};
            const size_t at = x.folded ? 2 * i++ : 0;
            if (!samples_.is_open(x, beside, this->wanted_.data() + at, this->closer_.data() + at)) continue;
            for (size_t h = 0; h < 2; ++h) rays_[2 * kept + h] = beside[h];
            sights_[kept++] = x;
        }
        sights_.resize(kept), rays_.resize(2 * kept);
    }

    // What is seen on both sides, vertices of one depth at a time.
    void look_up(const Stop &stop) {
        std::vector<Ray> rays;
        std::vector<S> pdf, length;
        std::vector<uint32_t> key, which, seen;
        for (uint32_t level = 0, left = uint32_t(sights_.size()); left > 0 && !stop(); ++level) {
            rays.clear(), pdf.clear(), key.clear(), which.clear(), seen.clear();
            for (uint32_t k = 0; k < sights_.size(); ++k) {
                const Sight &x = sights_[k];
                if (anchors_.level[x.slot] != level) continue;
                which.push_back(k);
                for (size_t h = 0; h < 2; ++h) {
                    rays.push_back(rays_[2 * k + h]);
                    pdf.push_back(x.density), key.push_back(paths_.slots.pixel[x.slot] ^ x.copy << CopyBit);
                    seen.push_back(this->is_single(x.slot) ? SingleWave : 0u);
                }
            }
            left -= uint32_t(which.size());
            if (which.empty()) continue;
            length.assign(rays.size(), S(INFINITY));
            Base::look_up(rays, length, pdf, key, seen, int(level) + 1, true, stop);
            for (size_t j = 0; j < which.size(); ++j) {
                Sight &x = sights_[which[j]];
                for (size_t h = 0; h < 2; ++h) {
                    const S sign = samples_.sign_of(x, int(h));
                    const size_t k = 2 * j + h;
                    if (this->polarized()) {
                        polarized_jump(x, h, rays[k], k, sign);
                        continue;
                    }
                    for (int c = 0; c < SpectrumSize; ++c) {
                        const S light = light_.slots.radiance[c][k];
                        x.jump[h][0][c] = sign != 0 && std::isfinite(light) ? x.carried[c] * light * sign : S(0);
                    }
                    x.jump[h][0] = this->to_channels(x.slot, x.jump[h][0]);
                }
            }
        }
    }

    // Of light that has been looked up, in entry k.
    void polarized_jump(Sight &x, size_t h, const Ray &ray, size_t k, S sign) const {
        const auto &slots = light_.slots;
        const SpectrumColumn<S> columns[] = {slots.radiance, slots.q, slots.u, slots.v};
        Stokes<S> light{{}, this->axis_on_film(-ray.d)};
        bool finite = true;
        for (int i = 0; i < 4; ++i)
            for (int c = 0; c < SpectrumSize; ++c) {
                light.at[i][c] = columns[i][c][k];
                finite &= bool(std::isfinite(light.at[i][c]));
            }
        Base::contract_rows(rows_[x.rows], light, -ray.d, x.jump[h]);
        for (Spectrum<S> &jump : x.jump[h])
            jump = finite ? this->to_channels(x.slot, jump) * sign : uniform_spectrum(S(0));
    }

    // The adjoints of vertices to their surfaces.
    void glue_vertices(uint32_t n) {
        for (uint32_t k = 0; k < n; ++k) {
            const V p_bar = anchors_.p_bar.get(k);
            if (!(max_abs(p_bar) > 0)) continue;
            this->add_glued(k, this->vertex(k).point(), this->vertex(k).place(), p_bar);
        }
    }

    // Hands the adjoints of all rates on, each with weight(sight, side); derivatives go to `slots`.
    template <class Weight>
    void add(const SlotColumns<S> &slots, GradientSink<F> &sink, Weight &&weight) {
        const uint32_t n = uint32_t(u_.size());
        const V zero{S(0), S(0), S(0)};
        for (uint32_t k = 0; k < n; ++k) anchors_.p_bar.set(k, zero);
        PointSink<F> points{sink};
        for (const Sight &x : sights_) {
            const S weights[2] = {weight(x, 0), weight(x, 1)};
            points.derivative = 0;
            const V s_bar = samples_.add(x, weights, points, this->glue_to(x.slot));
            anchors_.p_bar.set(x.slot, anchors_.p_bar.get(x.slot) + s_bar);
            if (sink.forward) slots.radiance[sink.component][x.slot] += points.derivative;
        }
        if (boundary_.glued) glue_vertices(n);
        this->sweep_glued(sink, slots);
        if (!boundary_.glued) this->sweep_paths(sink, slots);
    }
};

}  // namespace tr
