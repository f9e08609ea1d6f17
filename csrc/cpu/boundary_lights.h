// Outlines that lights see: the edges of shadows.
//
// From a place on a light, or along a direction of one that is infinitely far away, an outline's point B is chosen, of
// a small light from the pieces of shadow_pieces.h, evenly, else from the tree. The ray past it ends at S, which the
// camera sees at the place u of its film, at the end of a segment c. With the unit direction d from S to the light, at
// S the BSDF f with its cosine, w pixels per area perpendicular to c, and the density p of the light's place,
//
//     dI = - integral of h(p - u) / Z  w |n.c| / |n.d|  f L g  n.(dB - (1 - tau) dS - tau dE)  dl
//
// with tau = |B - S| / |E - S|, and g = sin cos_E / (r^2 p) for places E on shapes with the cosine there, r from B
// away; sin / r^2 for points, L being their intensity; and sin / p for directions. Where a vertex x of a path sees S in
// place of the camera, beta f_x / |S - x|^2 stands for h w / Z. Directions that the BSDF finds as well share what they
// bring with it by the power heuristic of the path tracer, and close to x with what is found there from x, see
// boundary_reflections.h.
#pragma once

#include "boundary_folds.h"
#include "core/integrator/emission.h"
#include "shadow_lights.h"

namespace tr {

template <class F>
class ShadowTile : public BoundaryFolds<F> {
    using Base = BoundaryFolds<F>;
    using Base::anchors_, Base::boundary_, Base::call_, Base::light_, Base::outlines_, Base::path_call_, Base::paths_,
        Base::scene_, Base::W;
    using typename Base::M, typename Base::OutlineRay, typename Base::S, typename Base::U, typename Base::V;

    // An outline's point B before the light of a slot, and the weight of what arrives at S.
    struct Edge {
        uint32_t slot;
        int32_t element;
        S s;
        V b, free;
        S weight, reach, side;
        bool far, folded;     // see boundary_folds.h
        S tau, length;        // of S to B
        SurfacePoint<S> end;  // S
    };
    // What the camera, or a vertex of the path, gets of an edge.
    struct Connection {
        uint32_t edge, slot;
        Spectrum<S> jump[4];  // by part
    };
    static constexpr size_t Descents = 4;  // lights see about as much of all outlines
    std::vector<Edge> edges_;
    std::vector<Connection> connections_;
    std::vector<OutlineRay> rays_;
    std::vector<double> u_, inverse_, total_;
    const bool pilot_;
    PathTile<F> ends_;
    ShadowLights<F> lights_;
    ShadowEdgeColumns<S> at_;
    std::vector<V> carried_;            // of connections to vertices
    std::vector<S> numbers_, chooses_;  // by slot, for a piece, and for what the light chooses
    const SamplerConfig sequence_ = make_sampler(SamplerKind::Sobol, 0, LargestPattern);

public:
    ShadowTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : Base(call, boundary, derivative),
          pilot_(boundary.part == BoundaryPart::Pilot),
          ends_(path_call_, Base::Capacity, &derivative),
          lights_(scene_, pilot_) {
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
        if (lights_.empty()) return;
        const int depth = call_.config.max_depth;
        const bool pieces = boundary_.part == BoundaryPart::Pieces,
                   deep = !pilot_ && !pieces && (depth < 0 || depth > 2);
        this->identify(first, n);
        if (deep) this->trace_paths(n, stop);
        find_places(first, n);
        find_edges(first, n);
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
    // Four numbers of a sample: for its light and a piece, for a place on the light, and for what the light chooses.
    // They are points of a scrambled sequence, since what a small light makes of them is smooth; 2^n samples are spread
    // best. (With a lattice in their place the pieces find resonances.)
    static constexpr uint32_t LightBlock = Base::PlaceBlock + 1;
    Random4<F> spread(uint64_t sample) const {
        const U high(uint32_t(sample >> 32)), low = U(uint32_t(sample)) + lane_index<F>();
        return sobol4<F>(sequence_, call_.config.seed, call_.config.sensor, SobolPlace<U>(sequence_, high, low),
                         LightBlock, AllWanted);
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
        lights_.find_places(at_, n, [&](uint32_t i) {
            Entries<F> from(i);
            const Random4<F> place = spread(boundary_.first + first + i),
                             more = random4<F>(call_.config.seed, call_.config.sensor, from(paths_.slots.pixel),
                                               from(paths_.slots.sample), Base::PlaceBlock);
            return Random4<F>{{place.u[1], place.u[2], more.u[2], more.u[3]}};
        });
    }

    // An outline before the light of a slot: its element, a place on it, and one over the density of both.
    OutlineChoice choose_outline(uint64_t first, uint32_t k, const OutlineAnchor &from) const {
        const OutlinePieces *pieces = boundary_.shadows->find(at_.emitter[k]);
        if (!pieces) return boundary_.outlines->tree().choose(from, this->tree_seed(k), Descents);
        if (boundary_.part == BoundaryPart::Pieces) {
            const OutlinePiece &piece = pieces->all[size_t(boundary_.first + first + k) % pieces->all.size()];
            const float length = piece.end - piece.begin;
            return {piece.element, piece.begin + length * float(numbers_[k]), length};
        }
        const OutlinePieces::Place chosen = pieces->choose(numbers_[k], boundary_.outlines->tree());
        return {chosen.element, float(chosen.s), float(chosen.inverse_density)};
    }

    void find_edges(uint64_t first, uint32_t n) {
        edges_.clear(), rays_.clear();
        for (uint32_t k = 0; k < n; ++k) {
            const EmitterKernels<F> &light = lights_.kernels(at_, k);
            const bool on_shape = light.is(IsOnShape);
            Edge x{};
            x.slot = k, x.far = light.is(IsInfinite);
            const V y = at_.y.get(k), yn = at_.yn.get(k), origin = x.far ? at_.travel.get(k) : y;
            OutlineAnchor anchor{};
            anchor.p = Base::single(origin), anchor.n = anchor.axis = anchor.ng = Base::single(yn);
            anchor.still =
                on_shape ? this->still(boundary_.moves[at_.at.shape[k]]) : 0.2f;  // lights at points may move
            anchor.parallel = x.far, anchor.own = on_shape ? int32_t(at_.at.shape[k]) : -1;
            const OutlineChoice chosen = choose_outline(first, k, anchor);
            if (chosen.element < 0) continue;
            const OutlinePoint<S> point = outlines_.point(chosen.element, S(chosen.s), origin, x.far);
            if (!point.valid || point.front == 0) continue;
            const V towards = x.far ? origin : point.p - y;
            const S r = Base::length(towards);
            const V d = towards * (1 / std::max(r, S(1e-30))), across = cross(d, point.along);
            const S turned = Base::length(across);  // the sine times |along|
            x.weight = turned * S(chosen.inverse_density) * at_.inverse_pdf[k] * S(1 / boundary_.total);
            if (!x.far) x.weight = x.weight / (r * r);
            if (on_shape) x.weight = x.weight * std::max(dot(yn, d), S(0));
            if (!(x.weight > 0) || !std::isfinite(x.weight)) continue;
            x.element = chosen.element, x.s = S(chosen.s), x.b = point.p, x.length = r;
            x.free = across * (-point.front / turned);  // from what hides to what does not
            x.reach = point.reach;
            x.side = x.far ? Base::least_side(x.b, S(0), point.reach) : Base::side_of(r, x.b, point.room, point.reach);
            x.folded = this->is_folded(x.element, point.front, point.room, x.side);
            rays_.push_back(x.far ? OutlineRay{x.b + x.free * x.side, d}
                                  : Base::beside(y, yn, x.b, x.free, point.room, point.reach, S(0)));
            edges_.push_back(x);
        }
        end_rays();
    }

    // Where rays past the edges end; those that do not come past them are left out.
    void end_rays() {
        std::vector<OutlineRay> back(rays_.size());
        for (size_t k = 0; k < rays_.size(); ++k) back[k] = {rays_[k].o, -rays_[k].d};
        PathQueue<S> &queue = this->fill(back, [&](size_t k) { return edges_[k].far ? S(INFINITY) : S(-1); });
        uint8_t *occluded = this->queries().occluded;
        call_.accel->occluded(this->queries().batch(rays_of(queue), back.size()), occluded, back.size());
        std::vector<uint8_t> hidden(occluded, occluded + back.size());
        this->intersect(rays_);
        look_closer_at_edges();
        size_t kept = 0;
        for (size_t k = 0; k < edges_.size(); ++k) {
            Edge &x = edges_[k];
            const S t = rays_[k].t;
            if (x.far ? hidden[k] != 0 || !(t > 0) : !(t > x.length * S(1 - 1e-3))) continue;
            if (!std::isfinite(t)) continue;
            const V s = rays_[k].o + rays_[k].d * t;
            at_.s.set(x.slot, s), at_.d.set(x.slot, -rays_[k].d);
            x.end = rays_[k].at;
            x.length = at_.b_distance[x.slot] = Base::length(x.b - s);
            at_.e_distance[x.slot] = x.far ? S(INFINITY) : Base::length(at_.y.get(x.slot) - s);
            x.tau = x.far ? S(0) : x.length / at_.e_distance[x.slot];
            edges_[kept++] = x;
        }
        edges_.resize(kept);
    }

    // Rays end where others do that are closer to folded edges, if these end sooner.
    void look_closer_at_edges() {
        this->wanted_.clear();
        for (size_t k = 0; k < edges_.size(); ++k) {
            const Edge &x = edges_[k];
            if (!x.folded) continue;
            const V at = x.b + x.free * (x.side * Base::Closer), d = rays_[k].d;
            const S before = x.far ? 16 * x.reach : dot(x.b - rays_[k].o, d);
            this->wanted_.push_back({x.element, at, d, before, S(INFINITY), x.reach, true});
        }
        this->look_closer([](uint32_t) { return false; }, false);
        for (size_t k = 0, i = 0; k < edges_.size(); ++k) {
            if (!edges_[k].folded) continue;
            const auto &wanted = this->wanted_[i];
            OutlineRay closer = this->closer_[i++];
            if (edges_[k].far) closer.o = wanted.at, closer.t -= wanted.distance;
            if (closer.t < rays_[k].t * S(1 - 1e-5)) rays_[k] = closer;
        }
    }

    // --------------------------------------------------------------------------------------- from there to the camera
    void see_from_camera(uint32_t n) {
        const S width = S(call_.film_width), height = S(call_.film_height);
        PathQueue<S> &queue = begin_ends(n, 0);
        std::vector<S> area(n);
        for (const Edge &x : edges_) {
            const uint32_t k = x.slot;
            CameraSample<S> place = this->lens_of(k);
            const V s = at_.s.get(k);
            if (!film_place<S>(scene_, this->sensor(), s, width, height, place)) continue;
            if (!std::isfinite(place.x) || !std::isfinite(place.y) || !this->near_film(place.x, place.y)) continue;
            const CameraRay<S> ray = camera_ray<S>(scene_, this->sensor(), place, width, height);
            if (!ray.exists) continue;
            this->keep_place(ends_.slots, k, place);
            at_.distance[k] = Base::length(s - ray.ray.o);
            area[k] = this->pixel_area(place, ray.ray.d, Base::length(s - ray.center));
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
        const uint32_t shift = this->bits(0, Base::PlaceBlock).bits[0];
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
        for (uint32_t k = 0; k < n; ++k) anchors_.d.set(k, {S(0), S(0), S(1)});
        for (const Edge &x : edges_) {
            const uint32_t k = x.slot;
            if (anchors_.level[k] == NoVertex) continue;
            const V towards = at_.s.get(k) - this->place_of(k);
            r[k] = Base::length(towards);
            anchors_.d.set(k, Base::unit(towards));
        }
        this->find_rows(n);
        this->scatter_chosen();
        PathQueue<S> &queue = begin_ends(n, 0x80000000u);
        carried_.assign(n, V{S(0), S(0), S(0)});
        std::vector<S> factors(n, S(0));
        for (const Edge &x : edges_) {
            const uint32_t k = x.slot;
            if (anchors_.level[k] == NoVertex || !(r[k] > 0) || !(anchors_.pdf[k] > 0)) continue;
            const auto &beta = this->level_of(k).columns.vertex.beta;
            const uint32_t e = anchors_.entry[k];
            const S factor = S(inverse_[k]) * S(boundary_.n_cells) / (r[k] * r[k]);
            factors[k] = factor;
            S c[SpectrumSize];
            for (int i = 0; i < SpectrumSize; ++i) c[i] = anchors_.f[i][k] * beta[i][e] * factor;
            carried_[k] = {c[0], c[1], c[2]};
            if (!(max_abs(carried_[k]) > 0) || !std::isfinite(c[0] + c[1] + c[2])) continue;
            const V d = anchors_.d.get(k), p = this->place_of(k), o = offset_origin(p, anchors_.ng.get(k), d);
            at_.distance[k] = r[k];
            push_end(queue, k, o, d, S(INFINITY), p, S(1));
        }
        shade_ends(1);
        connections_.clear();
        for (uint32_t e = 0; e < edges_.size(); ++e) {
            const uint32_t k = edges_[e].slot;
            if (!(at_.ratio[k] > 0)) continue;
            // close to the vertex a part of it is found from there
            const S near = at_.mis[k] < 0 ? S(1) : S(this->apart(double(r[k]))) * at_.mis[k];
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
        Gathered<F> from(slot, there);
        Entries<F> entry(i);
        const Vec3<F> p = entry(columns.arrival.p), c = entry(columns.arrival.d), s = from(at_.s), d = from(at_.d);
        const Vec3<F> apart = p - s;
        M meets = there && mask<F>(squared_norm(apart) < sqr(F(S(1e-3)) * (from(at_.distance) + max_abs(s))));
        if (!any(meets)) return;
        const Wavelengths<F> waves = this->waves_of(slot, meets);
        BsdfValue<F> found = scatter_towards<F>(scene_, waves, kind, columns, i, d, ends_.wavefront.needs(), meets);
        Vec3<F> ng = geometric_normal<F>(scene_, columns, i, meets);
        EmitterPoint<F> light;
        F density;
        const Spectrum<F> radiance = lights_.arriving(at_, waves, p, d, from, meets, light, density),
                          value = found.f * radiance;
        const bool first = depth == 0;
        if (first) density = density * F(S(boundary_.in_view));
        const F cosine = dot(ng, d);
        density = density / this->beside_lights(from(at_.b_distance), cosine, found.pdf);
        F n_light(S(first ? call_.config.emitter_samples : 1)), n_bsdf(S(first ? call_.config.bsdf_samples : 1));
        F mis = select(mask<F>(density > F(0)), power_heuristic(n_light * density, n_bsdf * found.pdf), F(-1));
        F ratio = abs(dot(ng, c)) / max(abs(cosine), F(S(1e-6)));
        meets = meets && is_finite(value) && mask<F>(found.pdf > F(0));
        for (int k = 0; k < SpectrumSize; ++k) scatter_lanes<F>(at_.value[k], slot, value[k], meets);
        if (this->polarized())
            put_column(
                column_towards<F>(scene_, waves, kind, columns, i, d, light, radiance, ends_.wavefront.needs(), meets),
                c, slot, meets);
        scatter_lanes<F>(at_.mis.at, slot, mis, meets);
        scatter_lanes<F>(at_.ratio.at, slot, ratio, meets);
    }
    static F sqr(const F &x) { return x * x; }
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
            const V along = -anchors_.d.get(k);
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
            const V g = edge.free * w;
            const V s_bar = g * (edge.tau - 1);
            if (boundary_.glued)
                this->add_glued(edge.slot, edge.end, at_.s.get(edge.slot), s_bar);
            else
                at_.s_bar.set(edge.slot, s_bar);
            at_.e_bar.set(edge.slot, g * (edge.far ? edge.length : -edge.tau));
            points.derivative = 0;
            this->add_to_outline(edge.slot, edge.element, edge.s, edge.b, g, points);
            if (sink.forward) slots.radiance[sink.component][edge.slot] += points.derivative;
        }
        lights_.sweep(at_, n, slots, sink);
        this->sweep_glued(sink, slots);
        if (boundary_.glued) return;
        auto ends = [&](int, uint32_t, const U &slot, const M &there) { return Gathered<F>(slot, there)(at_.s_bar); };
        this->sweep_places(
            ends_, slots, sink, camera,
            [&](const U &slot, const Vec3<F> &o_bar, const M &active) {
                Base::put(anchors_.p_bar, slot, o_bar, active);
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
