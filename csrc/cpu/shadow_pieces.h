// Pieces of outlines as small lights see them, from which the edges of shadows are chosen: all places on such a light
// see nearly the same ones, so that samples can be spread evenly along them, which a choice from the tree of outlines
// for each place on the light is not. Lights are small if their outlines are at least `Nearest` of their radii away.
#pragma once

#include <atomic>

#include "core/boundary/shadow_lights.h"
#include "core/state/queues.h"
#include "outline_cutter.h"

namespace tr {

// By emitter; without pieces the tree serves.
struct ShadowPieces {
    std::vector<OutlinePieces> of;
};

template <class S>
class ShadowCutter : OutlineCandidates<S> {
    using Base = OutlineCandidates<S>;
    using Base::outlines_, Base::scene_, Base::table_;
    using typename Base::V;
    static constexpr size_t MostLights = 8, MostEdges = size_t(1) << 16;  // beyond which looking at all takes long
    static constexpr S Nearest = 4;
    static constexpr S Angle = S(1) / 64;         // of a piece, or of its length to the scene's radius
    static constexpr int Most = 64, Fewest = 32;  // pieces of an outline, and of a curve
    const uint8_t *moves_;

public:
    ShadowCutter(const RenderCall<S> &call, const OutlineSet &set, const uint8_t *moves)
        : Base(*call.scene, set, call.threads), moves_(moves) {}

    ShadowPieces cut() const {
        ShadowPieces r;
        if (table_.n_edges > MostEdges || size_t(scene_.n_emitters) > MostLights) return r;
        r.of.resize(size_t(scene_.n_emitters));
        for (int32_t i = 0; i < scene_.n_emitters; ++i)
            if (scene_.emitter_pmf[i] > 0) r.of[size_t(i)] = cut_one(i);
        return r;
    }

private:
    struct Light {
        OutlineView<S> view;
        int32_t shape = -1;
        bool known = false;
    };

    OutlinePieces cut_one(int32_t emitter) const {
        const Light light = light_of(emitter);
        if (!light.known) return {};
        // lights at points, and infinitely far away, may move
        const float still = light.shape < 0 ? 0.2f : moves_[light.shape] ? 1.f : 0.05f;
        std::atomic<bool> close{false};
        OutlinePieces r = this->cut_all(
            light.view, still, false, [&](size_t, const auto &all, const auto &weights, OutlinePieces &to) {
                for (size_t k = 0; k < OutlineWide; ++k) {
                    if (!(weights[k] > 0)) continue;
                    const int32_t element = all.index[k];
                    if (table_.shape_of_element(scene_, size_t(element)) == uint32_t(light.shape)) continue;
                    if (!cut_element(light.view, element, weights[k], to)) close = true;
                }
            });
        return close ? OutlinePieces{} : r;
    }

    // Lights without extent, spheres, disks and rectangles, which do not shadow themselves.
    Light light_of(int32_t emitter) const {
        using F = PacketOf<S>;
        const EmitterKernels<F> &kernels = emitter_kernels<F>(scene_.emitters[emitter].kind);
        Light r;
        if (kernels.is(IsEnvironment) || kernels.is(IsBeam)) return r;
        if (!kernels.is(IsOnShape)) {
            EmissionSample<F> at = middle_of<F>(kernels, emitter);
            const Vec3<F> p = kernels.is(IsInfinite) ? at.d : at.p;
            r.view = {{lane(p.x), lane(p.y), lane(p.z)}, kernels.is(IsInfinite), S(0)};
            r.known = true;
            return r;
        }
        for (int32_t s = 0; s < scene_.n_shapes; ++s) {
            const ShapeInfo &info = scene_.shapes[s];
            if (info.emitter != emitter) continue;
            if (r.shape >= 0) return {};  // of several shapes
            r.shape = s;
            if (info.flags & (IsSphere | IsDisk)) {
                const S *m = scene_.shape_matrices + 24 * size_t(s);
                S square = 0;
                for (int i = 0; i < 3; ++i) square += m[4 * i] * m[4 * i] + m[4 * i + 1] * m[4 * i + 1];
                for (int i = 0; i < 3 && (info.flags & IsSphere); ++i) square += m[4 * i + 2] * m[4 * i + 2];
                r.view = {{m[3], m[7], m[11]}, false, std::sqrt(square)};
            } else if (!(info.flags & IsCurved) && info.n_faces == 2) {
                r.view = around_faces(info);
            } else {
                return {};
            }
            r.known = true;
        }
        return r;
    }
    static S lane(const PacketOf<S> &x) {
        alignas(64) S all[size_t(Lanes<PacketOf<S>>::Width)];
        store(&all[0], x);
        return all[0];
    }
    template <class F>
    EmissionSample<F> middle_of(const EmitterKernels<F> &kernels, int32_t emitter) const {
        const MaskOf<F> all(true);
        EmissionSample<F> r = unsampled_emission<F>(scene_, IntOf<F>(emitter), all);
        const F half(S(0.5));
        kernels.sample_emission(scene_, half, half, half, half, half, F(1), all, r);
        return r;
    }
    OutlineView<S> around_faces(const ShapeInfo &info) const {
        V corners[6], sum{S(0), S(0), S(0)};
        for (size_t i = 0; i < 6; ++i) {
            const S *p = scene_.vertices + VertexRow<S>::Size * size_t(scene_.faces[3 * size_t(info.face_offset) + i]);
            corners[i] = {p[0], p[1], p[2]}, sum = sum + corners[i];
        }
        OutlineView<S> r{sum * (S(1) / 6), false, S(0)};
        for (const V &p : corners) r.beside = std::max(r.beside, std::sqrt(dot(p - r.origin, p - r.origin)));
        return r;
    }

    // False if it is too close to the light.
    bool cut_element(const OutlineView<S> &view, int32_t element, float weight, OutlinePieces &to) const {
        if (outlines_.is_scattered(element)) {
            if (outlines_.may_be_seen(element, view, false)) Base::scatter(element, double(weight) * double(Angle), to);
            return true;
        }
        bool far = true;
        const S whole = length(view, element, S(0), S(1), 8, far);
        if (!far) return false;
        int n = int(std::min(std::ceil(whole / Angle), S(Most)));
        if (table_.is_curve(size_t(element))) n = std::max(n, Fewest);
        for (int i = 0; i < n; ++i) {
            const S begin = S(i) / S(n), end = S(i + 1) / S(n), piece = length(view, element, begin, end, 2, far);
            if (piece > 0) Base::add(element, begin, end, double(weight) * double(piece), to);
        }
        return far;
    }
    // The angle, of parallel light the length in radii of the scene, of a part of an outline.
    S length(const OutlineView<S> &view, int32_t element, S begin, S end, int steps, bool &far) const {
        S sum = 0;
        V before{};
        for (int i = 0; i <= steps; ++i) {
            const S s = begin + (end - begin) * S(i) / S(steps);
            V d = outlines_.place(element, s, view.origin, view.parallel);
            if (view.parallel) {
                d = (d - view.origin * dot(d, view.origin)) * (1 / scene_.radius);
            } else {
                d = d - view.origin;
                const S r = std::sqrt(dot(d, d));
                if (!(r > Nearest * view.beside) || !(r > 0)) far = false;
                d = d * (1 / std::max(r, S(1e-30)));
            }
            if (i > 0) sum += std::sqrt(dot(d - before, d - before));
            before = d;
        }
        return sum;
    }
};

}  // namespace tr
