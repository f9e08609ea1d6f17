"""The numbers that samplers give: their formulas, uniformity, strata and elementary intervals."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from oracle import samplers as oracle

import torchrender as tr

SPREAD = ("stratified", "sobol")
PAIR = {0: (0, 1), 1: (1, 2), 2: (1, 2)}  # which two numbers of a block belong together
COARSE = 2.0**-24  # numbers are rounded down to multiples of it


def pixel_numbers(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return (rows + 32768).astype(np.uint32) << 16 | (columns + 32768).astype(np.uint32)


def pixels_of_many_tiles(n: int, place: int = 5) -> np.ndarray:
    """n x n pixels, each in a tile of its own, so that nothing of their numbers is shared."""
    at = np.arange(n) * oracle.TILE + place
    return pixel_numbers(*np.meshgrid(at, at, indexing="ij")).ravel()


def draw(
    sampler, count, pixels, samples=None, *, first=0, seed=7, sensor=0, block=1, wanted=4, dtype="float32"
) -> np.ndarray:
    """Numbers (pixels, samples, 4) of samples of a call that draws samples first .. first + count - 1."""
    samples = np.arange(count) + first if samples is None else samples
    p, s = np.broadcast_arrays(np.asarray(pixels)[:, None], np.asarray(samples)[None])
    p, s = np.ascontiguousarray(p, np.uint32), np.ascontiguousarray(s, np.uint32)
    out = np.empty((*p.shape, 4))
    addresses = (p.ctypes.data, s.ctypes.data, out.ctypes.data)
    tr.backends.core(f"torch.{dtype}").draw(
        sampler, first, count, seed, sensor, block, wanted, dtype, p.size, *addresses
    )
    return out


def assert_uniform(numbers: np.ndarray, tests: int) -> None:
    """Chi-square of N numbers in 64 bins, or of N pairs in 16 x 16; significance 0.01 of `tests` of them together."""
    bins = 64 if numbers.ndim == 1 else 256
    if numbers.ndim == 1:
        counts = np.histogram(numbers, bins, (0, 1))[0]
    else:
        counts = np.histogram2d(numbers[:, 0], numbers[:, 1], 16, ((0, 1), (0, 1)))[0]
    assert counts.sum() == len(numbers)
    expected = len(numbers) / bins
    statistic = float(((counts - expected) ** 2 / expected).sum())
    assert tr.testing.chi2_p_value(statistic, bins - 1) > 0.01 / tests


# -------------------------------------------------------------------------------------------------- the formulas
@pytest.mark.parametrize("sampler", tr.SAMPLERS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 16, 17, 50, 64, 100])
def test_numbers_are_those_of_the_formulas(sampler, count):
    pixels = pixel_numbers(np.array([0, 3, 65530, -7]), np.array([0, 17, 9, 40000]))
    for block, first, seed in itertools.product((0, 1, 2, 9), (0, 5), (0, 2**63 + 12345)):
        samples = np.arange(min(count, 6)) + first + count // 3
        samples = samples[samples < first + count]
        settings = {"first": first, "seed": seed, "sensor": 2, "block": block}
        found = draw(sampler, count, pixels, samples, **settings)
        expected = [
            [oracle.draw4(sampler, count, first, seed, 2, int(p), int(s), block) for s in samples] for p in pixels
        ]
        below = np.array(expected) - found
        assert below.min() > -(2.0**-30) and below.max() < COARSE + 2.0**-30
        assert np.array_equal(draw(sampler, count, pixels, samples, **settings, dtype="float64"), found)
        with pytest.MonkeyPatch.context() as patch:  # a number at a time
            patch.setattr(tr.backends, "PACKETS", False)
            assert np.array_equal(draw(sampler, count, pixels, samples, **settings), found)


@pytest.mark.parametrize("sampler", SPREAD)
@pytest.mark.parametrize("block", [0, 1])
def test_numbers_that_are_not_wanted_are_none(sampler, block):
    order = (0, 1, 2, 3) if block == 0 else (1, 2, 0, 3)
    everything = draw(sampler, 9, pixels_of_many_tiles(3), block=block)
    assert np.isfinite(everything).all()
    for wanted in (2, 3):
        found = draw(sampler, 9, pixels_of_many_tiles(3), block=block, wanted=wanted)
        assert np.array_equal(found[..., order[:wanted]], everything[..., order[:wanted]])
        assert np.isnan(found[..., order[2]]).all() == (wanted == 2)


def test_the_formula_of_the_sobol_sequence_is_that_of_torch():
    points = np.array([oracle.sobol_point(i) for i in range(256)]) / oracle.ONE
    theirs = torch.quasirandom.SobolEngine(4).draw(256, dtype=torch.float64).numpy()  # in the order of the Gray code
    assert sorted(map(tuple, points)) == sorted(map(tuple, theirs))


def test_one_stratum_is_no_constraint():
    pixels = pixels_of_many_tiles(20)
    for block in (0, 1):
        found, expected = (draw(s, 1, pixels, block=block) for s in ("stratified", "independent"))
        # the free number of a block is one of the other two there
        assert np.array_equal(found[..., list(PAIR[block])], expected[..., [0, 1]])
        assert np.array_equal(np.sort(found), np.sort(expected))


@pytest.mark.parametrize("sampler", tr.SAMPLERS)
def test_numbers_depend_on_everything_that_counts_them(sampler):
    settings = {"seed": 1, "sensor": 0, "block": 1, "first": 0}
    pixels = pixels_of_many_tiles(2)
    found = draw(sampler, 4, pixels, **settings)
    assert len(np.unique(found)) == found.size
    for name in ("seed", "sensor", "block"):
        assert not (draw(sampler, 4, pixels, **(settings | {name: 5})) == found).any(), name
    # a later call for further samples of the same pixels
    assert not (draw(sampler, 4, pixels, **(settings | {"first": 4})) == found).any()


# --------------------------------------------------------------------------------------------------- uniformity
@pytest.mark.parametrize("sampler", SPREAD)
@pytest.mark.parametrize("count", [1, 3, 4, 7, 16, 33])
def test_every_sample_is_uniform_by_itself(sampler, count):
    """That makes estimates unbiased. Over pixels that share nothing, for single samples, numbers and pairs of them."""
    pixels = pixels_of_many_tiles(160)
    samples = sorted({0, count // 2, count - 1})
    pairs = list(itertools.combinations(range(4), 2))
    u, v = (draw(sampler, count, pixels, samples, block=block) for block in (1, 2))
    for i in range(len(samples)):
        for k in range(4):
            assert_uniform(u[:, i, k], 26 * 36)
            for m in range(4):  # two blocks have nothing to do with each other
                assert_uniform(np.stack([u[:, i, k], v[:, i, m]], 1), 26 * 36)
        for k, m in pairs:
            assert_uniform(u[:, i, [k, m]], 26 * 36)


def test_pixels_of_a_tile_are_uniform_by_themselves():
    for place in (0, 9, 15):
        u = draw("sobol", 4, pixels_of_many_tiles(100, place), [3])[:, 0]
        for k in range(4):
            assert_uniform(u[:, k], 30)
        for k, m in itertools.combinations(range(4), 2):
            assert_uniform(u[:, [k, m]], 30)


@pytest.mark.parametrize("sampler", SPREAD)
@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_which_sample_takes_which_stratum_is_shuffled(sampler, count):
    """Of stratified samples all orders are about equally frequent; of Sobol samples the first is as often first."""
    pixels = pixels_of_many_tiles(60)
    strata = np.floor(draw(sampler, count, pixels)[..., 0] * count + COARSE * count).astype(int)
    if sampler == "sobol":
        counts = np.bincount(strata[:, 0], minlength=count)
    else:
        pair = np.bincount(strata[:, 0] * count + strata[:, 1], minlength=count**2).reshape(count, count)
        assert not np.diagonal(pair).any()
        counts = pair[~np.eye(count, dtype=bool)]
    statistic = float(((counts - counts.mean()) ** 2 / counts.mean()).sum())
    assert tr.testing.chi2_p_value(statistic, len(counts) - 1) > 0.01 / 8


# ------------------------------------------------------------------------------------------------- even spreading
@pytest.mark.parametrize("count", [2, 3, 16, 20, 50, 64, 1000])
@pytest.mark.parametrize("block", [0, 1])
def test_strata_have_one_sample_each(count, block):
    u = draw("stratified", count, pixels_of_many_tiles(3), block=block)
    x, y = (u[..., k] for k in PAIR[block])
    single = u[..., 2 if block == 0 else 0]

    def assert_filled(numbers: np.ndarray) -> None:
        """The i-th smallest number lies in the i-th stratum, at the edge of which it may be rounded down."""
        low = np.arange(count) / count
        assert ((np.sort(numbers) > low - COARSE) & (np.sort(numbers) < low + 1 / count)).all()

    assert_filled(single)
    assert_filled(y)
    columns = int(count**0.5)
    rows = -(-count // columns)
    row = np.argsort(np.argsort(y)) // columns
    cells = row * columns + np.floor(x * columns + COARSE * columns).astype(int)
    for of_pixel in cells:
        assert len(np.unique(of_pixel)) == count  # no cell of the grid has two
    if rows * columns == count:
        assert_filled(x)


@pytest.mark.parametrize("block", [0, 1])
@pytest.mark.parametrize("power", [1, 2, 4, 6, 10])
def test_sobol_points_fill_elementary_intervals(power, block):
    """The pair is a (0,2)-sequence: 2^m points, from a multiple of that on, one in every 2^-a x 2^-(m-a) rectangle."""
    count = 1 << power
    u = draw("sobol", count, pixels_of_many_tiles(2), block=block)
    for m in range(power + 1):
        for part in u.reshape(-1, 1 << m, 4):
            for k in range(4):
                assert len(np.unique(np.floor(part[:, k] * (1 << m)))) == 1 << m
            x, y = (part[:, k] for k in PAIR[block])
            for a in range(m + 1):
                cells = np.floor(x * (1 << a)) * (1 << m) + np.floor(y * (1 << (m - a)))
                assert len(np.unique(cells)) == 1 << m


@pytest.mark.parametrize("side", [2, 4, 16])
def test_sobol_points_of_neighbouring_pixels_fill_elementary_intervals_together(side):
    rows, columns = np.meshgrid(np.arange(side) + 32, np.arange(side) + 16, indexing="ij")
    u = draw("sobol", 4, pixel_numbers(rows, columns).ravel()).reshape(-1, 4)
    n = len(u)
    power = n.bit_length() - 1
    for a in range(power + 1):
        cells = np.floor(u[:, 1] * (1 << a)) * n + np.floor(u[:, 2] * (n >> a))
        assert len(np.unique(cells)) == n


@pytest.mark.parametrize("sampler", SPREAD)
def test_many_samples_are_several_patterns(sampler):
    count, size = 3 << 16, 1 << 16
    u = draw(sampler, count, [77])[0]
    for part in u.reshape(-1, size, 4):
        strata = np.floor(part[:, 0] * size)
        assert len(np.unique(strata)) == size
    assert not np.array_equal(np.sort(u[:size, 0]), np.sort(u[size : 2 * size, 0]))
    last = draw(sampler, 1 << 32, [77], [(1 << 32) - 1])
    assert ((last >= 0) & (last < 1)).all()
