// Structures of arrays. What one entry holds is declared once, as a list of typed columns; from the list follow the
// pointers, reading, writing and appending packets, and whatever visits all columns (allocation, compaction, copies).
//
//   #define TR_RAY_COLUMNS(X) X(Vector, o) X(Vector, d) X(Number, length)
//   template <class S> struct RayColumns { TR_COLUMNS(TR_RAY_COLUMNS) };
//
// A column is plain pointers, so that a device's memory is as good as the host's.
#pragma once

#include <type_traits>

#include "../color/spectrum.h"
#include "../shape/surface.h"

namespace tr {

// ---------------------------------------------------------------------------------------------------- column types
// Visits the arrays of a column.
#define TR_EACH(...)                 \
    template <class Visit>           \
    void each(Visit &&visit) {       \
        __VA_ARGS__;                 \
    }                                \
    template <class Visit>           \
    void each(Visit &&visit) const { \
        __VA_ARGS__;                 \
    }

template <class S>
struct NumberColumn {
    S *at;
    TR_EACH(visit(at))
    TR_INLINE auto &operator[](size_t i) const { return at[i]; }
};
template <class S>
struct IndexColumn {
    uint32_t *at;
    TR_EACH(visit(at))
    TR_INLINE auto &operator[](size_t i) const { return at[i]; }
};
template <class S>
struct IntegerColumn {  // negative ones, too
    int32_t *at;
    TR_EACH(visit(at))
    TR_INLINE auto &operator[](size_t i) const { return at[i]; }
};
template <class S>
struct PairColumn {
    S *x, *y;
    TR_EACH(visit(x), visit(y))
};
template <class S>
struct VectorColumn {
    S *x, *y, *z;
    TR_EACH(visit(x), visit(y), visit(z))
    TR_INLINE Vec3<S> get(size_t i) const { return {x[i], y[i], z[i]}; }
    TR_INLINE void set(size_t i, const Vec3<S> &v) const { x[i] = v.x, y[i] = v.y, z[i] = v.z; }
};
template <class S>
struct SpectrumColumn {
    S *c[SpectrumSize];
    TR_EACH(for (auto &p : c) visit(p))
    TR_INLINE S *operator[](int i) const { return c[i]; }
};
template <class S>
struct PointColumn {  // on a surface
    uint32_t *shape, *primitive;
    S *b1, *b2;
    TR_EACH(visit(shape), visit(primitive), visit(b1), visit(b2))
    TR_INLINE void copy(size_t i, const PointColumn &from, size_t j) const {
        shape[i] = from.shape[j], primitive[i] = from.primitive[j], b1[i] = from.b1[j], b2[i] = from.b2[j];
    }
    TR_INLINE SurfacePoint<S> get(size_t i) const { return {shape[i], primitive[i], b1[i], b2[i]}; }
    TR_INLINE void set(size_t i, const SurfacePoint<S> &p) const {
        shape[i] = p.shape, primitive[i] = p.primitive, b1[i] = p.b1, b2[i] = p.b2;
    }
};

// What a packet holds of a column.
namespace packet {
template <class F>
using Number = F;
template <class F>
using Index = UIntOf<F>;
template <class F>
using Integer = IntOf<F>;
template <class F>
using Pair = Vec2<F>;
template <class F>
using Vector = Vec3<F>;
template <class F>
using Spectrum = tr::Spectrum<F>;
template <class F>
using Point = SurfacePoint<F>;
}  // namespace packet

#define TR_COLUMN_MEMBER(type, name) type##Column<S> name;
#define TR_COLUMN_VISIT(type, name) visit(name);
#define TR_PACKET_MEMBER(type, name) packet::type<F> name;
#define TR_COLUMN_APPEND(type, name) append_column<F>(columns.name, at, packet.name, m);
#define TR_COLUMN_WRITE(type, name) write(columns.name, at, packet.name);
#define TR_COLUMN_READ(type, name) packet.name = from(columns.name);

// The members of a struct of columns, template parameter S.
#define TR_COLUMNS(LIST)                                              \
    LIST(TR_COLUMN_MEMBER)                                            \
    template <class Visit>                                            \
    void for_columns(Visit &&visit) {                                 \
        LIST(TR_COLUMN_VISIT)                                         \
    }                                                                 \
    template <class Visit>                                            \
    void for_columns(Visit &&visit) const {                           \
        LIST(TR_COLUMN_VISIT)                                         \
    }                                                                 \
    /* visit(pointer) for every array; allocation assigns to it */    \
    template <class Visit>                                            \
    void for_arrays(Visit &&visit) {                                  \
        for_columns([&](auto &column) { column.each(visit); });       \
    }                                                                 \
    template <class Visit>                                            \
    void for_arrays(Visit &&visit) const {                            \
        for_columns([&](const auto &column) { column.each(visit); }); \
    }

// ------------------------------------------------------------------------------------------------- reading packets
// Accessors say where the lanes of a packet are; accessor(column) is what the packet holds of it.
template <class F, class Derived>
struct Accessor {
    using S = ScalarOf<F>;
    TR_INLINE F operator()(const NumberColumn<S> &c) const { return number(c.at); }
    TR_INLINE UIntOf<F> operator()(const IndexColumn<S> &c) const { return index(c.at); }
    TR_INLINE IntOf<F> operator()(const IntegerColumn<S> &c) const {
        return IntOf<F>(index(reinterpret_cast<const uint32_t *>(c.at)));
    }
    TR_INLINE Vec2<F> operator()(const PairColumn<S> &c) const { return {number(c.x), number(c.y)}; }
    TR_INLINE Vec3<F> operator()(const VectorColumn<S> &c) const { return {number(c.x), number(c.y), number(c.z)}; }
    TR_INLINE Spectrum<F> operator()(const SpectrumColumn<S> &c) const {
        Spectrum<F> r;
        for (int i = 0; i < SpectrumSize; ++i) r[i] = number(c[i]);
        return r;
    }
    TR_INLINE SurfacePoint<F> operator()(const PointColumn<S> &c) const {
        return {index(c.shape), index(c.primitive), number(c.b1), number(c.b2)};
    }

private:
    TR_INLINE F number(const S *p) const { return static_cast<const Derived *>(this)->get(p); }
    TR_INLINE UIntOf<F> index(const uint32_t *p) const { return static_cast<const Derived *>(this)->get(p); }
};

// Consecutive entries, from i on.
template <class F>
struct Entries : Accessor<F, Entries<F>> {
    size_t i;
    TR_INLINE explicit Entries(size_t i_) : i(i_) {}
    TR_INLINE F get(const ScalarOf<F> *p) const { return load<F>(p + i); }
    TR_INLINE UIntOf<F> get(const uint32_t *p) const { return load_uint<F>(p + i); }
};

// Any entries, in ascending order: loaded where they follow each other, picked from two packets where they are near,
// gathered otherwise. Columns have room for two packets behind their last entry.
template <class F>
struct LaneSet : Accessor<F, LaneSet<F>> {
    using U = UIntOf<F>;
    U index;  // into the column; once near, relative to `first`
    uint32_t first;
    enum { Consecutive, Near, Scattered } kind;
    MaskOf<F> active;

    // `order` holds the entries, of which the first `n` count.
    TR_INLINE LaneSet(const uint32_t *order, uint32_t n) {
        constexpr uint32_t W = uint32_t(Lanes<F>::Width);
        n = n < W ? n : W;
        active = mask<F>(lane_index<F>() < U(n));
        first = order[0];
        uint32_t distance = order[n - 1] - first;
        kind = distance == n - 1 ? Consecutive : distance < 2 * W ? Near : Scattered;
        index = select(mask<U>(active), load_uint<F>(order), U(first));
        if (kind == Near) index = index - U(first);
    }

    // Entries in any order, of which the first lane counts.
    TR_INLINE LaneSet(const U &entries, const MaskOf<F> &active_) : active(active_) {
        first = lane(entries, 0);
        index = select(mask<U>(active), entries, U(first));
        U offset = index - U(first);
        // not `offset < 2 W`: AVX-512 packets of Dr.Jit compare unsigned numbers as if they were signed
        bool near = all(mask<F>((offset & U(~uint32_t(2 * Lanes<F>::Width - 1))) == U(0u)));
        kind = near ? Near : Scattered;
        if (near) index = offset;
    }

    TR_INLINE F get(const ScalarOf<F> *column) const { return at<F>(column); }
    TR_INLINE U get(const uint32_t *column) const { return at<U>(column); }

private:
    template <class T, class S>
    TR_INLINE T at(const S *column) const {
        if constexpr (Lanes<F>::Width == 1) {
            return column[first];
        }
#if TR_HAS_PACKETS
        else {
            if (kind == Consecutive) return drjit::load<T>(column + first);
            if (kind == Near) return pick<T>(column + first, index);
            return drjit::gather<T>(column, index);
        }
#endif
    }
};

// Lanes of any entries, of which those that are not active give what they like.
template <class F>
struct Gathered : Accessor<F, Gathered<F>> {
    UIntOf<F> index;
    MaskOf<F> active;
    TR_INLINE Gathered(const UIntOf<F> &index_, const MaskOf<F> &active_) : index(index_), active(active_) {}
    TR_INLINE F get(const ScalarOf<F> *p) const { return gather<F>(p, index, active); }
    TR_INLINE UIntOf<F> get(const uint32_t *p) const { return gather<UIntOf<F>>(p, index, mask<UIntOf<F>>(active)); }
};

// ------------------------------------------------------------------------------------------------- writing packets
template <class F, class S>
TR_INLINE void write(const NumberColumn<S> &c, size_t i, const F &v) {
    store(c.at + i, v);
}
template <class U, class S>
TR_INLINE void write(const IndexColumn<S> &c, size_t i, const U &v) {
    store(c.at + i, v);
}
template <class I, class S>
TR_INLINE void write(const IntegerColumn<S> &c, size_t i, const I &v) {
    store(c.at + i, v);
}
template <class F, class S>
TR_INLINE void write(const PairColumn<S> &c, size_t i, const Vec2<F> &v) {
    store(c.x + i, v.x), store(c.y + i, v.y);
}
template <class F, class S>
TR_INLINE void write(const VectorColumn<S> &c, size_t i, const Vec3<F> &v) {
    store(c.x + i, v.x), store(c.y + i, v.y), store(c.z + i, v.z);
}
template <class F, class S>
TR_INLINE void write(const SpectrumColumn<S> &c, size_t i, const Spectrum<F> &v) {
    for (int k = 0; k < SpectrumSize; ++k) store(c[k] + i, v[k]);
}
template <class F, class S>
TR_INLINE void write(const PointColumn<S> &c, size_t i, const SurfacePoint<F> &v) {
    store(c.shape + i, v.shape), store(c.primitive + i, v.primitive);
    store(c.b1 + i, v.b1), store(c.b2 + i, v.b2);
}

// Where more entries begin, one for each lane of m: `n` is how many there are so far. Each thread appends to a queue of
// its own; those of a device have one entry each, and what is left of them is put together afterwards.
template <class F>
TR_INLINE uint32_t reserve(uint32_t &n, const MaskOf<F> &m) {
    const uint32_t before = n;
    n = before + uint32_t(count(m));
    return before;
}

// The lanes of m, one after the other from `at` on. (A column has room for a packet behind its last entry.)
template <class F, class T, class S>
TR_INLINE void append_array(S *p, size_t at, const T &v, const MaskOf<F> &m) {
#if defined(__CUDA_ARCH__)
    if (m) p[at] = S(v);
#else
    store_compressed<F>(p + at, v, m);
#endif
}
template <class F, class S>
TR_INLINE void append_column(const NumberColumn<S> &c, size_t at, const F &v, const MaskOf<F> &m) {
    append_array<F>(c.at, at, v, m);
}
template <class F, class S>
TR_INLINE void append_column(const IndexColumn<S> &c, size_t at, const UIntOf<F> &v, const MaskOf<F> &m) {
    append_array<F>(c.at, at, v, m);
}
template <class F, class S>
TR_INLINE void append_column(const IntegerColumn<S> &c, size_t at, const IntOf<F> &v, const MaskOf<F> &m) {
    append_array<F>(reinterpret_cast<uint32_t *>(c.at), at, UIntOf<F>(v), m);
}
template <class F, class S>
TR_INLINE void append_column(const VectorColumn<S> &c, size_t at, const Vec3<F> &v, const MaskOf<F> &m) {
    append_array<F>(c.x, at, v.x, m), append_array<F>(c.y, at, v.y, m), append_array<F>(c.z, at, v.z, m);
}
template <class F, class S>
TR_INLINE void append_column(const SpectrumColumn<S> &c, size_t at, const Spectrum<F> &v, const MaskOf<F> &m) {
    for (int k = 0; k < SpectrumSize; ++k) append_array<F>(c[k], at, v[k], m);
}

// Writes lanes to any entries; no two of them have one entry.
template <class F, class T, class S>
TR_INLINE void scatter_lanes(S *column, const UIntOf<F> &entry, const T &value, const MaskOf<F> &m) {
    if constexpr (Lanes<F>::Width == 1) {
        if (m) column[entry] = S(value);
    }
#if TR_HAS_PACKETS
    else
        drjit::scatter(column, value, entry, drjit::mask_t<T>(m));
#endif
}

// Adds a spectrum a lane to entries; several lanes may have one of them.
template <class F, class S>
TR_INLINE void add_to_entries(const SpectrumColumn<S> &column, const UIntOf<F> &entry, const Spectrum<F> &value,
                              const MaskOf<F> &m) {
    constexpr int W = Lanes<F>::Width;
    alignas(64) uint32_t e[W], set[W];
    alignas(64) S v[SpectrumSize][W];
    store(&e[0], entry);
    store(&set[0], select(mask<UIntOf<F>>(m), UIntOf<F>(1u), UIntOf<F>(0u)));
    for (int c = 0; c < SpectrumSize; ++c) store(&v[c][0], value[c]);
    for (int i = 0; i < W; ++i)
        if (set[i])
            for (int c = 0; c < SpectrumSize; ++c) accumulate(&column[c][e[i]], v[c][i]);
}

// -------------------------------------------------------------------------------------------------- whole entries
// What a packet holds of a list of columns, and how it is written, appended and read, whatever else is beside them.
#define TR_PACKET(Name, LIST)                                                                                   \
    template <class F>                                                                                          \
    struct Name {                                                                                               \
        LIST(TR_PACKET_MEMBER)                                                                                  \
    };                                                                                                          \
    template <class F, class Columns>                                                                           \
    TR_INLINE void write(const Columns &columns, size_t at, const Name<F> &packet) {                            \
        LIST(TR_COLUMN_WRITE)                                                                                   \
    }                                                                                                           \
    template <class F, class Columns>                                                                           \
    TR_INLINE void append_lanes(const Columns &columns, size_t at, const Name<F> &packet, const MaskOf<F> &m) { \
        LIST(TR_COLUMN_APPEND)                                                                                  \
    }                                                                                                           \
    template <class F, class Columns, class From>                                                               \
    TR_INLINE void read(const Columns &columns, const From &from, Name<F> &packet) {                            \
        LIST(TR_COLUMN_READ)                                                                                    \
    }

// Appends the lanes of m to a queue, which counts its entries in `n`; returns where they begin.
template <class F, class Queue, template <class> class Packet>
TR_INLINE uint32_t append(Queue &queue, const Packet<F> &packet, const MaskOf<F> &m) {
    uint32_t at = reserve<F>(queue.n, m);
    append_lanes(queue, at, packet, m);
    return at;
}

}  // namespace tr
