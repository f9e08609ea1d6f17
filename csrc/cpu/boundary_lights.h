// Samples of outlines that lights see, the edges of shadows: see core/boundary/shadows.h.
#pragma once

#include "boundary_folds.h"
#include "core/boundary/shadows.h"

namespace tr {

template <class F>
class ShadowTile : public BoundaryFolds<F> {
    using Base = BoundaryFolds<F>;
    using Base::anchors_, Base::boundary_, Base::call_, Base::light_, Base::path_call_, Base::paths_, Base::scene_,
        Base::towards_, Base::view_, Base::W;
    using typename Base::M, typename Base::Ray, typename Base::S, typename Base::U, typename Base::V;
    using Edge = ShadowEdge<S>;

    // What the camera, or a vertex of the path, gets of an edge.
    struct Connection {
        uint32_t edge, slot;
        Spectrum<S> jump[4];  // by part
    };
    std::vector<Edge> edges_;
    std::vector<Connection> connections_;
    std::vector<Ray> rays_;
    std::vector<double> u_, inverse_, total_;
    const bool pilot_;
    PathTile<F> ends_;
    const LightTable table_;
    const LightList list_{table_.lights.data(), table_.cdf.data(), int32_t(table_.lights.size())};
    const ShadowLights<F> lights_{scene_, list_};
    std::vector<OutlinePiecesView> pieces_;  // by emitter
    const ShadowSamples<S> samples_;
    ShadowEdgeColumns<S> at_;
    std::vector<V> carried_;            // of connections to vertices
    std::vector<S> numbers_, chooses_;  // by slot, for a piece, and for what the light chooses
    const SamplerConfig sequence_ = make_sampler(SamplerKind::Sobol, 0, LargestPattern);

public:
    ShadowTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : Base(call, boundary, derivative),
          pilot_(boundary.part == BoundaryPart::Pilot),
          ends_(path_call_, Base::Capacity, &derivative),
          table_(shadow_lights<F>(scene_, pilot_)),
          pieces_(pieces_of(boundary)),
          samples_(scene_, path_call_.config, view_,
                   {pieces_.data(), int32_t(pieces_.size()),
                    boundary.part == BoundaryPart::Pieces ? boundary.emitter : -1}) {
        arena_.allocate(Base::Capacity + 2 * W, at_);
        this->keep_lens(ends_.slots);
    }

    RenderStats take_stats() {
        RenderStats stats = Base::take_stats();
        stats.add(ends_.take_stats());
        return stats;
    }

    // Samples `first` .. `first` + n of the call. In forward mode each has two places on the film: where the camera
    // sees S, and its path's own.
    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, const Stop &stop) {
        if (list_.n == 0) return;
        const int depth = call_.config.max_depth;
        const bool pieces = boundary_.part == BoundaryPart::Pieces,
                   deep = !pilot_ && !pieces && (depth < 0 || depth > 2);
        this->identify(first, n);
        if (deep) this->trace_paths(n, stop);
        find_places(first, n);
        find_edges(n);
        see_from_camera(n);
        if (pilot_) return tell(first, n);
        if (pieces) return tell_pieces(first);
        settle(first, n, 0, ends_.slots, sink, true);
        if (!deep || edges_.empty()) return;
        share_edges(n);
        u_.resize(n), inverse_.resize(n);
        for (uint32_t k = 0; k < n; ++k) u_[k] = double(this->number(k, 0));
        // those that are close to S get more of it
        this->choose_vertices(n, u_, inverse_, total_, [&](const V &p, uint32_t k) {
            const V apart = at_.s.get(k) - p;
            return 1 / (double(dot(apart, apart)) + boundary_.near * boundary_.near);
        });
        this->find_normals();
        see_from_vertices(n);
        settle(first, n, 1, paths_.slots, sink, false);
    }

private:
    Arena arena_;

    // ------------------------------------------------------------------------------------- from the light to a surface
    Random4<F> spread(uint64_t sample) const { return samples_.template spread<F>(sequence_, sample); }
    static std::vector<OutlinePiecesView> pieces_of(const BoundaryCall<S> &boundary) {
        std::vector<OutlinePiecesView> r;
        r.reserve(boundary.shadows->of.size());
        for (const OutlinePieces &pieces : boundary.shadows->of) r.push_back(pieces.view());
        return r;
    }

    void find_places(uint64_t first, uint32_t n) {
        numbers_.resize(n + W), chooses_.resize(n + W);
        for (uint32_t i = 0; i < n; i += W) {
            const Random4<F> u = spread(boundary_.first + first + i);
            store(&numbers_[i], u.u[0]), store(&chooses_[i], u.u[3]);
        }
        for (uint32_t k = 0; k < n; ++k) {
            lights_.choose(at_, k, double(numbers_[k]));
            numbers_[k] = at_.left[k];
            at_.left[k] = chooses_[k];
            if (boundary_.part != BoundaryPart::Pieces) continue;
            at_.emitter[k] = boundary_.emitter, at_.inverse_pmf[k] = S(1);
        }
        for (uint32_t i = 0; i < n; i += W) {
            Entries<F> from(i);
            const Random4<F> place = spread(boundary_.first + first + i),
                             more = random4<F>(call_.config.seed, call_.config.sensor, from(paths_.slots.pixel),
                                               from(paths_.slots.sample), OutlineSamples<S>::PlaceBlock);
            lights_.find_places(at_, i, mask<F>(lane_index<F>() < U(n - i)),
                                {{place.u[1], place.u[2], more.u[2], more.u[3]}});
        }
    }

    void find_edges(uint32_t n) {
        edges_.clear(), rays_.clear();
        for (uint32_t k = 0; k < n; ++k) {
            Edge x{};
            Ray ray;
            const LightPlace light = lights_.place(at_, k);
            if (!samples_.find(this->sample_of(k), k, at_, light, boundary_.moves, numbers_[k], x, ray)) continue;
            rays_.push_back(ray), edges_.push_back(x);
        }
        end_rays();
    }

    // Where rays past the edges end; those that do not come past them are left out.
    void end_rays() {
        std::vector<Ray> back(rays_.size());
        for (size_t k = 0; k < rays_.size(); ++k) back[k] = {rays_[k].o, -rays_[k].d};
        PathQueue<S> &queue = this->fill(back, [&](size_t k) { return edges_[k].far ? S(INFINITY) : S(-1); });
        uint8_t *occluded = this->queries().occluded;
        call_.accel->occluded(this->queries().batch(rays_of(queue), back.size()), occluded, back.size());
        std::vector<uint8_t> hidden(occluded, occluded + back.size());
        this->intersect(rays_);
        look_closer_at_edges();
        size_t kept = 0;
        for (size_t k = 0; k < edges_.size(); ++k)
            if (samples_.end(edges_[k], rays_[k], hidden[k] != 0, at_)) edges_[kept++] = edges_[k];
        edges_.resize(kept);
    }

    // Rays end where others do that are closer to folded edges, if these end sooner.
    void look_closer_at_edges() {
        this->wanted_.clear();
        for (size_t k = 0; k < edges_.size(); ++k)
            if (edges_[k].folded) this->wanted_.push_back(samples_.look_closer(edges_[k], rays_[k]));
        this->look_closer([](uint32_t) { return false; }, false);
        for (size_t k = 0, i = 0; k < edges_.size(); ++k) {
            if (!edges_[k].folded) continue;
            samples_.end_sooner(edges_[k], this->wanted_[i], this->closer_[i], rays_[k]);
            ++i;
        }
    }

    // --------------------------------------------------------------------------------------- from there to the camera
    void see_from_camera(uint32_t n) {
        PathQueue<S> &queue = begin_ends(n, 0);
        std::vector<S> area(n);
        for (const Edge &x : edges_) {
            const uint32_t k = x.slot;
            CameraSample<S> place = samples_.lens_of(this->sample_of(k));
            const V s = at_.s.get(k);
            if (!samples_.sees(s, place)) continue;
            const CameraRay<S> ray = samples_.ray_of(place);
            if (!ray.exists) continue;
            this->keep_place(ends_.slots, k, place);
            at_.distance[k] = samples_.length(s - ray.ray.o);
            area[k] = samples_.pixel_area(place, ray.ray.d, samples_.length(s - ray.center));
            push_end(queue, k, ray.ray.o, ray.ray.d, ray.length, ray.center, S(0));
        }
        shade_ends(0);
        connections_.clear();
        for (uint32_t e = 0; e < edges_.size(); ++e) {
            const uint32_t k = edges_[e].slot;
            if (!(at_.ratio[k] > 0)) continue;
            const S mis = at_.mis[k] < 0 ? S(1) : at_.mis[k];
            connect(e, at_.ratio[k] * edges_[e].weight * mis / area[k], {S(1), S(1), S(1)}, nullptr);
        }
    }

    // Every path gets one of the edges that are left, a random one, and every edge about as many paths: past most edges
    // of an object under a sky there is nothing, and what the paths' vertices see of the others is rare and large.
    void share_edges(uint32_t n) {
        const std::vector<Edge> left = std::move(edges_);
        const uint32_t shift = this->bits(0, OutlineSamples<S>::PlaceBlock).bits[0];
        edges_.resize(n);
        for (uint32_t k = 0; k < n; ++k) {
            edges_[k] = left[(k + size_t(shift)) % left.size()];
            edges_[k].weight = edges_[k].weight * S(double(left.size()) / n);
        }
        at_.for_arrays([&](auto *array) {
            const std::vector<std::decay_t<decltype(*array)>> of(array, array + n);
            for (uint32_t k = 0; k < n; ++k) array[k] = of[edges_[k].slot];
        });
        for (uint32_t k = 0; k < n; ++k) edges_[k].slot = k;
    }

    void see_from_vertices(uint32_t n) {
        std::vector<S> r(n, S(0));
        for (uint32_t k = 0; k < n; ++k) towards_.d.set(k, {S(0), S(0), S(1)});
        for (const Edge &x : edges_) {
            const uint32_t k = x.slot;
            if (anchors_.level[k] == NoVertex) continue;
            const V towards = at_.s.get(k) - this->vertex(k).place();
            r[k] = samples_.length(towards);
            towards_.d.set(k, samples_.unit(towards));
        }
        this->find_rows(n);
        this->scatter_chosen();
        PathQueue<S> &queue = begin_ends(n, 0x80000000u);
        carried_.assign(n, V{S(0), S(0), S(0)});
        std::vector<S> factors(n, S(0));
        for (const Edge &x : edges_) {
            const uint32_t k = x.slot;
            if (anchors_.level[k] == NoVertex || !(r[k] > 0) || !(towards_.pdf[k] > 0)) continue;
            const auto &beta = this->level_of(k).columns.vertex.beta;
            const uint32_t e = anchors_.entry[k];
            const S factor = S(inverse_[k]) * S(boundary_.n_cells) / (r[k] * r[k]);
            factors[k] = factor;
            S c[SpectrumSize];
            for (int i = 0; i < SpectrumSize; ++i) c[i] = towards_.f[i][k] * beta[i][e] * factor;
            carried_[k] = {c[0], c[1], c[2]};
            if (!(max_abs(carried_[k]) > 0) || !std::isfinite(c[0] + c[1] + c[2])) continue;
            const V d = towards_.d.get(k), p = this->vertex(k).place(), o = offset_origin(p, anchors_.ng.get(k), d);
            at_.distance[k] = r[k];
            push_end(queue, k, o, d, S(INFINITY), p, S(1));
        }
        shade_ends(1);
        connections_.clear();
        for (uint32_t e = 0; e < edges_.size(); ++e) {
            const uint32_t k = edges_[e].slot;
            if (!(at_.ratio[k] > 0)) continue;
            // close to the vertex a part of it is found from there
            const S near = at_.mis[k] < 0 ? S(1) : S(samples_.apart(double(r[k]))) * at_.mis[k];
            const S number = at_.ratio[k] * edges_[e].weight * near;
            if (!this->polarized()) {
                connect(e, number, carried_[k], nullptr);
                continue;
            }
            const StokesRows<S> rows = this->rows_towards(k);
            connect(e, number * factors[k], {S(1), S(1), S(1)}, &rows);
        }
    }

    // `other`: with samples of their own, since those of the path have chosen its BSDFs.
    PathQueue<S> &begin_ends(uint32_t n, uint32_t other) {
        ends_.begin(n);
        for (uint32_t k = 0; k < n; ++k) {
            ends_.slots.pixel[k] = paths_.slots.pixel[k], ends_.slots.sample[k] = paths_.slots.sample[k] ^ other;
            at_.ratio[k] = 0;
        }
        return ends_.wavefront.queues[0];
    }
    void push_end(PathQueue<S> &queue, uint32_t slot, const V &o, const V &d, S length, const V &from, S pdf) {
        const uint32_t k = queue.n++;
        queue.o.set(k, o), queue.d.set(k, d), queue.from.set(k, from);
        queue.length[k] = length, queue.pdf[k] = pdf, queue.eta[k] = 1;
        for (int c = 0; c < SpectrumSize; ++c) queue.beta[c][k] = queue.survival[c][k] = 1;
        queue.slot[k] = slot, queue.parent[k] = 0, queue.seen[k] = 1;
    }
    // Traces these rays; where they meet S at_.value, mis and ratio become what it gets of the light.
    void shade_ends(int depth) {
        ends_.first_vertices(depth);
        Tape<S> &tape = ends_.wavefront.tape;
        this->for_smooth(ends_, [&](uint32_t l, const KindRange &range) {
            const TapeColumns<S> &columns = tape[int(l)].columns;
            for (uint32_t i = range.begin; i < range.begin + range.count; i += W) {
                M there = mask<F>(lane_index<F>() < U(range.begin + range.count - i));
                U slot = select(mask<U>(there), load_uint<F>(columns.vertex.slot.at + i), U(0u));
                shade_end(columns, range.kind, i, slot, there, depth);
            }
        });
    }
    void shade_end(const TapeColumns<S> &columns, int kind, uint32_t i, const U &slot, const M &there, int depth) {
        const M meets = meets_end<F>(at_, columns, i, slot, there);
        if (!any(meets)) return;
        const Wavelengths<F> waves = this->waves_of(slot, meets);
        const GradientNeeds &needs = ends_.wavefront.needs();
        const bool first = depth == 0;
        const ShadedEnd<F> end =
            tr::shade_end<F>(scene_, waves, lights_, at_, columns, kind, i, slot, meets, needs, boundary_.near,
                             first ? boundary_.in_view : 1, first ? call_.config.emitter_samples : 1,
                             first ? call_.config.bsdf_samples : 1);
        if (!this->polarized()) return;
        put_column(column_towards<F>(scene_, waves, kind, columns, i, end.d, end.light, end.radiance, needs, end.meets),
                   end.c, slot, end.meets);
    }
    // What leaves S against c, on the film's axis.
    void put_column(Stokes<F> column, const Vec3<F> &c, const U &slot, const M &meets) {
        column = turned_column(column, film_axis<F>(scene_, call_.config.sensor, -c), -c);
        const SpectrumColumn<S> to[] = {at_.value, at_.q, at_.u, at_.v};
        for (int i = 0; i < 4; ++i)
            for (int k = 0; k < SpectrumSize; ++k) scatter_lanes<F>(to[i][k], slot, column.at[i][k], meets);
    }

    // ------------------------------------------------------------------------------------------------------- the sum
    // The connection's jump: -(what arrives) times a number and colours or, of polarised light, rows; null: the
    // camera's.
    void connect(uint32_t edge, S number, const V &colours, const StokesRows<S> *rows) {
        const uint32_t k = edges_[edge].slot;
        const S by[3] = {colours.x, colours.y, colours.z};
        Connection connection{edge, k, {}};
        const SpectrumColumn<S> columns[] = {at_.value, at_.q, at_.u, at_.v};
        for (int part = 0; part < this->parts(); ++part)
            for (int c = 0; c < SpectrumSize; ++c) connection.jump[part][c] = -columns[part][c][k] * number * by[c];
        if (rows) {
            const V along = -towards_.d.get(k);
            Stokes<S> column{{}, this->axis_on_film(along)};
            std::copy_n(connection.jump, 4, column.at);
            Base::contract_rows(*rows, column, along, connection.jump);
        }
        bool some = false;
        for (int part = 0; part < this->parts(); ++part) {
            connection.jump[part] = this->to_channels(k, connection.jump[part]);
            for (int c = 0; c < SpectrumSize; ++c) {
                if (!std::isfinite(connection.jump[part][c])) return;
                some |= connection.jump[part][c] != 0;
            }
        }
        if (some) connections_.push_back(connection);
    }

    // Hands on the adjoints of all connections, `which` of a sample's two.
    void settle(uint64_t first, uint32_t n, uint64_t which, const SlotColumns<S> &slots, GradientSink<F> &sink,
                bool camera) {
        if (boundary_.weighs)
            return this->tell_weights(first, connections_,
                                      [](const Connection &x, int part, int c) { return double(x.jump[part][c]); });
        if (!sink.forward)
            return add(n, slots, sink, camera, [&](const Connection &x) {
                const uint32_t k = x.slot;
                return this->contracted(slots.film_x[k], slots.film_y[k], [&](int part) { return x.jump[part]; });
            });
        this->for_parts(n, slots, sink, [&](int part, int c, const SlotColumns<S> &to) {
            add(n, to, sink, camera, [&](const Connection &x) { return x.jump[part][c]; });
        });
        for (const Connection &x : connections_) this->write_value(2 * (first + x.slot) + which, slots, x.slot);
    }

    template <class Weight>
    void add(uint32_t n, const SlotColumns<S> &slots, GradientSink<F> &sink, bool camera, Weight &&weight) {
        const V zero{S(0), S(0), S(0)};
        for (uint32_t k = 0; k < n; ++k) at_.s_bar.set(k, zero), at_.e_bar.set(k, zero), anchors_.p_bar.set(k, zero);
        PointSink<F> points{sink};
        for (const Connection &x : connections_) {
            const Edge &edge = edges_[x.edge];
            const S w = weight(x);
            if (w == 0 || !std::isfinite(w)) continue;
            points.derivative = 0;
            samples_.add(edge, w, at_, points, this->glue_to(edge.slot));
            if (sink.forward) slots.radiance[sink.component][edge.slot] += points.derivative;
        }
        for (uint32_t i = 0; i < n; i += W) lights_.sweep(at_, i, mask<F>(lane_index<F>() < U(n - i)), slots, sink);
        this->sweep_glued(sink, slots);
        if (boundary_.glued) return;
        auto ends = [&](int, uint32_t, const U &slot, const M &there) { return Gathered<F>(slot, there)(at_.s_bar); };
        this->sweep_places(
            ends_, slots, sink, camera,
            [&](const U &slot, const Vec3<F> &o_bar, const M &active) {
                scatter_vector<F>(anchors_.p_bar, slot, o_bar, active);
            },
            ends);
        if (!camera) this->sweep_paths(sink, slots);
    }

    // Of pieces: how much the camera gets.
    void tell_pieces(uint64_t first) {
        for (const Connection &x : connections_) {
            double sum = 0;
            for (int c = 0; c < call_.values; ++c) sum += std::fabs(double(x.jump[0][c]));
            boundary_.value[first + x.slot] = sum;
        }
    }

    // Of the pilot: whether there is an edge, and where the camera sees it if it does.
    void tell(uint64_t first, uint32_t n) {
        for (uint32_t k = 0; k < n; ++k) {
            boundary_.value[first + k] = 0;
            boundary_.place[2 * (first + k)] = boundary_.place[2 * (first + k) + 1] = double(NAN);
        }
        for (const Edge &x : edges_) boundary_.value[first + x.slot] = 1;
        for (const Connection &x : connections_) {
            const uint32_t k = x.slot;
            boundary_.place[2 * (first + k)] = double(ends_.slots.film_x[k]);
            boundary_.place[2 * (first + k) + 1] = double(ends_.slots.film_y[k]);
        }
    }
};

}  // namespace tr
