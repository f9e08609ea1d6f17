// What samples of outlines have in common, whichever way they are found: rays beside outlines, radiance along rays, and
// the sums that a moving outline adds to; and the paths of boundary_paths.h.
//
// A sample's rate n.(dB - ...) has a weight for each channel of the film and, of polarised light, for each component of
// the Stokes vector (a `part`). In reverse mode the film's adjoint makes one number of them; forward mode has a sweep a
// channel and part (see GradientSink).
//
// Of `glued` samples, which are for light paths, both ends S and E of a segment past an outline move with their
// surfaces, wherever they are; then no more than what the outline uncovers counts, its rate being n.(dB - (1 - tau) dS
// - tau dE), tau = |B - S| / |E - S|: see docs/theory/light_tracing.md.
#pragma once

#include "boundary_paths.h"

namespace tr {

template <class F>
class BoundaryTile : public BoundaryPaths<F> {
protected:
    using Paths = BoundaryPaths<F>;
    using Paths::anchors_, Paths::boundary_, Paths::call_, Paths::of_part, Paths::parts, Paths::path_call_,
        Paths::paths_, Paths::polarized, Paths::samples_, Paths::scene_, Paths::W;
    using typename Paths::M, typename Paths::S, typename Paths::U, typename Paths::V;

    PathTile<F> light_;
    GluedColumns<S> glued_;

public:
    using Paths::Capacity;

    BoundaryTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : Paths(call, boundary, derivative), light_(call, 2 * Capacity, nullptr) {
        glued_arena_.allocate(3 * Capacity + 2 * W, glued_);
    }

    RenderStats take_stats() {
        RenderStats stats = paths_.take_stats();
        stats.add(light_.take_stats());
        return stats;
    }

protected:
    // ---------------------------------------------------------------------------------------------- rays and light
    using Ray = OutlineRay<S>;

    // Rays of these lengths, at most 2 Capacity, where queries find them.
    template <class Length>
    PathQueue<S> &fill(const std::vector<Ray> &rays, Length &&length) {
        PathQueue<S> &queue = light_.wavefront.queues[0];
        for (size_t k = 0; k < rays.size(); ++k)
            queue.o.set(k, rays[k].o), queue.d.set(k, rays[k].d), queue.length[k] = length(k);
        return queue;
    }
    void trace(PathQueue<S> &queue, size_t n, bool coherent) {
        queries().intersect(rays_of(queue), n, coherent);
        light_.wavefront.stats.closest_rays += n;
    }
    void intersect(std::vector<Ray> &rays) {
        trace(fill(rays, [](size_t) { return S(INFINITY); }), rays.size(), false);
        keep_hits(rays);
    }
    void keep_hits(std::vector<Ray> &rays) {
        for (size_t i = 0; i < rays.size(); ++i) keep_hit(i, rays[i]);
    }
    // What the ray in a place of the queue has met.
    void keep_hit(size_t i, Ray &ray) {
        const HitColumns<S> &hits = queries().hits;
        ray.meet(hits.at.get(i), hits.t[i], light_.wavefront.queues[0].o.get(i));
    }
    RayQueries<S> &queries() { return light_.wavefront.queries; }

    // Radiance, at the wavelengths of their samples, along rays behind `depth` vertices, into the slots of `light_`, of
    // polarised light on axes that are the film's; `traced`: their hits are known; pdf: with which density their
    // directions are sampled beside lights, 0 where they alone find the light; `seen`: see PathQueue.
    void look_up(const std::vector<Ray> &rays, const std::vector<S> &lengths, const std::vector<S> &pdf,
                 const std::vector<uint32_t> &key, const std::vector<uint32_t> &seen, int depth, bool traced,
                 const Stop &stop) {
        const uint32_t n = uint32_t(rays.size());
        light_.begin(n);
        auto &slots = light_.slots;
        PathQueue<S> &queue = light_.wavefront.queues[0];
        for (uint32_t k = 0; k < n; ++k) {
            slots.pixel[k] = key[k], slots.sample[k] = 0, slots.row[k] = slots.column[k] = 0;
            slots.alpha[k] = 0;
            for (int c = 0; c < SpectrumSize; ++c)
                slots.radiance[c][k] = 0, queue.beta[c][k] = 1, queue.survival[c][k] = 1;
            for (int c = 0; polarized() && c < SpectrumSize; ++c) slots.q[c][k] = slots.u[c][k] = slots.v[c][k] = 0;
            queue.o.set(k, rays[k].o), queue.d.set(k, rays[k].d), queue.from.set(k, rays[k].o);
            queue.length[k] = lengths[k], queue.pdf[k] = pdf[k], queue.eta[k] = 1;
            queue.slot[k] = k, queue.parent[k] = 0, queue.seen[k] = seen[k];
        }
        queue.n = n;
        const HitColumns<S> &hits = queries().hits;
        for (uint32_t k = 0; k < n && traced; ++k) {
            const SurfacePoint<S> &at = rays[k].at;
            hits.at.shape[k] = at.shape, hits.at.primitive[k] = at.primitive;
            hits.at.b1[k] = at.b1, hits.at.b2[k] = at.b2, hits.t[k] = rays[k].t;
        }
        light_.run(polarized(), stop, depth, traced, boundary_.glued && depth == 0);
        if (polarized()) light_.sweep_columns();
    }

    // ------------------------------------------------------------------------------------------------------- sums
    // What a place on the film gets of the adjoint.
    void collect(S x, S y, double *to) const {
        for_film_place(boundary_.filter, x, y, [&](const FilmPlace<S> &place) { boundary_.film->collect(place, to); });
    }
    // The number that the film's adjoint of a place makes of jumps, by part.
    template <class Jump>
    S contracted(S x, S y, Jump &&jump) const {
        bool some = false;
        for (int part = 0; part < parts(); ++part)
            for (int c = 0; c < call_.values; ++c) some |= jump(part)[c] != 0;
        if (!some) return 0;
        double adjoint[MostBoundaryChannels], sum = 0;
        collect(x, y, adjoint);
        for (int part = 0; part < parts(); ++part)
            for (int c = 0; c < call_.values; ++c) sum += adjoint[part * call_.values + c] * double(jump(part)[c]);
        return S(sum);
    }
    // Forward mode: calls add(part, channel, slots) for all of them, the slots' radiance being what it adds to.
    template <class Add>
    void for_parts(uint32_t n, const SlotColumns<S> &slots, GradientSink<F> &sink, Add &&add) const {
        for (int part = 0; part < parts(); ++part) {
            const SlotColumns<S> to = of_part(slots, part);
            for (int c = 0; c < SpectrumSize; ++c) std::fill_n(to.radiance[c], n, S(0));
            for (int c = 0; c < call_.values; ++c) {
                sink.component = c;
                add(part, c, to);
            }
        }
    }
    // Adds to the weights of samples what these sights, or connections, bring, by part and channel.
    template <class All, class Jump>
    void tell_weights(uint64_t first, const All &all, Jump &&jump) const {
        for (const auto &x : all)
            for (int part = 0; part < parts(); ++part)
                for (int c = 0; c < call_.values; ++c) {
                    const double brings = jump(x, part, c);
                    boundary_.value[first + x.slot] += brings * brings;
                }
    }
    // ... what the sample of a slot adds to the film.
    void write_value(uint64_t row, const SlotColumns<S> &slots, uint32_t slot) const {
        double *place = boundary_.place + 2 * row, *value = boundary_.value + size_t(boundary_.channels) * row;
        place[0] = double(slots.film_x[slot]), place[1] = double(slots.film_y[slot]);
        for (int part = 0; part < parts(); ++part)
            for (int c = 0; c < call_.values; ++c) *value++ = double(of_part(slots, part).radiance[c][slot]);
    }

    // Of a slot; handed on by sweep_glued().
    void add_glued(uint32_t slot, const SurfacePoint<S> &at, const V &p, const V &p_bar) {
        const uint32_t k = glued_.n++;
        glued_.slot[k] = slot;
        glued_.at.set(k, at), glued_.p.set(k, p), glued_.p_bar.set(k, p_bar);
    }
    auto glue_to(uint32_t slot) {
        return [this, slot](const SurfacePoint<S> &at, const V &p, const V &p_bar) { add_glued(slot, at, p, p_bar); };
    }
    // Hands on the adjoints of points that are glued to lights or, of glued samples, to surfaces; derivatives go to
    // these slots.
    void sweep_glued(GradientSink<F> &sink, const SlotColumns<S> &slots) {
        for (uint32_t i = 0; i < glued_.n; i += W) {
            Entries<F> from(i);
            M there = mask<F>(lane_index<F>() < U(glued_.n - i));
            SurfacePoint<F> at = from(glued_.at);
            at.shape = select(mask<U>(there), at.shape, U(0u));
            M active = sink.wants_shape(at.shape, there);
            sink.begin();
            if (any(active)) sweep_position(scene_, at, from(glued_.p), from(glued_.p_bar), active, sink);
            if (sink.forward) add_to_entries<F>(slots.radiance, from(glued_.slot), sink.derivative, active);
        }
        glued_.n = 0;
    }
    // ... those of the chosen vertices of paths.
    void sweep_paths(GradientSink<F> &sink, const SlotColumns<S> &slots) {
        auto nothing = [](const U &, const Vec3<F> &, const M &) {};
        sweep_places(paths_, slots, sink, true, nothing, [&](int level, uint32_t i, const U &slot, const M &there) {
            Gathered<F> from(slot, there);
            M chosen = there && mask<F>(from(anchors_.level) == U(uint32_t(level))) &&
                       mask<F>(from(anchors_.entry) == U(i) + lane_index<F>());
            return select(chosen, from(anchors_.p_bar), Vec3<F>{F(0), F(0), F(0)});
        });
    }
    // From the last level of the tape to the first; own(level, i, slot, there): the adjoint of a vertex's place.
    // Derivatives go to `slots`, adjoints of where rays began that are not the camera's to begin(slot, o_bar, active).
    template <class Begin, class Own>
    void sweep_places(PathTile<F> &tile, const SlotColumns<S> &slots, GradientSink<F> &sink, bool from_camera,
                      Begin &&begin, Own &&own) {
        Tape<S> &tape = tile.wavefront.tape;
        SweepContext<F> c{scene_,
                          path_call_.config,
                          slots,
                          tile.wavefront.needs(),
                          S(call_.film_width),
                          S(call_.film_height),
                          nullptr,
                          false,
                          from_camera};
        for (int l = tape.size() - 1; l >= 0; --l) {
            TapeLevel<S> &level = tape[l];
            const TapeColumns<S> *parents = level.parent_level >= 0 ? &tape[level.parent_level].columns : nullptr;
            for (const KindRange &range : level.ranges) {
                if (range.kind >= MissKind) continue;
                for (uint32_t i = range.begin; i < range.begin + range.count; i += W) {
                    M there = mask<F>(lane_index<F>() < U(range.begin + range.count - i));
                    U slot = select(mask<U>(there), load_uint<F>(level.columns.vertex.slot.at + i), U(0u));
                    Vec3<F> p_bar = own(l, i, slot, there);
                    Entries<F> from(i);
                    const auto &next = level.columns.next;
                    M active =
                        there &&
                        mask<F>(max_abs(p_bar) + max_abs(from(next.ray_o_bar)) + max_abs(from(next.ray_d_bar)) > F(0));
                    if (!any(active)) continue;
                    Vec3<F> o_bar =
                        sweep_place(c, level.columns, parents, range.kind, level.scatters, i, p_bar, active, sink);
                    if (!parents && !from_camera) begin(slot, o_bar, active);
                }
            }
        }
        // the next sweep finds none of this
        for (int l = 0; l < tape.size(); ++l)
            for (const KindRange &range : tape[l].ranges)
                for (S *p : {tape[l].columns.next.ray_o_bar.x, tape[l].columns.next.ray_o_bar.y,
                             tape[l].columns.next.ray_o_bar.z, tape[l].columns.next.ray_d_bar.x,
                             tape[l].columns.next.ray_d_bar.y, tape[l].columns.next.ray_d_bar.z})
                    std::fill_n(p + range.begin, range.count, S(0));
    }

private:
    Arena glued_arena_;
};

}  // namespace tr
