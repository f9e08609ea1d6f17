// Rays in a tree. What is hit depends neither on the tree nor on the order in which it is walked: an item counts only
// where its own box is met, in the interval in which that is, and the boxes around it are computed by the same
// monotonic steps from wider numbers. Of hits at one distance the smallest (shape, primitive) counts.
//
// Sums and products round one by one (-ffp-contract=off, -fmad=false): of two triangles one edge is the same number.
#pragma once

#include "core/scene.h"
#include "core/shape/quadric_hit.h"
#include "tree.h"

namespace tr {

// One ray; see RayBatch for those that are none.
class TreeRay {
public:
    TR_HD TreeRay(const TreeView &tree, const float *o, const float *d, float tmax) : tmax_(tmax) {
        constexpr float Largest = 3.4028235e38f;
        const float squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], sum = o[0] + o[1] + o[2];
        valid_ = squared > 0 && squared <= Largest && sum - sum == 0 && tmax >= 0 && tree.n_items != 0;
        // Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013: corners are moved along the
        // ray with errors relative to their distance, and boxes are as much wider.
        float extent = 0;
        for (int k = 0; k < 3; ++k) {
            o_[k] = o[k], d_[k] = d[k];
            extent = larger(extent, larger(magnitude(tree.lower[k] - o[k]), magnitude(tree.upper[k] - o[k])));
            // finite, so that nothing times it is NaN
            const float inverse = 1 / d[k];
            inverse_[k] = d[k] == 0 ? Largest : larger(-Largest, smaller(inverse, Largest));
        }
        const float margin = extent * (10 * HalfUlp);
        for (int k = 0; k < 3; ++k) {
            o_low_[k] = o[k] + margin;  // for lower sides
            o_high_[k] = o[k] - margin;
        }
        const float x = magnitude(d[0]), y = magnitude(d[1]), z = magnitude(d[2]);
        kz_ = x > y ? (x > z ? 0 : 2) : (y > z ? 1 : 2);
        kx_ = kz_ == 2 ? 0 : kz_ + 1;
        ky_ = kx_ == 2 ? 0 : kx_ + 1;
        const float along = pick(d, kz_);
        sx_ = pick(d, kx_) / along, sy_ = pick(d, ky_) / along, sz_ = 1 / along;
    }

    TR_HD bool valid() const { return valid_; }
    TR_HD float tmax() const { return tmax_; }

    // The interval in which the ray is in a box, and whether it begins before `limit` ends.
    TR_HD bool meets(const float *lower, const float *upper, float limit, float &enter, float &leave) const {
        enter = 0, leave = tmax_;
        for (int k = 0; k < 3; ++k) {
            const float a = (lower[k] - o_low_[k]) * inverse_[k], b = (upper[k] - o_high_[k]) * inverse_[k];
            const bool back = inverse_[k] < 0;
            enter = larger(enter, (back ? b : a) * (1 - 8 * HalfUlp));
            leave = smaller(leave, (back ? a : b) * (1 + 8 * HalfUlp));
        }
        return enter <= leave && enter <= limit;
    }

    // Whether an item is hit, by a hit that is nearer than `best`, or as near and of a smaller number; it replaces it.
    TR_HD bool hit(const TreeView &tree, const TreeItem &item, TreeHit &best) const {
        float enter, leave, lower[3], upper[3];
        const bool triangle = !(facts::ShapeFlags & IsCurved) || item.kind == TreeKind::Triangle;
        for (int k = 0; k < 3; ++k) {
            const float a = item.p[0][k], b = item.p[1][k], c = triangle ? item.p[2][k] : a;
            lower[k] = smaller(a, smaller(b, c)), upper[k] = larger(a, larger(b, c));
        }
        if (!meets(lower, upper, best.t, enter, leave)) return false;
        TreeHit found{item.shape, item.primitive, 0, 0, 0};
        const bool field = (facts::ShapeFlags & IsHeightField) && item.kind == TreeKind::HeightField;
        const bool grid = (facts::ShapeFlags & IsSdfGrid) && item.kind == TreeKind::SdfGrid;
        const bool met = triangle ? meet_triangle(item, found)
                         : field  ? meet_field(tree, item, found)
                         : grid   ? meet_grid(tree, item, found)
                                  : meet_quadric(tree, item, found);
        if (!met) return false;
        found.t = larger(enter, smaller(found.t, leave));
        if (!(found.t > 0 && found.t < tmax_ && found.t <= best.t)) return false;
        if (found.t == best.t &&
            (found.shape > best.shape || (found.shape == best.shape && found.primitive >= best.primitive)))
            return false;
        best = found;
        return true;
    }

private:
    static constexpr float HalfUlp = 5.9604645e-8f;  // 2^-24, the largest relative error of a rounded number
    float o_[3], d_[3], inverse_[3], o_low_[3], o_high_[3], tmax_, sx_, sy_, sz_;
    int kx_, ky_, kz_;
    bool valid_;

    TR_HD static float smaller(float a, float b) { return a < b ? a : b; }
    TR_HD static float larger(float a, float b) { return a > b ? a : b; }
    TR_HD static float magnitude(float a) { return a < 0 ? -a : a; }
    // v[k]; an index that is not constant would put v into a device's memory
    TR_HD static float pick(const float *v, int k) { return k == 0 ? v[0] : k == 1 ? v[1] : v[2]; }

    // Woop and others: the corners, seen along the ray, are on the sides of three edges.
    TR_HD bool meet_triangle(const TreeItem &item, TreeHit &found) const {
        const float o[] = {pick(o_, kx_), pick(o_, ky_), pick(o_, kz_)};
        float x[3], y[3], z[3];
        for (int c = 0; c < 3; ++c) {
            const float *p = item.p[c], along = pick(p, kz_) - o[2];
            x[c] = pick(p, kx_) - o[0] - sx_ * along;
            y[c] = pick(p, ky_) - o[1] - sy_ * along;
            z[c] = sz_ * along;
        }
        // A sum that is not 0 has the right sign: most triangles are not met.
        const float u = x[2] * y[1] - y[2] * x[1], v = x[0] * y[2] - y[0] * x[2], w = x[1] * y[0] - y[1] * x[0];
        if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0)) return false;
        // In double precision products are exact, which decides what is on an edge or very near, and weights are good
        // where corners are far away.
        auto edge = [&](int a, int b) { return double(x[a]) * double(y[b]) - double(y[a]) * double(x[b]); };
        return weigh(edge(2, 1), edge(0, 2), edge(1, 0), z, found);
    }

    TR_HD static bool weigh(double u, double v, double w, const float *z, TreeHit &found) {
        if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0)) return false;
        const double sum = u + v + w;
        if (sum == 0) return false;
        found.t = float((u * double(z[0]) + v * double(z[1]) + w * double(z[2])) / sum);
        found.b1 = float(v / sum), found.b2 = float(w / sum);
        return found.t == found.t;  // else numbers were too large
    }

    // The ray in a shape's own frame.
    struct Local {
        Vec3<float> o, d;
    };
    TR_HD Local local(const TreeView &tree, const TreeItem &item) const {
        float to_object[12];
        for (int k = 0; k < 12; ++k) to_object[k] = float(tree.matrices[item.shape].to_object[k]);
        return {transform_point(to_object, Vec3<float>{o_[0], o_[1], o_[2]}),
                transform_vector(to_object, Vec3<float>{d_[0], d_[1], d_[2]})};
    }

    TR_HD bool meet_grid(const TreeView &tree, const TreeItem &item, TreeHit &found) const {
        const auto [o, d] = local(tree, item);
        SdfFound<float> at{tmax_, 0, 0, 0};
        if (!walk_sdf<false>(tree.grids[item.shape], o, d, tmax_, true, at)) return false;
        found.t = at.t, found.b1 = at.b1, found.b2 = at.b2, found.primitive = at.primitive;
        return true;
    }

    TR_HD bool meet_field(const TreeView &tree, const TreeItem &item, TreeHit &found) const {
        const HeightTable &field = tree.fields[item.shape];
        const auto [o, d] = local(tree, item);
        found.t = tmax_;
        return field.linear ? walk_heights<2, false>(field, o, d, tmax_, true, found.t, found.b1, found.b2)
                            : walk_heights<4, false>(field, o, d, tmax_, true, found.t, found.b1, found.b2);
    }

    TR_HD bool meet_quadric(const TreeView &tree, const TreeItem &item, TreeHit &found) const {
        const UnitRay ray(tree.matrices[item.shape].to_object, o_, d_);
        found.t = item.kind == TreeKind::Sphere ? first_sphere_hit(ray, 0, tmax_)
                  : item.kind == TreeKind::Disk ? first_disk_hit(ray, 0, tmax_)
                                                : first_cylinder_hit(ray, 0, tmax_);
        return found.t > 0;
    }
};

// An entry of a table, by a device in loads of 16 bytes.
template <class T>
TR_HD inline T fetch(const T *entry) {
    static_assert(sizeof(T) % 16 == 0 && alignof(T) % 16 == 0);
#if defined(__CUDA_ARCH__)
    uint4 words[sizeof(T) / 16];
    for (unsigned i = 0; i < sizeof(T) / 16; ++i) words[i] = __ldg(reinterpret_cast<const uint4 *>(entry) + i);
    T found;
    memcpy(&found, words, sizeof(T));
    return found;
#else
    return *entry;
#endif
}

// The closest hit, or with `Any` some hit. A miss has the ray's length as its distance.
template <bool Any>
TR_HD TreeHit trace(const TreeView &tree, const float *o, const float *d, float tmax) {
    TreeHit best{TreeHit::Miss, 0, tmax, 0, 0};
    const TreeRay ray(tree, o, d, tmax);
    if (!ray.valid()) return best;
    uint32_t stack[TreeDepth];
    float distance[TreeDepth];  // at which the box is entered
    int n = 0;
    uint32_t at = 0;
    for (;;) {
        const TreeNode node = fetch(tree.nodes + at);
        float enter0, enter1, leave;
        bool in0 = ray.meets(node.lower[0], node.upper[0], best.t, enter0, leave);
        bool in1 = ray.meets(node.lower[1], node.upper[1], best.t, enter1, leave);
        for (int k = 0; k < 2; ++k) {
            if (!(k == 0 ? in0 : in1)) continue;
            const uint32_t begin = node.child[k], end = begin + node.count[k];
            for (uint32_t i = begin; i < end; ++i)
                if (ray.hit(tree, fetch(tree.items + i), best) && Any) return best;
        }
        in0 = in0 && node.count[0] == 0 && enter0 <= best.t;
        in1 = in1 && node.count[1] == 0 && enter1 <= best.t;
        // the nearer child first
        const bool second = in1 && (!in0 || enter1 < enter0);
        if (in0 && in1) stack[n] = second ? node.child[0] : node.child[1], distance[n] = second ? enter0 : enter1, ++n;
        if (in0 || in1) {
            at = second ? node.child[1] : node.child[0];
            continue;
        }
        do {
            if (n == 0) return best;
            at = stack[--n];
        } while (distance[n] > best.t);
    }
}

}  // namespace tr
