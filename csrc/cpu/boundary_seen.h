// Outlines that the camera sees. With b on a piece of one, at the place u of the film, n across the ray to it at the
// distance r, w pixels per area perpendicular to it, and the colours and coverages L on both sides,
//
//     dI = integral of h(p - u) / Z  (L_minus - L_plus)  w sin  n.(db - do - r dd)  dl
//
// L may be anything that is seen; see boundary_outputs.h for what is not radiance. Of glued samples L is zero on the
// side of what hides, and where the ray on the other side ends at E the rate is n.(dB - (1 - tau) do - tau dE). Rims of
// normals are among the outlines, see outline_rims.h; glued, they have what they move over their faces, and both sides.
#pragma once

#include "boundary_folds.h"
#include "core/adjoint/camera.h"

namespace tr {

// Where the camera sees outlines, and what their motion adds to.
template <class F>
class SightTile : public BoundaryFolds<F> {
    using Base = BoundaryFolds<F>;
    using Base::outlines_, Base::path_call_;

protected:
    using Base::boundary_, Base::call_, Base::paths_, Base::scene_, Base::W;
    using typename Base::M, typename Base::OutlineRay, typename Base::S, typename Base::U, typename Base::V;
    struct Sight {
        uint32_t slot;
        int32_t element;
        V origin;  // of the ray, or its direction
        S s;
        V b, n;
        S front, t, distance;  // of b from where the ray begins, and from the camera
        S weight, reach, room, side;
        bool folded;  // see boundary_folds.h
    };
    std::vector<Sight> sights_;
    std::vector<OutlineRay> rays_;  // two for each, beside it
    std::vector<S> lengths_;

    // Samples `first` .. `first` + n of the call. look_up() sees along rays_ and tells by set_jump what is there.
    template <class LookUp>
    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, LookUp &&look_up) {
        this->identify(first, n);
        find(first, n);
        look_past();
        jumps_.assign(sights_.size() * channels(), 0);
        look_up();
        if (boundary_.weighs)
            return this->tell_weights(
                first, sights_, [&](const Sight &x, int part, int c) { return jumps_of(x)[part * call_.values + c]; });
        auto &slots = paths_.slots;
        if (!sink.forward)
            return add(n, sink, [&](const Sight &x) {
                double adjoint[MostBoundaryChannels], sum = 0;
                this->collect(slots.film_x[x.slot], slots.film_y[x.slot], adjoint);
                for (size_t c = 0; c < channels(); ++c) sum += adjoint[c] * jumps_of(x)[c];
                return S(sum);
            });
        sink.component = 0;
        std::fill_n(slots.radiance[0], n, S(0));
        add(n, sink, [](const Sight &) { return S(1); });
        for (const Sight &x : sights_) {
            const uint64_t row = first + x.slot;
            boundary_.place[2 * row] = double(slots.film_x[x.slot]);
            boundary_.place[2 * row + 1] = double(slots.film_y[x.slot]);
            for (size_t c = 0; c < channels(); ++c)
                boundary_.value[channels() * row + c] = jumps_of(x)[c] * double(slots.radiance[0][x.slot]);
        }
    }
    // What is seen on the sides of -n and of n, in a channel.
    void set_jump(size_t sight, size_t channel, double minus, double plus) {
        if (boundary_.glued && !is_rim(sights_[sight])) (sights_[sight].front > 0 ? plus : minus) = 0;
        const double jump = (minus - plus) * double(sights_[sight].weight);
        jumps_[sight * channels() + channel] = std::isfinite(jump) ? jump : 0;
    }
    size_t channels() const { return size_t(boundary_.channels); }

public:
    SightTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : Base(call, boundary, derivative) {
        this->keep_lens(paths_.slots);
    }

private:
    std::vector<double> jumps_;

    const double *jumps_of(const Sight &x) const { return jumps_.data() + size_t(&x - sights_.data()) * channels(); }
    using Base::sensor;
    bool parallel() const { return is_parallel(sensor()); }

    void find(uint64_t first, uint32_t n) {
        sights_.clear(), rays_.clear(), lengths_.clear();
        if (boundary_.pieces->all.empty()) return;
        const S width = S(call_.film_width), height = S(call_.film_height);
        const auto &slots = paths_.slots;
        for (uint32_t k = 0; k < n; ++k) {
            CameraSample<S> place = this->lens_of(k);
            place.x = width / 2, place.y = height / 2;
            const CameraRay<S> middle = camera_ray<S>(scene_, sensor(), place, width, height);
            // every sample has a part of the length of all pieces, in which its place is drawn
            const double at = (double(boundary_.first + first + k) + double(this->number(k, 0))) / boundary_.samples;
            const OutlinePieces::Place chosen = boundary_.pieces->choose(at, boundary_.outlines->tree());
            Sight x{};
            x.slot = k, x.element = chosen.element, x.s = S(chosen.s);
            const V origin = parallel() ? middle.ray.d : middle.center;
            const OutlinePoint<S> point = outlines_.point(x.element, x.s, origin, parallel());
            if (!point.valid || is_invisible(x.element) || (boundary_.glued && point.front == 0 && !is_rim(x)))
                continue;
            if (!film_place<S>(scene_, sensor(), point.p, width, height, place)) continue;
            if (!std::isfinite(place.x) || !std::isfinite(place.y) || !this->near_film(place.x, place.y)) continue;
            const CameraRay<S> ray = camera_ray<S>(scene_, sensor(), place, width, height);
            const V o = ray.ray.o, d = ray.ray.d, towards = point.p - o, across = cross(d, point.along);
            x.t = dot(towards, d);
            x.distance = dot(point.p - ray.center, d);
            const S turned = Base::length(across), area = this->pixel_area(place, d, x.distance);
            if (!ray.exists || !(turned > 0) || !(area > 0) || !(x.t > 0) || !(x.t < ray.length)) continue;
            if (!(Base::length(towards - d * x.t) < S(1e-3) * x.t)) continue;  // the lens does not show it there
            x.weight = S(double(turned) / double(area) * chosen.inverse_density / boundary_.total);
            if (!std::isfinite(x.weight)) continue;
            x.b = point.p, x.n = across * (1 / turned), x.front = point.front, x.origin = origin;
            this->keep_place(slots, k, place);
            const S beside = S(is_rim(x) ? BesideRim : Beside) * std::sqrt(area);
            const S side = std::max(std::min(beside, point.room / 8), Base::least_side(point.p, x.t, point.reach));
            x.reach = point.reach, x.room = point.room, x.side = side;
            x.folded = this->is_folded(x.element, x.front, x.room, side);
            for (S sign : {S(-1), S(1)}) {
                const V offset = x.n * (sign * side);
                rays_.push_back(parallel() ? OutlineRay{o + offset, d}
                                           : OutlineRay{o, Base::unit(point.p - o + offset)});
                lengths_.push_back(ray.length);
            }
            sights_.push_back(x);
        }
    }
    // How far beside an outline its colours are looked at, in pixels; beside rims, which are where rounded normals say.
    static constexpr double Beside = 0x1p-14, BesideRim = 0x1p-11;

    bool is_rim(const Sight &x) const { return boundary_.outlines->is_face(size_t(x.element)); }

    void look_past() {
        const bool some = call_.config.hide_emitters || call_.config.volumetric;
        auto passes = [&](uint32_t shape) { return some && lets_through(shape); };
        PathQueue<S> &queue = this->fill(rays_, [&](size_t k) { return lengths_[k]; });
        this->trace(queue, rays_.size(), true);
        pass_through(rays_of(queue), this->queries().hits, rays_.size(), passes,
                     [&] { this->trace(queue, rays_.size(), true); });
        this->keep_hits(rays_);
        this->wanted_.clear();
        for (uint32_t k = 0; k < sights_.size(); ++k) {
            const Sight &x = sights_[k];
            if (!x.folded) continue;
            const V d = parallel() ? rays_[2 * k].d : Base::unit(x.b - rays_[2 * k].o);
            const V o = parallel() ? (rays_[2 * k].o + rays_[2 * k + 1].o) * S(0.5) : rays_[2 * k].o;
            this->want(x.element, x.b, x.n, o, d, lengths_[2 * k], x.reach, x.front, x.side);
        }
        this->look_closer(passes, true);
        size_t kept = 0;
        for (size_t k = 0, i = 0; k < sights_.size(); ++k) {
            const Sight &x = sights_[k];
            OutlineRay beside[2] = {rays_[2 * k], rays_[2 * k + 1]};
            if (x.folded ? !this->is_seen(2 * i++, x.front, x.room, x.side, beside) : is_repeated(x, beside)) continue;
            const S t[2] = {Base::distance(beside[0]), Base::distance(beside[1])};
            if (!Base::is_open(x.front, x.t, t, S(is_rim(x) ? 5e-3 : 1e-5))) continue;
            for (size_t h = 0; h < 2; ++h)
                rays_[2 * kept + h] = beside[h], lengths_[2 * kept + h] = lengths_[2 * k + h];
            sights_[kept++] = x;
        }
        sights_.resize(kept), rays_.resize(2 * kept), lengths_.resize(2 * kept);
    }

    // Of two edges that are closer to each other, across rays, than rays are traced both would have the jump between
    // what is behind them and the nearer one. The nearer has it: past the other one a ray meets a face, beyond its own,
    // that is nearer.
    bool is_repeated(const Sight &x, const OutlineRay (&beside)[2]) const {
        const OutlineRay &hiding = beside[x.front > 0 ? 1 : 0];
        if (x.front == 0 || !(x.room > S(1.25) * x.side) || !boundary_.outlines->is_edge(size_t(x.element)))
            return false;
        return Base::distance(hiding) < x.t - S(0.02) * x.reach && !this->is_face_of(x.element, hiding.at);
    }

    // Shapes that the camera's rays pass: lights that are hidden, and boundaries of media that do not scatter.
    bool lets_through(uint32_t shape) const {
        const bool hidden = call_.config.hide_emitters && scene_.shapes[shape].emitter >= 0;
        return hidden || (call_.config.volumetric && passes_shadow_rays(scene_, shape));
    }
    // Whether an element is of such a shape, and nothing of it is seen.
    bool is_invisible(int32_t element) const {
        const uint32_t shape = boundary_.outlines->shape_of_element(scene_, size_t(element));
        return lets_through(shape) && (call_.config.hide_emitters || scene_.shapes[shape].emitter < 0);
    }

    // The share of g that the end of the ray past an outline has, to whose surface it is glued; 0 at infinity.
    S add_end(const Sight &x, const V &g) {
        const OutlineRay &ray = rays_[2 * size_t(&x - sights_.data()) + (x.front > 0 ? 0 : 1)];
        if (ray.at.shape == NoHit) return 0;
        const V end = ray.met_from + ray.d * ray.t;
        const S tau = x.distance / (x.distance - x.t + dot(end - ray.o, ray.d));
        this->add_glued(x.slot, ray.at, end, g * -tau);
        return tau;
    }

    // Of a rim, which moves with its face (glued points do, too) and over it.
    void add_to_rim(const Sight &x, const V &g, PointSink<F> &sink) {
        const OutlineSet &set = *boundary_.outlines;
        const uint32_t face = set.face(size_t(x.element));
        const RimPoint<S> rim = outlines_.rim_point(x.element, x.s, x.origin, parallel());
        const S rate = dot(g, rim.slope);
        const V with_face = boundary_.glued ? V{S(0), S(0), S(0)} : g, turn = rim.N * rate;
        const V material = parallel() ? with_face : with_face + turn;
        const bool wanted = sink.wants(set.shape_of_face(face));
        for (size_t i = 0; i < 3 && wanted; ++i) {
            const uint32_t vertex = scene_.faces[3 * size_t(face) + i];
            sink.vertex(vertex, material * rim.b[i]);
            sink.vertex(vertex, rim.w * (-rate * rim.b[i]), VertexArray::Normals);
        }
        this->anchors_.p_bar.set(x.slot, material);
        this->anchors_.d.set(x.slot, with_face * -x.distance + (parallel() ? turn : V{S(0), S(0), S(0)}));
    }

    template <class Weight>
    void add(uint32_t n, GradientSink<F> &sink, Weight &&weight) {
        const auto &p_bar = this->anchors_.p_bar, &d_bar = this->anchors_.d;
        for (uint32_t k = 0; k < n; ++k) p_bar.set(k, {S(0), S(0), S(0)}), d_bar.set(k, {S(0), S(0), S(0)});
        PointSink<F> points{sink};
        for (const Sight &x : sights_) {
            const S w = weight(x);
            if (w == 0 || !std::isfinite(w)) continue;
            const V g = x.n * w;
            points.derivative = 0;
            if (is_rim(x)) {
                add_to_rim(x, g, points);
            } else {
                this->add_to_outline(x.slot, x.element, x.s, x.b, g, points);
                p_bar.set(x.slot, boundary_.glued ? g * (1 - add_end(x, g)) : g);
                if (!boundary_.glued) d_bar.set(x.slot, g * -x.distance);
            }
            if (sink.forward) paths_.slots.radiance[0][x.slot] += points.derivative;
        }
        this->sweep_glued(sink, paths_.slots);
        if (!paths_.wavefront.needs().camera) return;
        for (uint32_t i = 0; i < n; i += W) {
            Entries<F> from(i);
            const Vec3<F> g = from(p_bar);
            M active = mask<F>(lane_index<F>() < U(n - i)) && mask<F>(max_abs(g) + max_abs(from(d_bar)) > F(0));
            if (!any(active)) continue;
            sink.begin();
            const CameraSample<F> at = camera_sample<F>(path_call_.config, sensor(), paths_.slots, from);
            const RayAdjoint<F> ray{-g, from(d_bar)};
            sweep_camera(scene_, sensor(), at, S(call_.film_width), S(call_.film_height), ray, F(0), active, sink);
            if (sink.forward) add_to_entries<F>(paths_.slots.radiance, U(i) + lane_index<F>(), sink.derivative, active);
        }
    }
};

// Of radiance, or Stokes vectors, and coverage.
template <class F>
class SilhouetteTile : public SightTile<F> {
    using Base = SightTile<F>;
    using Base::call_, Base::light_, Base::paths_, Base::sights_, Base::rays_, Base::lengths_;

public:
    using Base::Base;

    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, const Stop &stop) {
        Base::run(first, n, sink, [&] { look_up(stop); });
    }

private:
    void look_up(const Stop &stop) {
        using S = ScalarOf<F>;
        std::vector<S> pdf(rays_.size(), S(0));
        std::vector<uint32_t> key(rays_.size()), seen(rays_.size(), 0u);
        for (size_t i = 0; i < rays_.size(); ++i) key[i] = paths_.slots.pixel[sights_[i / 2].slot];
        BoundaryTile<F>::look_up(rays_, lengths_, pdf, key, seen, 0, !call_.config.hide_emitters, stop);
        light_.to_channels();
        for (int c = 0; c <= call_.numbers(); ++c) {
            const auto slots = this->of_part(light_.slots, c < call_.numbers() ? c / call_.values : 0);
            const S *values = c < call_.numbers() ? slots.radiance[c % call_.values] : slots.alpha.at;
            for (size_t k = 0; k < sights_.size(); ++k)
                this->set_jump(k, size_t(c), double(values[2 * k]), double(values[2 * k + 1]));
        }
    }
};

}  // namespace tr
