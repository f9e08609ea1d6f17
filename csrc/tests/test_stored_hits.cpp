// Hits that are kept for the derivative: the order of queries, other batches, gaps, the limit.
#include <algorithm>
#include <random>

#include "accel/embree_library.h"
#include "cpu/stored_hits.h"
#include "harness.h"

namespace tr::testing {

namespace {

constexpr size_t Paths = 2500, Splits = 2, Recorded = 1000;

struct Query {
    uint32_t shape, primitive;
    float t;
    int shadow;  // -1: none
};
using Queries = std::vector<std::vector<Query>>;  // of each path's chains

Queries random_queries(std::mt19937 &random) {
    Queries all(Paths * Splits);
    for (auto &chain : all)
        for (size_t n = random() % 5; n > 0; --n)
            chain.push_back({random() % 4 ? uint32_t(random() % 1000) : Accel::Miss, uint32_t(random()),
                             float(random() % 100), int(random() % 3) - 1});
    return all;
}

struct Columns {
    std::vector<uint32_t> slot, shape, primitive;
    std::vector<float> t, b1, b2;
    std::vector<uint8_t> occluded;
    void resize(size_t n) {
        for (auto *v : {&slot, &shape, &primitive}) v->assign(n, 7u);
        for (auto *v : {&t, &b1, &b2}) v->assign(n, -1.f);
        occluded.assign(n, 9);
    }
    HitBatch hits() { return {shape.data(), primitive.data(), t.data(), b1.data(), b2.data()}; }
};

// As a tile does: level by level, those that have a query left, in any order.
template <class Level>
void for_levels(const Queries &all, size_t first, size_t n, size_t split, std::mt19937 &random, Level &&level) {
    for (size_t k = 0;; ++k) {
        std::vector<uint32_t> slots;
        for (size_t i = 0; i < n; ++i)
            if (all[(first + i) * Splits + split].size() > k) slots.push_back(uint32_t(i));
        if (slots.empty()) return;
        std::shuffle(slots.begin(), slots.end(), random);
        level(k, slots);
    }
}

void record(StoredHits &to, const Queries &all, std::mt19937 &random) {
    to.prepare(3, Recorded);
    HitRecorder recorder;
    Columns columns;
    for (size_t first = 0; first < Paths; first += Recorded) {
        size_t n = std::min(Recorded, Paths - first);
        if (to.wants_more()) recorder.begin(n, Splits);
        for (size_t split = 0; split < Splits && recorder.on(); ++split) {
            recorder.set_split(split);
            for_levels(all, first, n, split, random, [&](size_t k, const std::vector<uint32_t> &slots) {
                columns.resize(slots.size());
                columns.slot = slots;
                std::vector<uint32_t> shadow_slots;
                columns.occluded.clear();
                for (size_t i = 0; i < slots.size(); ++i) {
                    const Query &q = all[(first + slots[i]) * Splits + split][k];
                    columns.shape[i] = q.shape, columns.primitive[i] = q.primitive;
                    columns.t[i] = q.t, columns.b1[i] = q.t + 1, columns.b2[i] = q.t + 2;
                    if (q.shadow >= 0) shadow_slots.push_back(slots[i]), columns.occluded.push_back(uint8_t(q.shadow));
                }
                recorder.choose(slots.size(), [](size_t) { return true; });
                recorder.put(columns.slot.data(), columns.hits());
                recorder.put_shadows(shadow_slots.data(), columns.occluded.data(), shadow_slots.size());
            });
        }
        to.keep(1, recorder.finish());
    }
}

}  // namespace

TR_TEST(kept_hits_come_back_in_other_batches) {
    load_embree(embree_path());
    std::mt19937 random(5);
    Queries all = random_queries(random);
    int64_t before = StoredHits::in_use();
    {
        StoredHits kept(int64_t(1) << 30);
        record(kept, all, random);
        CHECK(kept.bytes() > 0 && StoredHits::in_use() - before == kept.bytes());
        Accel empty;  // what is not kept is traced, and meets nothing
        empty.commit();
        HitReplay replay;
        Columns columns;
        for (size_t batch : {size_t(77), size_t(256), Recorded, size_t(3000)})
            for (size_t first = 0; first < Paths; first += batch) {
                size_t n = std::min(batch, Paths - first);
                replay.begin(&kept, 1, first, n, Splits);
                for (size_t split = 0; split < Splits; ++split) {
                    replay.set_split(split);
                    for_levels(all, first, n, split, random, [&](size_t k, std::vector<uint32_t> slots) {
                        uint32_t gone = uint32_t(random() % n);  // a path that has one ray more than was kept
                        bool more = all[(first + gone) * Splits + split].size() == k;
                        if (more) slots.push_back(gone);
                        std::vector<float> numbers(slots.size(), 1.f);
                        const float *c = numbers.data();
                        RayBatch rays{{c, c, c}, {c, c, c}, c};
                        columns.resize(slots.size());
                        size_t traced = replay.intersect(empty, rays, slots.data(), columns.hits(), slots.size(), false,
                                                         [](size_t) { return true; });
                        CHECK(traced == size_t(more));
                        size_t shadows = 0, unknown = 0;
                        replay.occluded(empty, rays, slots.data(), columns.occluded.data(), slots.size());
                        for (size_t i = 0; i < slots.size() - more; ++i) {
                            const Query &q = all[(first + slots[i]) * Splits + split][k];
                            CHECK(columns.shape[i] == q.shape && columns.primitive[i] == q.primitive);
                            CHECK(columns.t[i] == q.t && columns.b1[i] == q.t + 1 && columns.b2[i] == q.t + 2);
                            CHECK(columns.occluded[i] == (q.shadow > 0 ? 1 : 0));
                            ++(q.shadow < 0 ? unknown : shadows);
                        }
                        CHECK(replay.occluded(empty, rays, slots.data(), columns.occluded.data(), slots.size()) ==
                              unknown + more);
                        if (more) CHECK(columns.shape.back() == Accel::Miss);
                    });
                }
            }
        replay.begin(nullptr, 0, 0, 5, 1);
        CHECK(!replay.on());
    }
    CHECK(StoredHits::in_use() == before);
}

TR_TEST(kept_hits_stay_below_the_limit) {
    std::mt19937 random(6);
    Queries all = random_queries(random);
    int64_t before = StoredHits::in_use();
    StoredHits everything(int64_t(1) << 30);
    record(everything, all, random);
    int64_t needed = everything.bytes();
    for (int64_t limit : {int64_t(0), int64_t(10), needed / 2, needed - 1, needed, 2 * needed}) {
        StoredHits some(before + needed + limit);  // beside what is there
        record(some, all, random);
        CHECK(some.bytes() <= limit);
        CHECK((some.bytes() == needed) == (limit >= needed));
        size_t found = 0, there = 0;
        for (size_t path = 0; path < Paths; ++path)
            for (size_t split = 0; split < Splits; ++split) {
                StoredHits::Chain chain = some.chain(1, path, Splits, split);
                size_t n = size_t(chain.end - chain.next);
                there += all[path * Splits + split].size();
                found += n;
                CHECK(n == 0 || n == all[path * Splits + split].size());
            }
        CHECK((found == there) == (limit >= needed) && (limit < needed / 2 || found > 0));
    }
}

}  // namespace tr::testing
