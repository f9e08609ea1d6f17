#include "bent_rays.h"

#include <algorithm>
#include <array>
#include <limits>
#include <memory>
#include <optional>

#include "core/adjoint/bend.h"
#include "host/parallel.h"
#include "packet_rows.h"
#include "zeros.h"

namespace tr {

namespace {

template <class F>
void put_state(BendInt<ScalarOf<F>> *to, const PacketRows<F> &rows, const BendState<F> &s) {
    constexpr size_t W = size_t(Lanes<F>::Width);
    for (size_t k = 0; k < 6; ++k) {
        alignas(64) BendInt<ScalarOf<F>> lanes[W];
        store(lanes, k < 3 ? s.q[k] : s.u[k - 3]);
        for (size_t i = 0; i < rows.count; ++i) to[6 * (rows.begin + i) + k] = lanes[i];
    }
}
template <class F>
BendState<F> get_state(const BendInt<ScalarOf<F>> *from, const PacketRows<F> &rows) {
    constexpr size_t W = size_t(Lanes<F>::Width);
    BendState<F> s;
    for (size_t k = 0; k < 6; ++k) {
        alignas(64) BendInt<ScalarOf<F>> lanes[W];
        for (size_t i = 0; i < W; ++i) lanes[i] = from[6 * (rows.begin + std::min(i, rows.count - 1)) + k];
        BendInt<F> &number = k < 3 ? s.q[k] : s.u[k - 3];
        if constexpr (W == 1) number = lanes[0];
#if TR_HAS_PACKETS
        else
            number = drjit::load<BendInt<F>>(lanes);
#endif
    }
    return s;
}
template <class F>
IntOf<F> get_steps(const int32_t *from, const PacketRows<F> &rows) {
    return IntOf<F>(rows.index(reinterpret_cast<const uint32_t *>(from)));
}

// Calls visit(rows, number of the thread) for packets of rows.
template <class F, class Visit>
void for_packets(size_t n, int threads, Visit &&visit) {
    constexpr size_t W = size_t(Lanes<F>::Width);
    for_ranges((n + W - 1) / W, threads,
               [&](size_t begin, size_t end, int thread) {
                   for (size_t p = begin; p < end; ++p) visit(PacketRows<F>(p * W, n), thread);
               },
               64);
}

// Calls visit with the number of coefficients along an axis.
template <class Visit>
void with_taps(bool quadratic, Visit &&visit) {
    if (quadratic)
        visit(std::integral_constant<int, 3>{});
    else
        visit(std::integral_constant<int, 4>{});
}

// Gradients by threads; the first one's is the result. `given`: the others' follow it, and stay there.
template <class S>
class Partials {
public:
    Partials(S *result, size_t n, int threads, bool given = false)
        : result_(result), n_(n), given_(given), others_(size_t(std::max(1, threads))) {}
    S *of(int thread) {
        if (thread == 0 || !result_) return result_;
        if (given_) return result_ + size_t(thread) * n_;
        auto &own = others_[size_t(thread)];
        if (!own) own = std::make_unique<Zeros<S>>(n_);
        return own->data();
    }
    // In the order of the threads.
    void add() {
        for (const auto &other : others_)
            if (other)
                for (size_t i = 0; i < n_; ++i) result_[i] += other->data()[i];
    }

private:
    S *result_;
    size_t n_;
    bool given_;
    std::vector<std::unique_ptr<Zeros<S>>> others_;
};

// A packet of flights.
template <int T, class F>
class Flight {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);

public:
    Flight(const BendMedium<S> &medium, const Accel &accel, const LightAlong<F> *light)
        : medium_(medium),
          light_(light),
          field_(medium.field),
          accel_(accel),
          bits_(position_bits<F>(medium.field)),
          reach_(to_fixed<S>(medium.reach, BendNumber<F>::Velocity)) {}

    FlightEnd<F> run(const Vec3<F> &q, const Vec3<F> &u, const Vec3<F> &offset, const MaskOf<F> &active) {
        MaskOf<F> live = active;
        begin(q, u, live);
        for (int32_t m = 0; any(live); ++m) {
            const MaskOf<F> inside = live && in_box(0, 1);
            MaskOf<F> gone = live && !inside;
            if (any(gone)) gone = gone && !in_box(1, 3);
            MaskOf<F> near = (live && !inside) || surface_near(medium_, at_.state, bits_, inside) || (live && fast());
            at_.shape = select(mask<U>(gone), U(BentTooFar), at_.shape);
            live = live && !gone;
            near = near && live;
            if (m == 0) skip_ = steps_off(offset);
            near = near || (live && MaskOf<F>(m == 0));
            if (any(near)) {
                query(near);
                live = live && mask<F>(at_.shape == U(BentTooLong));
            }
            if (m == medium_.max_steps || !any(live)) break;
            drift(at_.state, bits_, live);
            at_.steps = select(mask<I>(live), at_.steps + 1, at_.steps);
            kick_all(F(1), live);
            skip_ = max(F(0), skip_ - F(1));
        }
        return at_;
    }

    // Lanes that have gone astray, since they leave the medium near an edge, or grazing a surface, before surfaces
    // count: seen from the point off the surface. Others stay as they are in `otherwise`.
    FlightEnd<F> leave_at_once(const Vec3<F> &q, const Vec3<F> &u, const Vec3<F> &offset, const MaskOf<F> &lost,
                               const FlightEnd<F> &otherwise) {
        begin(q, u, lost);
        const Vec3<F> d = transform_vector(medium_.to_world, velocity_of(at_.state)),
                      o = transform_point(medium_.to_world, position_of(at_.state, bits_)) + offset;
        query(o, d, steps_off(offset) + F(1), F(0), lost);
        const MaskOf<F> found = lost && !mask<F>(at_.shape == U(BentTooLong));
        FlightEnd<F> r = otherwise;
        for (size_t k = 0; k < 3; ++k) {
            r.state.q[k] = select(mask<BendInt<F>>(found), at_.state.q[k], r.state.q[k]);
            r.state.u[k] = select(mask<BendInt<F>>(found), at_.state.u[k], r.state.u[k]);
        }
        r.steps = select(mask<I>(found), at_.steps, r.steps);
        r.shape = select(mask<U>(found), at_.shape, r.shape);
        r.primitive = select(mask<U>(found), at_.primitive, r.primitive);
        auto take = [&](const F &from, F &to) { to = select(found, from, to); };
        take(at_.optical, r.optical), take(at_.length, r.length);
        take(at_.t, r.t), take(at_.b1, r.b1), take(at_.b2, r.b2);
        r.light.depth = select(found, at_.light.depth, r.light.depth);
        r.light.emitted = select(found, at_.light.emitted, r.light.emitted);
        return r;
    }

private:
    const BendMedium<S> &medium_;
    const LightAlong<F> *light_;
    const BendField<S> &field_;
    const Accel &accel_;
    const int bits_;
    const BendInt<S> reach_;
    FlightEnd<F> at_;
    F skip_{0};  // steps from here on in which no surface counts

    // With half a kick.
    void begin(const Vec3<F> &q, const Vec3<F> &u, const MaskOf<F> &active) {
        start_bent(at_.state, q, u, bits_);
        at_.optical = at_.length = at_.b1 = at_.b2 = F(0), at_.t = F(S(INFINITY));
        at_.shape = U(BentTooLong), at_.primitive = U(0u), at_.steps = I(0);
        kick_all(F(S(0.5)), active);
    }

    void kick_all(const F &w, const MaskOf<F> &active) {
        const BendSlope<F> at = spline_slope<T, F>(field_, cell_at<T>(field_, at_.state, bits_), active);
        const F value = at.value + F(medium_.constant), weight = select(active, w, F(0)),
                n = refractive_index(at.value, medium_.constant);
        at_.optical = fmadd(weight, value, at_.optical);
        at_.length = fmadd(weight, n, at_.length);
        if (light_) at_.light.add(*light_, position_of(at_.state, bits_), n, weight, active);
        kick<F, false>(at_.state, symmetric_times<F>(field_.kick, at.slope) * w, active);
    }

    // Whether it is in the grid, grown by `margin` times its size on both sides to `whole` times.
    MaskOf<F> in_box(int margin, int whole) const {
        using Lane = BendLane<F>;
        MaskOf<F> r(true);
        for (int k = 0; k < 3; ++k) {
            const Lane n = Lane(field_.n[k]) << bits_;
            r = r && mask<F>(at_.state.q[k] >= BendInt<F>(-n * margin)) &&
                mask<F>(at_.state.q[k] < BendInt<F>(limit(n, whole - margin)));
        }
        return r;
    }
    static BendLane<F> limit(BendLane<F> n, int times) {
        const double all = double(n) * times, most = double(std::numeric_limits<BendLane<F>>::max());
        return all < most ? n * times : std::numeric_limits<BendLane<F>>::max();
    }
    // Whether a step is longer than blocks allow for.
    MaskOf<F> fast() const {
        MaskOf<F> r(false);
        for (const auto &u : at_.state.u) r = r || mask<F>(u > BendInt<F>(reach_)) || mask<F>(u < BendInt<F>(-reach_));
        return r;
    }

    // How far along the ray it is off its surface: as far as `offset` is, or, where it grazes it, some more.
    F steps_off(const Vec3<F> &offset) const {
        const Vec3<F> d = transform_vector(medium_.to_world, velocity_of(at_.state));
        const F off = norm(offset), speed = norm(d), usable = select(mask<F>(off > F(0)), off * speed, F(1));
        const F cosine = max(dot(offset, d) / usable, F(S(0.0625)));
        return select(mask<F>(off > F(0)), off / (cosine * max(speed, F(S(1e-30)))), F(0));
    }

    // The nearest surface along the step, and a little more, so that a surface between two steps is not missed.
    void query(const MaskOf<F> &active) {
        const Vec3<F> d = transform_vector(medium_.to_world, velocity_of(at_.state)),
                      o = transform_point(medium_.to_world, position_of(at_.state, bits_)) + d * skip_;
        query(o, d, F(S(1.0001)) - skip_, skip_, active);
    }
    // ... along a ray of this length in steps, of which `before` are behind it.
    TR_NOINLINE void query(const Vec3<F> &o, const Vec3<F> &d, const F &length, const F &before,
                           const MaskOf<F> &active) {
        alignas(64) S number[W];
        alignas(64) float ray[7][W], t[W], b1[W], b2[W];
        alignas(64) uint32_t shape[W], primitive[W];
        const F columns[7] = {o.x, o.y, o.z, d.x, d.y, d.z, select(active, length, F(-1))};
        for (size_t k = 0; k < 7; ++k) {
            store(number, columns[k]);
            for (size_t i = 0; i < W; ++i) ray[k][i] = float(number[i]);
        }
        accel_.intersect({{ray[0], ray[1], ray[2]}, {ray[3], ray[4], ray[5]}, ray[6]}, {shape, primitive, t, b1, b2}, W,
                         false);
        const U found = load_uint<F>(shape);
        const MaskOf<F> hit = active && mask<F>(found != U(Accel::Miss));
        at_.shape = select(mask<U>(hit), found, at_.shape);
        at_.primitive = select(mask<U>(hit), load_uint<F>(primitive), at_.primitive);
        auto take = [&](const float (&from)[W], F &to) {
            for (size_t i = 0; i < W; ++i) number[i] = S(from[i]);
            to = select(hit, load<F>(number), to);
        };
        take(t, at_.t), take(b1, at_.b1), take(b2, at_.b2);
        at_.t = select(hit, at_.t + before, at_.t);
    }
};

// A flight; and those that come to nothing as far as they leave the medium at once.
template <int T, class F>
FlightEnd<F> fly_by(const BendMedium<ScalarOf<F>> &medium, const Accel &accel, const Vec3<F> &q, const Vec3<F> &u,
                    const Vec3<F> &offset, const MaskOf<F> &active, const LightAlong<F> *light) {
    using U = UIntOf<F>;
    const FlightEnd<F> end = Flight<T, F>(medium, accel, light).run(q, u, offset, active);
    const MaskOf<F> lost = active && (mask<F>(end.shape == U(BentTooLong)) || mask<F>(end.shape == U(BentTooFar))) &&
                           mask<F>(squared_norm(offset) > F(0));
    return any(lost) ? Flight<T, F>(medium, accel, light).leave_at_once(q, u, offset, lost, end) : end;
}

}  // namespace

template <class F>
FlightEnd<F> fly(const BendMedium<ScalarOf<F>> &medium, const Accel &accel, const Vec3<F> &q, const Vec3<F> &u,
                 const Vec3<F> &offset, const MaskOf<F> &active, const LightAlong<F> *light) {
    return medium.quadratic ? fly_by<3, F>(medium, accel, q, u, offset, active, light)
                            : fly_by<4, F>(medium, accel, q, u, offset, active, light);
}

namespace {

template <class F>
LightAlong<F> along(const LightGrids<ScalarOf<F>> &grids, const Wavelengths<F> &waves) {
    return {grids.scene, grids.light, waves};
}

}  // namespace

template <class S>
void trace_bent(const BendMedium<S> &medium, const Accel &accel, const BentRays<S> &rays, const S *offset,
                const BentHits<S> &hits) {
    using F = PacketOf<S>;
    const int bits = position_bits<F>(medium.field);
    const Wavelengths<F> waves{};
    for_packets<F>(rays.n, rays.threads, [&](const PacketRows<F> &rows, int) {
        std::optional<LightAlong<F>> light;
        if (rays.light) light.emplace(along<F>(*rays.light, waves));
        const FlightEnd<F> end = fly<F>(medium, accel, rows.vector(rays.q), rows.vector(rays.u), rows.vector(offset),
                                        rows.active, light ? &*light : nullptr);
        if (light) rows.put(rays.depth, end.light.depth, 3), rows.put(rays.emitted, end.light.emitted, 3);
        rows.put(rays.last_q, position_of(end.state, bits));
        rows.put(rays.last_u, velocity_of(end.state));
        rows.put(rays.sums, Vec2<F>{end.optical, end.length});
        put_state(rays.state, rows, end.state);
        rows.put_integers(rays.steps, end.steps);
        rows.put_integers(hits.shape, end.shape), rows.put_integers(hits.primitive, end.primitive);
        rows.put(hits.t, end.t);
    });
}

template <class S>
void reverse_bent(const BentRays<S> &rays, const BentAdjoints<S> &adjoints) {
    using F = PacketOf<S>;
    Partials<S> partials(adjoints.values, rays.field.size(), rays.threads, rays.partials);
    struct Sums {
        std::array<double, 6> kick{};
        std::array<double, 12> maps[2]{};
    };
    std::vector<Sums> sums(size_t(std::max(1, rays.threads)));
    std::vector<Partials<S>> grids;
    for (int k = 0; k < 2; ++k) {
        const int32_t *n = rays.light ? rays.light->tensors[k].shape : nullptr;
        const size_t size = n ? size_t(n[0]) * size_t(n[1]) * size_t(n[2]) * size_t(n[3]) : 0;
        grids.emplace_back(rays.light ? adjoints.grids[k] : nullptr, size, rays.threads);
    }
    const Wavelengths<F> waves{};
    const int bits = position_bits<F>(rays.field);
    with_taps(rays.quadratic, [&](auto taps) {
        constexpr int T = decltype(taps)::value;
        for_packets<F>(rays.n, rays.threads, [&](const PacketRows<F> &rows, int thread) {
            S *values = partials.of(thread);
            const Vec2<F> ways = rows.pair(adjoints.sums);
            BendAdjoint<F> a{rows.vector(adjoints.last_q), rows.vector(adjoints.last_u), ways.x, ways.y};
            F all = max_abs(a.q) + max_abs(a.u) + abs(a.optical) + abs(a.length);
            BendState<F> s = get_state<F>(rays.state, rows);
            GradientSink<F> sink;
            double factor = 0;
            S *const tensors[2] = {grids[0].of(thread), grids[1].of(thread)};
            sink.constants = &factor, sink.tensors = tensors;
            std::optional<LightBack<F>> light;
            if (rays.light) {
                const Spectrum<F> depth_bar = rows.spectrum(adjoints.depth, 3),
                                  emitted_bar = rows.spectrum(adjoints.emitted, 3);
                light.emplace(LightBack<F>{along<F>(*rays.light, waves),
                                           sink,
                                           emitted_bar,
                                           depth_bar,
                                           rows.spectrum(rays.depth, 3),
                                           uniform_spectrum(F(0)),
                                           {},
                                           {}});
                all = all + max_component(depth_bar) + max_component(emitted_bar);
            }
            fly_back<T, F>(
                rays.field, rays.constant, s, bits, get_steps<F>(rays.steps, rows), a,
                rows.active && !mask<F>(all == F(0)),
                [&](const auto &at, const F &value, const Vec3<F> &slope, const MaskOf<F> &lanes) {
                    if (values) splat_spline(rays.field, at, value, slope, values, lanes);
                },
                light ? &*light : nullptr);
            rows.put(adjoints.q, a.q), rows.put(adjoints.u, a.u);
            Sums &own = sums[size_t(thread)];
            for (size_t k = 0; k < 6; ++k) own.kick[k] += double(lane_sum(a.kick[k]));
            if (!light) return;
            for (size_t k = 0; k < 12; ++k) {
                own.maps[0][k] += double(lane_sum(light->extinction.m[k]));
                own.maps[1][k] += double(lane_sum(light->emission.m[k]));
            }
        });
    });
    partials.add();
    for (Partials<S> &grid : grids) grid.add();
    for (const Sums &own : sums) {
        for (size_t k = 0; k < 6; ++k) adjoints.kick[k] += own.kick[k];
        for (size_t which = 0; which < 2; ++which)
            for (size_t k = 0; k < 12 && adjoints.maps[which]; ++k) adjoints.maps[which][k] += own.maps[which][k];
    }
}

template <class S>
void forward_bent(const BentRays<S> &rays, const BentTangents<S> &tangents) {
    using F = PacketOf<S>;
    using I = IntOf<F>;
    const Wavelengths<F> waves{};
    const int bits = position_bits<F>(rays.field);
    with_taps(rays.quadratic, [&](auto taps) {
        constexpr int T = decltype(taps)::value;
        for_packets<F>(rays.n, rays.threads, [&](const PacketRows<F> &rows, int) {
            BendTangent<F> d{rows.vector(tangents.q), rows.vector(tangents.u), F(0), F(0)};
            const Values<S> changes{nullptr, tangents.grids};
            std::optional<LightForward<F>> light;
            if (rays.light)
                light.emplace(
                    LightForward<F>{along<F>(*rays.light, waves), changes, tangents.maps[0], tangents.maps[1]});
            BendState<F> s;
            start_bent(s, rows.vector(rays.q), rows.vector(rays.u), bits);
            I left = get_steps<F>(rays.steps, rows);
            MaskOf<F> live = rows.active;
            for (F w(S(0.5)); any(live); w = F(1)) {
                kick_tangent<T, F>(rays.field, tangents.field, rays.constant, s, bits, w, d, live,
                                   light ? &*light : nullptr);
                live = live && mask<F>(left > I(0));
                left = left - 1;
                d.q = select(live, d.q + d.u, d.q);
                drift(s, bits, live);
            }
            rows.put(tangents.last_q, d.q), rows.put(tangents.last_u, d.u);
            rows.put(tangents.sums, Vec2<F>{d.optical, d.length});
            if (light) rows.put(tangents.depth, light->depth, 3), rows.put(tangents.emitted, light->emitted, 3);
        });
    });
}

namespace {

// Of the points of a packet: visit(rows, thread, the field there).
template <class S, class Visit>
void for_points(const BentRays<S> &rays, Visit &&visit) {
    using F = PacketOf<S>;
    const int bits = position_bits<F>(rays.field);
    with_taps(rays.quadratic, [&](auto taps) {
        constexpr int T = decltype(taps)::value;
        for_packets<F>(rays.n, rays.threads, [&](const PacketRows<F> &rows, int thread) {
            BendState<F> s;
            start_bent(s, rows.vector(rays.q), Vec3<F>{F(0), F(0), F(0)}, bits);
            visit(rows, thread, BendPoint<T, F>(rays.field, s, bits, rows.active));
        });
    });
}

}  // namespace

template <class S>
void evaluate_field(const BentRays<S> &rays, const FieldValues<S> &out) {
    for_points(rays, [&](const auto &rows, int, const auto &at) {
        rows.put(out.value, at.jet.value), rows.put(out.slope, at.jet.slope);
    });
}

template <class S>
void reverse_field(const BentRays<S> &rays, const FieldValues<S> &adjoints, S *q, S *values) {
    using F = PacketOf<S>;
    Partials<S> partials(values, rays.field.size(), rays.threads, rays.partials);
    for_points(rays, [&](const auto &rows, int thread, const auto &at) {
        const F value = rows.number(adjoints.value);
        const Vec3<F> slope = rows.vector(adjoints.slope);
        rows.put(q, at.jet.slope * value + symmetric_times<F>(at.jet.curve, slope));
        if (S *to = partials.of(thread)) splat_spline(rays.field, at, value, slope, to, rows.active);
    });
    partials.add();
}

template <class S>
void forward_field(const BentRays<S> &rays, const BentTangents<S> &tangents, const FieldValues<S> &out) {
    using F = PacketOf<S>;
    for_points(rays, [&](const auto &rows, int, const auto &at) {
        const Vec3<F> q = rows.vector(tangents.q);
        F value = dot(at.jet.slope, q);
        Vec3<F> slope = symmetric_times<F>(at.jet.curve, q);
        if (tangents.field.values) {
            const BendJet<F> change = at.jet_of(tangents.field, rows.active);
            value = value + change.value, slope = slope + change.slope;
        }
        rows.put(out.value, value), rows.put(out.slope, slope);
    });
}

#define TR_INSTANTIATE(S)                                                                                            \
    template FlightEnd<PacketOf<S>> fly(const BendMedium<S> &, const Accel &, const Vec3<PacketOf<S>> &,             \
                                        const Vec3<PacketOf<S>> &, const Vec3<PacketOf<S>> &,                        \
                                        const MaskOf<PacketOf<S>> &, const LightAlong<PacketOf<S>> *);               \
    template void LightSum<PacketOf<S>>::add(const LightAlong<PacketOf<S>> &, const Vec3<PacketOf<S>> &,             \
                                             const PacketOf<S> &, const PacketOf<S> &, const MaskOf<PacketOf<S>> &); \
    template void trace_bent(const BendMedium<S> &, const Accel &, const BentRays<S> &, const S *,                   \
                             const BentHits<S> &);                                                                   \
    template void reverse_bent(const BentRays<S> &, const BentAdjoints<S> &);                                        \
    template void forward_bent(const BentRays<S> &, const BentTangents<S> &);                                        \
    template void evaluate_field(const BentRays<S> &, const FieldValues<S> &);                                       \
    template void reverse_field(const BentRays<S> &, const FieldValues<S> &, S *, S *);                              \
    template void forward_field(const BentRays<S> &, const BentTangents<S> &, const FieldValues<S> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
