// What is rendered and in which order: tile schedules, items on threads, merging, filters.
#include <map>
#include <random>
#include <stdexcept>
#include <thread>

#include "cpu/allocation.h"
#include "cpu/splat.h"
#include "cpu/work_items.h"
#include "harness.h"

namespace tr::testing {

namespace {

using Sample = std::array<int64_t, 3>;  // row, column, number

struct Columns {
    std::vector<uint32_t> storage;
    uint32_t *row, *column, *pixel, *sample;
    explicit Columns(size_t n) : storage(4 * n) {
        row = storage.data(), column = row + n, pixel = column + n, sample = pixel + n;
    }
};

RenderCall<float> call_of(const Rect &crop, const Rect &window, int64_t spp, const Filter &filter) {
    RenderCall<float> call{};
    call.crop = crop, call.samples = window;
    call.filter = filter;
    call.spp = spp;
    call.threads = 1;
    return call;
}

// All samples of a call in their order, with the number of the unit that each is summed into.
std::vector<std::pair<Sample, size_t>> samples_of(const RenderCall<float> &call, size_t capacity, size_t *items) {
    TileSchedule schedule = make_schedule(call);
    Columns to(capacity);
    std::vector<std::pair<Sample, size_t>> all;
    size_t units = 0;
    for (size_t item = 0; item < schedule.n_items(); ++item) {
        for_batches(
            to, call, schedule, item, capacity, [] { return false; },
            [&](size_t n, const std::vector<Span> &spans) {
                size_t covered = 0;
                for (const Span &s : spans) {
                    CHECK(s.begin == covered && s.end > s.begin);
                    covered = s.end;
                    for (size_t k = s.begin; k < s.end; ++k)
                        all.push_back({{int32_t(to.row[k]), int32_t(to.column[k]), to.sample[k]}, units + s.unit});
                }
                CHECK(covered == n && n <= capacity);
            });
        units += schedule.work_item(item).size();
    }
    if (items) *items = schedule.n_items();
    return all;
}

const Filter box(FilterKind::Box, 0.5), tent(FilterKind::Tent, 1.5);

}  // namespace

TR_TEST(every_sample_is_drawn_once) {
    for (int64_t spp : {1, 7, 64, 65, 200})
        for (Rect crop : {Rect{0, 0, 1, 1}, Rect{0, 0, 37, 21}, Rect{13, 30, 19, 35}, Rect{-2, -3, 5, 9}}) {
            std::map<Sample, int> times;
            for (auto &[s, unit] : samples_of(call_of(crop, crop, spp, box), 100, nullptr)) ++times[s];
            CHECK(times.size() == size_t(crop.height() * crop.width()) * size_t(spp));
            for (auto &[s, n] : times) CHECK(n == 1 && crop.contains(int(s[0]), int(s[1])) && s[2] < spp);
        }
}

TR_TEST(pixels_with_numbers_of_their_own_draw_as_many) {
    const Rect film{0, 0, 40, 50};
    std::mt19937 random(7);
    std::vector<Pixel> list;
    for (int i = 0; i < 30; ++i) list.push_back({int32_t(random() % 40), int32_t(random() % 50)});
    for (bool as_list : {false, true})
        for (uint32_t most : {0u, 1u, 3u, 500u, 100000u}) {
            RenderCall<float> call = call_of({11, 14, 20, 36}, film, 5, tent);
            if (as_list) call.pixels = &list;
            TileSchedule schedule = make_schedule(call);
            std::map<std::array<int, 2>, uint32_t> wanted;
            std::vector<uint32_t> counts;
            for (size_t t = 0; t < schedule.n_tiles(); ++t)
                for (size_t i = 0; i < schedule.tile(t).n; ++i) {
                    Pixel p = schedule.tile(t).pixel(i);
                    // one pixel in sixteen has many
                    counts.push_back(most ? uint32_t(random()) % (random() % 16 ? 3 : most) : 0);
                    wanted[{p.y, p.x}] = counts.back();
                }
            schedule.allocate(counts);
            Columns to(256);
            std::map<Sample, int> times;
            std::map<std::array<int, 2>, double> weights;
            for (size_t item = 0; item < schedule.n_items(); ++item) {
                size_t paths = 0;
                for_batches(
                    to, call, schedule, item, 256, [] { return false; },
                    [&](size_t n, const std::vector<Span> &spans) {
                        paths += n;
                        size_t covered = 0;
                        for (const Span &s : spans) {
                            CHECK(s.begin == covered && s.end > s.begin);
                            covered = s.end;
                            for (size_t k = s.begin; k < s.end; ++k) {
                                CHECK(to.row[k] == to.row[s.begin] && to.column[k] == to.column[s.begin]);
                                ++times[{int32_t(to.row[k]), int32_t(to.column[k]), to.sample[k]}];
                                weights[{int32_t(to.row[k]), int32_t(to.column[k])}] += s.weight;
                            }
                        }
                        CHECK(covered == n);
                    });
                CHECK(paths <= size_t(TileSize * TileSize) * size_t(ChunkSize) + BatchSize);
            }
            size_t total = 0;
            for (auto &[pixel, n] : wanted) {
                total += n;
                CHECK(n == 0 || std::fabs(weights[pixel] - 5) < 1e-6);
            }
            CHECK(times.size() == total);
            for (auto &[s, n] : times) CHECK((n == 1 && s[2] < wanted[{int(s[0]), int(s[1])}]));
        }
}

TR_TEST(counts_are_in_proportion_and_add_up) {
    std::mt19937 random(11);
    std::exponential_distribution<double> size(1.0);
    for (double spp : {1.0, 2.0, 5.0, 64.0, 1e6}) {
        std::vector<double> importance(1000);
        for (double &q : importance) q = random() % 4 ? std::pow(size(random), 3) : 0;
        double sum = 0, active = 0, raised = 0, total = spp * 1000;
        for (double q : importance) sum += q, active += q > 0;
        for (double q : importance) raised += q > 0 ? std::max(q, AllocationFloor * sum / active) : 0;
        std::vector<uint32_t> counts = allocate_counts(importance, total);
        double drawn = 0;
        for (size_t i = 0; i < counts.size(); ++i) {
            drawn += counts[i];
            CHECK((counts[i] > 0) == (importance[i] > 0));
            double exact = total * std::max(importance[i], AllocationFloor * sum / active) / raised;
            if (spp >= 5 && importance[i] > 0) CHECK(std::fabs(counts[i] - exact) <= 1 + 1e-6 * exact);
        }
        CHECK(drawn == total);
    }
    CHECK(allocate_counts({2, 2, 2}, 15).empty());
    CHECK(allocate_counts({0, 0}, 4).empty());
    CHECK(allocate_counts({1, NAN}, 4).empty() && allocate_counts({1, INFINITY}, 4).empty());
    CHECK(allocate_counts({0, 1e300, 0}, 3e10) == (std::vector<uint32_t>{0, 0xffffffffu, 0}));
    CHECK(allocate_counts({}, 0).empty());
}

// What a part of a film draws for its pixels comes in the same order, summed in the same groups, as in the whole.
TR_TEST(parts_keep_the_order_of_the_whole) {
    const Rect film{0, 0, 40, 50};
    std::mt19937 random(3);
    for (const Filter &filter : {box, tent})
        for (int64_t spp : {3, 130}) {
            auto whole = samples_of(call_of(film, film, spp, filter), 1024, nullptr);
            std::vector<Pixel> list;
            for (int i = 0; i < 30; ++i) list.push_back({int32_t(random() % 40), int32_t(random() % 50)});
            RenderCall<float> calls[2] = {call_of({11, 14, 20, 36}, film, spp, filter),
                                          call_of(film, film, spp, filter)};
            calls[1].pixels = &list;
            for (const RenderCall<float> &call : calls) {
                auto part = samples_of(call, 77, nullptr);
                size_t at = 0;
                std::map<size_t, size_t> unit_of;  // a unit of the part is within one of the whole
                for (auto &[s, unit] : part) {
                    while (at < whole.size() && whole[at].first != s) ++at;
                    CHECK(at < whole.size());
                    if (at == whole.size()) return;
                    auto known = unit_of.emplace(unit, whole[at].second);
                    CHECK(known.first->second == whole[at].second);
                }
                std::map<size_t, int> uses;  // and no two of the part are in one
                for (auto &[unit, in_whole] : unit_of) CHECK(++uses[in_whole] == 1);
            }
        }
}

TR_TEST(a_list_has_what_its_pixels_need) {
    const Rect film{0, 0, 300, 300};
    std::vector<Pixel> list = {{299, 299}, {7, 100}, {7, 100}, {0, 0}, {8, 101}};
    RenderCall<float> call = call_of(film, film, 2, tent);
    call.pixels = &list;
    TileSchedule schedule = make_schedule(call);
    CHECK(schedule.n_results() == 5 && schedule.n_targets() == 4);
    for (size_t i = 0; i < list.size(); ++i) {
        Pixel p = schedule.target(schedule.target_of(i));
        CHECK(p.y == list[i].y && p.x == list[i].x);
    }
    std::map<Sample, int> drawn;
    for (auto &[s, unit] : samples_of(call, 1024, nullptr)) ++drawn[{s[0], s[1], 0}];
    size_t near = 0;
    for (int y = 0; y < 300; ++y)
        for (int x = 0; x < 300; ++x) {
            bool wanted = false;
            for (Pixel p : list) wanted |= std::abs(p.y - y) <= 1 && std::abs(p.x - x) <= 1;
            near += wanted;
            CHECK(drawn.count({y, x, 0}) == size_t(wanted));
        }
    CHECK(drawn.size() == near);
}

TR_TEST(lists_of_large_films_are_in_the_order_of_their_tiles) {
    std::mt19937 random(11);
    const int size = 1 << 16;
    std::vector<Pixel> list = {{0, 0}, {size - 1, size - 1}};
    for (int i = 0; i < 3000; ++i) list.push_back({int32_t(random() % size), int32_t(random() % size)});
    list.insert(list.end(), list.begin(), list.begin() + 500);  // once more
    const Rect film{0, 0, size, size};
    using Place = std::array<int, 4>;
    auto place = [](Pixel p) { return Place{p.y / TileSize, p.x / TileSize, p.y, p.x}; };
    std::map<Place, int> places;
    for (Pixel p : list) ++places[place(p)];
    for (const Rect &window : {film, Rect{-3, -3, size + 3, size + 3}}) {
        const TileSchedule schedule(list, window, 3, 1);
        CHECK(schedule.n_targets() == places.size() && schedule.n_results() == list.size());
        size_t i = 0;
        for (auto &[key, times] : places) CHECK(place(schedule.target(i++)) == key);
        for (i = 0; i < list.size(); ++i) CHECK(place(schedule.target(schedule.target_of(i))) == place(list[i]));
        // the tiles as well, whose rectangles are just around what they have
        Place last{-9, 0, 0, 0};
        std::vector<int> reached(schedule.n_targets());
        for (size_t t = 0; t < schedule.n_tiles(); ++t) {
            const Tile tile = schedule.tile(t);
            Rect box{size + 9, size + 9, -9, -9}, around = box;
            auto grow = [](Rect &r, Pixel p) {
                r = {std::min(r.y0, p.y), std::min(r.x0, p.x), std::max(r.y1, p.y + 1), std::max(r.x1, p.x + 1)};
            };
            for (size_t k = 0; k < tile.n; ++k) {
                const Pixel p = tile.pixel(k);
                const Place at{(p.y + TileSize) / TileSize - 1, (p.x + TileSize) / TileSize - 1, p.y, p.x};
                CHECK(last < at && window.contains(p.y, p.x));
                last = at;
                grow(box, p);
            }
            for (size_t k = 0; k < tile.n_targets; ++k) {
                ++reached[tile.targets[k]];
                grow(around, schedule.target(tile.targets[k]));
            }
            auto equal = [](const Rect &a, const Rect &b) {
                return a.y0 == b.y0 && a.x0 == b.x0 && a.y1 == b.y1 && a.x1 == b.x1;
            };
            CHECK(equal(tile.sampled, box) && equal(tile.reached, around));
        }
        for (int times : reached) CHECK(times >= 1 && times <= 4);
    }
}

TR_TEST(items_are_neither_tiny_nor_many) {
    size_t items = 0;
    // scattered single pixels share items
    std::vector<Pixel> list;
    for (int i = 0; i < 1000; ++i) list.push_back({17 * i, 31 * i});
    RenderCall<float> call = call_of({0, 0, 40000, 40000}, {0, 0, 40000, 40000}, 4, box);
    call.pixels = &list;
    CHECK(samples_of(call, 1024, &items).size() == 4000);
    CHECK(items <= 8);
    // one pixel with many samples is divided, without a table of its parts
    TileSchedule schedule({0, 0, 1, 1}, {0, 0, 1, 1}, 0, int64_t(1) << 32);
    CHECK(schedule.n_items() == (size_t(1) << 32) / BatchSize);
    WorkItem last = schedule.work_item(schedule.n_items() - 1);
    CHECK((last.chunk + last.chunks) * ChunkSize == int64_t(1) << 32);
}

const Filter wide_filters[] = {tent,
                               Filter(FilterKind::Tent, 0.3),
                               Filter(FilterKind::Tent, 1),
                               Filter(FilterKind::Gaussian, 0.5),
                               Filter(FilterKind::Gaussian, 3),
                               Filter(FilterKind::Mitchell, 1.0 / 3, 1.0 / 3),
                               Filter(FilterKind::Lanczos, 3)};

// In lanes of F, to so many roundings.
template <class F>
void check_splats(double tolerance) {
    using S = ScalarOf<F>;
    constexpr size_t N = 50;
    std::mt19937 random(5);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::vector<Filter> filters(std::begin(wide_filters), std::end(wide_filters));
    filters.push_back(box);
    for (const Filter &filter : filters) {
        FilmBlock a, b;
        const Rect rect{10, 20, 16, 27};
        a.reset(rect, 2);
        b.reset(rect, 2);
        for (double &x : b.sum) x = uniform(random);
        SampleBatch<S> batch(N);
        const auto &at = batch.columns;
        for (size_t i = 0; i < N; ++i) {
            at.row[i] = 8 + uint32_t(random() % 10), at.column[i] = 18 + uint32_t(random() % 11);
            at.film_y[i] = S(at.row[i]) + S(uniform(random)), at.film_x[i] = S(at.column[i]) + S(uniform(random));
        }
        size_t next = 1;
        for_film_places<F>(filter, at, 1, N, [&](size_t i, const FilmPlace<F> &place) {
            CHECK(i == next++);
            const int row = int(at.row[i]), column = int(at.column[i]);
            const S y = at.film_y[i], x = at.film_x[i];
            double v[2] = {uniform(random), 1}, w[2];
            std::fill(a.sum.begin(), a.sum.end(), 0.0);
            a.splat(place, v);
            b.collect(place, w);
            double forward = 0, total = 0;
            for (int j = rect.y0; j < rect.y1; ++j)
                for (int k = rect.x0; k < rect.x1; ++k) {
                    for (int c = 0; c < 2; ++c) forward += a.at(j, k)[c] * b.at(j, k)[c];
                    total += a.at(j, k)[2];
                    double expected = filter.reach() == 0 ? double(j == row && k == column)
                                                          : filter(j + 0.5 - double(y)) * filter(k + 0.5 - double(x));
                    CHECK_NEAR(a.at(j, k)[2], expected, tolerance);
                    if (filter.reach() > 0 && Lanes<F>::Width == 1)  // as devices have it
                        CHECK(a.at(j, k)[2] == double(filter.weight_of(j, y)) * double(filter.weight_of(k, x)));
                }
            CHECK_NEAR(forward, v[0] * w[0] + v[1] * w[1], 1e-12);
            CHECK(total >= 0 || filter(1.25) < 0);  // there are negative lobes
        });
        CHECK(next == N);
    }
}
TR_TEST(filters_are_splatted_and_collected_alike) {
    check_splats<double>(1e-14);
    check_splats<float>(4e-6);
    check_splats<PacketOf<float>>(4e-6);
}

// Samples that are near each other are splatted together: the same numbers, added in the same order. Several samples of
// a pixel, one a pixel in a row, and anywhere; blocks that end between them; one that is not finite and spoils no pixel
// that it does not reach.
template <class F>
void check_runs() {
    using S = ScalarOf<F>;
    constexpr int Usual = FilmBlock::Usual;
    constexpr size_t N = 75;
    std::mt19937 random(3);
    std::uniform_real_distribution<S> uniform(0, 1);
    for (const Filter &filter : wide_filters)
        for (int order = 0; order < 4; ++order) {
            FilmBlock together, apart, weights, single;
            const Rect rect{3, 4, 9, 12};
            for (FilmBlock *block : {&together, &apart}) block->reset(rect, Usual);
            for (FilmBlock *block : {&weights, &single}) block->reset(rect, 0);
            SampleBatch<S> batch(N);
            const auto &at = batch.columns;
            std::vector<S> values[Usual];
            S *columns[Usual];
            for (int c = 0; c < Usual; ++c) {
                for (size_t i = 0; i < N; ++i) values[c].push_back(uniform(random));
                columns[c] = values[c].data();
            }
            if (order == 3) values[1][40] = INFINITY;
            for (uint32_t i = 0; i < N; ++i) {
                at.row[i] = order == 1 ? i / 15 + 3 : order == 2 ? uint32_t(random() % 16) : i / 25 + 4;
                at.column[i] = order == 1 ? i % 15 : order == 2 ? uint32_t(random() % 16) : i / 9 + 3;
                at.film_y[i] = S(at.row[i]) + uniform(random), at.film_x[i] = S(at.column[i]) + uniform(random);
            }
            at.film_y[40] = S(at.row[40]) + S(0.5), at.film_x[40] = S(at.column[40]) + S(0.5);  // in all filters
            splat_span<F>(together, filter, at, 2, N, columns, Usual);
            int runs = 0;
            for_film_runs<F>(
                filter, at, 2, N,
                [&](size_t, const SplatAxes<F> &axes, int begin, int end) {
                    weights.add_weights(axes, begin, end);
                    return ++runs > 0;
                },
                [&](size_t, const FilmPlace<F> &place) { weights.add_weight(place, 1); });
            for_film_places<F>(filter, at, 2, N, [&](size_t i, const FilmPlace<F> &place) {
                double v[Usual];
                for (int c = 0; c < Usual; ++c) v[c] = double(values[c][i]);
                apart.splat(place, v);
                single.add_weight(place, 1);
            });
            CHECK((runs > 0) == (Lanes<F>::Width > 4 && order != 2) || Lanes<F>::Width == 4);
            CHECK(weights.sum == single.sum);
            int touched = 0, bad = 0;
            for (size_t i = 0; i < apart.sum.size(); ++i) {
                CHECK(together.sum[i] == apart.sum[i]);
                touched += apart.sum[i] != 0, bad += !std::isfinite(apart.sum[i]);
            }
            CHECK(touched > 0 && (bad > 0) == (order == 3));
        }
}
TR_TEST(runs_of_samples_are_splatted_as_single_ones) {
    check_runs<double>();
    check_runs<float>();
    check_runs<PacketOf<float>>();
}

// Of light paths, anywhere on the film and beside it, against the filter itself.
template <class F>
void check_splat_film(double tolerance) {
    using S = ScalarOf<F>;
    constexpr int N = 40;
    std::mt19937 random(7);
    std::uniform_real_distribution<double> uniform(0, 1);
    SplatAxes<F> axes;
    for (const Filter &filter : wide_filters) {
        const Rect rect{-2, 5, 9, 12};
        S xs[N], ys[N];
        for (int i = 0; i < N; ++i) xs[i] = S(1 + 15 * uniform(random)), ys[i] = S(-6 + 19 * uniform(random));
        axes.for_places(filter, xs, ys, N, true, [&](size_t i, int lane) {
            using Film = SplatFilm<S>;
            Film splatted(rect), moved(rect), adjoint(rect);
            typename Film::Vector value{S(uniform(random)), S(uniform(random)), S(-1), S(0)}, sum, by_x, by_y;
            const S dx = S(uniform(random)), dy = S(-0.5);
            for (int y = rect.y0; y < rect.y1; ++y)
                for (int x = rect.x0; x < rect.x1; ++x)
                    for (int c = 0; c < 3; ++c) adjoint.at(y, x)[c] = S(uniform(random));
            splatted.splat(axes.x, axes.y, lane, value);
            moved.splat_motion(axes.x, axes.y, lane, dx, dy, value);
            adjoint.collect(axes.x, axes.y, lane, sum, by_x, by_y);
            double expected[3][3] = {};  // sum, by_x, by_y
            for (int y = rect.y0; y < rect.y1; ++y)
                for (int x = rect.x0; x < rect.x1; ++x) {
                    const double u = x + 0.5 - double(xs[i]), v = y + 0.5 - double(ys[i]), w = filter(u) * filter(v),
                                 wx = -filter.slope(u) * filter(v), wy = -filter(u) * filter.slope(v);
                    for (int c = 0; c < 3; ++c) {
                        CHECK_NEAR(splatted.at(y, x)[c], w * double(value[c]), tolerance);
                        CHECK_NEAR(moved.at(y, x)[c], (wx * double(dx) + wy * double(dy)) * double(value[c]),
                                   tolerance);
                        const double a = double(adjoint.at(y, x)[c]);
                        expected[0][c] += w * a, expected[1][c] += wx * a, expected[2][c] += wy * a;
                    }
                }
            for (int c = 0; c < 3; ++c) {
                CHECK_NEAR(sum[c], expected[0][c], 20 * tolerance);
                CHECK_NEAR(by_x[c], expected[1][c], 20 * tolerance);
                CHECK_NEAR(by_y[c], expected[2][c], 20 * tolerance);
            }
        });
    }
}
TR_TEST(light_is_splatted_and_collected_alike) {
    check_splat_film<double>(1e-13);
    check_splat_film<float>(2e-5);
    check_splat_film<PacketOf<float>>(2e-5);
}

TR_TEST(an_exception_on_any_thread_is_the_callers) {
    for (int thrower : {0, 1, 3}) {
        bool interrupted = false;
        std::atomic<size_t> done{0};
        auto run = [&] {
            run_items(
                1 << 20, 4, Assignment::Interleaved, [](double) { return false; }, interrupted,
                [&](int thread) {
                    return [&, thread](size_t, const Stop &) {
                        if (thread == thrower) throw std::runtime_error("of a thread");
                        ++done;
                    };
                });
        };
        CHECK_THROWS(run(), std::runtime_error, "of a thread");
        CHECK(!interrupted);
    }
}

// The calling thread may have nothing to do while others are at work.
TR_TEST(an_idle_caller_polls) {
    bool interrupted = false;
    std::atomic<bool> asked{false};
    auto begin = std::chrono::steady_clock::now();
    run_items(
        2, 2, Assignment::Interleaved, [&](double) { return asked = true; }, interrupted,
        [&](int thread) {
            return [&, thread](size_t, const Stop &stop) {
                if (thread == 1)
                    while (!stop() && std::chrono::steady_clock::now() - begin < std::chrono::seconds(20))
                        std::this_thread::sleep_for(std::chrono::milliseconds(1));
            };
        });
    CHECK(interrupted && asked);
    CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds(10));
}

TR_TEST(variance_of_equal_weights_is_that_of_samples) {
    const double x[4] = {1, 2, 4, 9};
    double sum = 0, squares = 0;
    for (double v : x) sum += v, squares += v * v;
    CHECK_NEAR(variance_of_mean(sum, 4, squares, sum, 4), (9 + 4 + 0 + 25) / 3.0 / 4.0, 1e-12);
    CHECK_NEAR(variance_of_mean(0.5 * sum, 2, 0.25 * squares, 0.25 * sum, 1), (9 + 4 + 0 + 25) / 3.0 / 4.0, 1e-12);
    CHECK(std::isinf(variance_of_mean(3, 1, 9, 3, 1)));
    CHECK(std::isinf(variance_of_mean(0, 0, 0, 0, 0)));
}

}  // namespace tr::testing
