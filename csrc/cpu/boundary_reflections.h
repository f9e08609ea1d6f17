// Outlines that points on surfaces see: where the light that they scatter ends to be visible, and begins.
//
// At a vertex S of a path, which has the throughput beta, light comes from everywhere; past an outline's point B there
// is one thing on the one side and another on the other. With the unit direction d to B, at the distance r,
//
//     dI = beta  integral of f(d) sin / r^2  (L_minus v_minus - L_plus v_plus)  dl
//
// where v = n.(dB - (1 - tau) dS - tau dE) for a point E that is glued to what emits, tau = r / |E - S|, and n.(dB -
// dS) for all else, which is looked up along a direction at rest: see docs/theory/motion.md. Of glued samples all E are
// glued to what they belong to, and S is, too.
#pragma once

#include "boundary_folds.h"

namespace tr {

template <class F>
class ReflectionTile : public BoundaryFolds<F> {
    using Base = BoundaryFolds<F>;
    using Base::anchors_, Base::boundary_, Base::call_, Base::light_, Base::outlines_, Base::paths_, Base::scene_;
    using typename Base::OutlineRay, typename Base::S, typename Base::U, typename Base::V;

    // An outline's point B that the vertex S of a slot sees, and what rays on the side of -n and of n meet.
    struct Sight {
        uint32_t slot, copy;
        int32_t element;
        S s, r;
        V from, b, n;
        S front, room, reach, rim, side;
        bool folded;  // see boundary_folds.h
        Spectrum<S> carried;
        S density;
        bool has_end[2];  // what is met there is glued to its surface
        S tau[2];
        SurfacePoint<S> end[2];
        V end_p[2];
        Spectrum<S> jump[2][4];  // on both sides, by part
        uint32_t rows;           // their number, of polarised light
    };
    static constexpr size_t Descents = OutlineTree::MostDescents;
    std::vector<Sight> sights_;
    size_t first_ = 0;  // of those that are looked for
    std::vector<OutlineRay> rays_;
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
        for (uint32_t copy = 0; choose_outlines(n, copy); ++copy) {
            this->scatter_chosen();
            weigh();
        }
        look_past();
        look_up(stop);
    }

    // How many outlines each vertex looks past: in proportion to what its path carries and, where it slides over its
    // surface, to how fast, as one over the cosine with which it is seen. (Of a silhouette's neighbourhood the variance
    // of equal numbers would have no bound.)
    void share_out(uint32_t n) {
        double sum = 0, count = 0;
        for (uint32_t k = 0; k < n; ++k) {
            if (anchors_.level[k] == NoVertex) total_[k] = 0;
            if (!(total_[k] > 0)) continue;
            const V seen = this->level_of(k).columns.arrival.segment.get(anchors_.entry[k]);
            const double cosine = std::fabs(double(dot(anchors_.ng.get(k), this->unit(seen))));
            if (!boundary_.glued && this->vertex_moves(k)) total_[k] /= std::max(cosine, 0.05);
            sum += total_[k], ++count;
        }
        copies_.assign(n, 0);
        if (!(count > 0) || !std::isfinite(sum)) return;
        const double most = 8 * sum / count, number = std::min(double(n), 2 * count);
        sum = 0;
        for (uint32_t k = 0; k < n; ++k) sum += std::min(total_[k], most);
        const double u = double(uniform_of<S>(this->bits(0, Base::PlaceBlock).bits[0]));
        double upto = 0;
        for (uint32_t k = 0; k < n; ++k) {
            const double mean = number * std::min(total_[k], most) / sum, from = std::floor(upto + u);
            upto += mean;
            copies_[k] = uint32_t(std::floor(upto + u) - from);
            if (mean > 0) inverse_[k] /= mean;
        }
    }

    // All outlines of a vertex are chosen at once.
    void choose(uint32_t n) {
        choices_.clear(), begins_.resize(n);
        const OutlineTree &tree = boundary_.outlines->tree();
        for (uint32_t k = 0; k < n; ++k) {
            begins_[k] = choices_.size();
            if (copies_[k] == 0) continue;
            choices_.resize(begins_[k] + copies_[k]);
            tree.choose(this->anchor(k), this->tree_seed(k), Descents, &choices_[begins_[k]], copies_[k]);
        }
    }

    // For vertices that look past more than `copy` outlines; false if there is none.
    bool choose_outlines(uint32_t n, uint32_t copy) {
        bool some = false;
        first_ = sights_.size();
        for (uint32_t k = 0; k < n; ++k) {
            anchors_.d.set(k, {S(0), S(0), S(1)});
            if (copies_[k] <= copy) continue;
            some = true;
            Sight x{};
            x.slot = k, x.copy = copy, x.from = this->place_of(k);
            const OutlineChoice chosen = choices_[begins_[k] + copy];
            if (chosen.element < 0 || is_own_face(k, chosen.element)) continue;
            const OutlinePoint<S> point = outlines_.point(chosen.element, S(chosen.s), x.from, false);
            const V towards = point.p - x.from;
            x.r = this->length(towards);
            const S stretch = this->length(point.along);
            const V d = towards * (1 / std::max(x.r, S(1e-30))), across = cross(d, point.along);
            const S turned = this->length(across);
            if (!point.valid || !(stretch > 0) || !(turned > 0) || !(x.r > 0)) continue;
            x.element = chosen.element, x.s = S(chosen.s), x.b = point.p, x.n = across * (1 / turned);
            x.front = point.front, x.room = point.room, x.reach = point.reach, x.rim = S(BeyondRim) * point.rim;
            x.side = Base::side_of(x.r, x.b, x.room, x.reach);
            x.folded = this->is_folded(x.element, x.front, x.room, x.side);
            // sin / r^2 over the density by length
            x.carried = uniform_spectrum(S(turned / (x.r * x.r) * S(chosen.inverse_density) * S(inverse_[k]) *
                                           S(double(boundary_.n_cells) / boundary_.total)));
            anchors_.d.set(k, d);
            sights_.push_back(x);
        }
        return some;
    }

    // Whether it is an edge of the face that the vertex is on: nothing comes from along a face, whichever side of the
    // edge rounding takes for the free one. (Of light that interpolated normals still see there, see motion.md.)
    bool is_own_face(uint32_t slot, int32_t element) {
        return boundary_.outlines->is_edge(size_t(element)) && this->is_face_of(element, this->point_of(slot));
    }

    // What the last sights bring, by light of one; those that bring nothing are left out.
    void weigh() {
        size_t kept = first_;
        for (size_t k = first_; k < sights_.size(); ++k) {
            Sight &x = sights_[k];
            const TapeLevel<S> &level = this->level_of(x.slot);
            const uint32_t e = anchors_.entry[x.slot];
            const S geometry = x.carried[0];
            bool some = false, finite = true;
            for (int c = 0; c < SpectrumSize; ++c) {
                x.carried[c] = x.carried[c] * level.columns.vertex.beta[c][e] * anchors_.f[c][x.slot];
                some |= x.carried[c] != 0, finite &= bool(std::isfinite(x.carried[c]));
            }
            if (!some || !finite || (boundary_.glued && x.front == 0)) continue;
            if (this->polarized()) {
                x.rows = uint32_t(rows_.size());
                rows_.push_back(this->rows_towards(x.slot));
                for (Stokes<S> &row : rows_.back())
                    for (Spectrum<S> &part : row.at) part = part * geometry;
            }
            // what lights find, too: what a smooth vertex, or the camera, sees, and not too close to it
            const S pdf =
                anchors_.pdf[x.slot] *
                this->beside_lights(x.r, dot(anchors_.ng.get(x.slot), anchors_.d.get(x.slot)), anchors_.pdf[x.slot]);
            if (anchors_.level[x.slot] == 0)
                x.density = pdf / S(boundary_.in_view);
            else
                x.density =
                    smooth_before(x.slot) && double(this->number(x.slot, 1)) < this->apart(sight(x.slot)) ? pdf : S(0);
            sights_[kept++] = x;
        }
        sights_.resize(kept);
    }
    // Whether a smooth BSDF's sample has found this vertex, and from how far.
    bool smooth_before(uint32_t slot) {
        const TapeLevel<S> &level = this->level_of(slot),
                           &before = paths_.wavefront.tape[int(anchors_.level[slot]) - 1];
        const uint32_t parent = level.columns.vertex.parent[anchors_.entry[slot]];
        for (const KindRange &range : before.ranges)
            if (parent >= range.begin && parent < range.begin + range.count)
                return bsdf_kernels<F>(range.kind).is(HasSmoothLobes) && before.columns.outgoing.lobe[parent] == 0;
        return false;
    }
    double sight(uint32_t slot) {
        return double(this->length(this->level_of(slot).columns.arrival.segment.get(anchors_.entry[slot])));
    }

    // Rays beside the outlines, and where nothing hides these what is behind.
    void look_past() {
        rays_.clear();
        for (const Sight &x : sights_)
            for (S side : {S(-1), S(1)})
                rays_.push_back(this->beside(x.from, anchors_.ng.get(x.slot), x.b, x.n * side, x.room, x.reach,
                                             x.front == side ? x.rim : S(0)));
        this->intersect(rays_);
        this->wanted_.clear();
        for (uint32_t k = 0; k < sights_.size(); ++k) {
            const Sight &x = sights_[k];
            const V &o = rays_[2 * k].o;
            if (x.folded)
                this->want(x.element, x.b, x.n, o, Base::unit(x.b - o), S(INFINITY), x.reach, x.front, x.side);
        }
        this->look_closer([](uint32_t) { return false; }, false);
        size_t kept = 0;
        for (size_t k = 0, i = 0; k < sights_.size(); ++k) {
            Sight &x = sights_[k];
            OutlineRay beside[2] = {rays_[2 * k], rays_[2 * k + 1]};
            if (x.folded && !this->is_seen(2 * i++, x.front, x.room, x.side, beside)) continue;
            const S t[2] = {beside[0].t, beside[1].t};
            if (!this->is_open(x.front, x.r, t, S(1e-3))) continue;
            for (size_t h = 0; h < 2; ++h) {
                const OutlineRay &ray = beside[h];
                x.has_end[h] = ray.at.shape != NoHit && (boundary_.glued || scene_.shapes[ray.at.shape].emitter >= 0);
                if (x.has_end[h]) {
                    x.end[h] = ray.at, x.end_p[h] = ray.o + ray.d * t[h];
                    x.tau[h] = x.r / this->length(x.end_p[h] - x.from);
                }
                rays_[2 * kept + h] = ray;
            }
            sights_[kept++] = x;
        }
        sights_.resize(kept), rays_.resize(2 * kept);
    }

    // What is seen on both sides, vertices of one depth at a time.
    void look_up(const Stop &stop) {
        std::vector<OutlineRay> rays;
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
                    const S sign = h == 0 ? S(1) : S(-1);
                    // what hides something, or is a crease, moves with its own outline
                    const bool counts = !(x.has_end[h] || boundary_.glued) || x.front * sign == S(1);
                    const size_t k = 2 * j + h;
                    if (this->polarized()) {
                        polarized_jump(x, h, rays[k], k, counts ? sign : S(0));
                        continue;
                    }
                    for (int c = 0; c < SpectrumSize; ++c) {
                        const S light = light_.slots.radiance[c][k];
                        x.jump[h][0][c] = counts && std::isfinite(light) ? x.carried[c] * light * sign : S(0);
                    }
                    x.jump[h][0] = this->to_channels(x.slot, x.jump[h][0]);
                }
            }
        }
    }

    // Of light that has been looked up, in entry k.
    void polarized_jump(Sight &x, size_t h, const OutlineRay &ray, size_t k, S sign) const {
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
            this->add_glued(k, this->point_of(k), this->place_of(k), p_bar);
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
            V b_bar = zero, s_bar = zero;
            for (size_t h = 0; h < 2; ++h) {
                const S w = weight(x, h);
                if (w == 0 || !std::isfinite(w)) continue;
                const V g = x.n * w;
                b_bar = b_bar + g;
                s_bar = s_bar - g * (x.has_end[h] ? 1 - x.tau[h] : S(1));
                if (x.has_end[h]) this->add_glued(x.slot, x.end[h], x.end_p[h], g * -x.tau[h]);
            }
            anchors_.p_bar.set(x.slot, anchors_.p_bar.get(x.slot) + s_bar);
            points.derivative = 0;
            this->add_to_outline(x.slot, x.element, x.s, x.b, b_bar, points);
            if (sink.forward) slots.radiance[sink.component][x.slot] += points.derivative;
        }
        if (boundary_.glued) glue_vertices(n);
        this->sweep_glued(sink, slots);
        if (!boundary_.glued) this->sweep_paths(sink, slots);
    }
};

}  // namespace tr
