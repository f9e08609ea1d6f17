"""Settings of Mitsuba's projective integrators, and which of them estimates a derivative best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from statistics import fmean, median, variance
from typing import Any

from .peers import PeerError
from .visibility_scenes import Moving

GUIDINGS = (("none", 512), ("grid", 64), ("grid", 512), ("octree", 64), ("octree", 512))
FACTORS = ((1, 1, 4), (1, 1, 16), (1, 4, 4), (4, 4, 4), (4, 4, 16))  # times the first number of samples
RR_DEPTH = 100


@dataclass(frozen=True)
class Setting:
    """An integrator, what guides its indirect samples, from how many seeds, and samples a pixel of its three terms."""

    integrator: str
    guiding: str
    seeds: int
    counts: tuple[int, int, int]  # interior, silhouettes that the camera sees, others

    def __str__(self) -> str:
        guided = self.guiding if self.guiding == "none" else f"{self.guiding} {self.seeds}"
        return f"{self.integrator}, {guided}, {'/'.join(map(str, self.counts))}"

    def request(self, moving: Moving) -> dict[str, Any]:
        """What the server takes."""
        settings: dict[str, Any] = {"type": self.integrator, "guiding": self.guiding}
        settings |= dict(zip(("sppc", "sppp", "sppi"), self.counts, strict=True))
        if self.integrator == "prb_projective":
            settings |= {"max_depth": moving.max_depth, "rr_depth": RR_DEPTH}
        return {"settings": settings, "seeds": self.seeds}


@dataclass
class Runs:
    """Derivatives of independent seeds, and the seconds of each."""

    derivatives: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, derivative: float, seconds: float) -> None:
        self.derivatives.append(derivative)
        self.seconds.append(seconds)

    @property
    def mean(self) -> float:
        return fmean(self.derivatives)

    @property
    def variance(self) -> float:
        return variance(self.derivatives)

    @property
    def cost(self) -> float:
        """Variance times seconds, the reciprocal of the efficiency."""
        return self.variance * median(self.seconds)

    def error(self, true: float) -> float:
        """Mean squared error times seconds: where there is a bias, noise alone says nothing."""
        return fmean((derivative - true) ** 2 for derivative in self.derivatives) * median(self.seconds)


Estimate = Callable[[int], tuple[float, float]]  # derivative and seconds, of a seed


def runs_of(estimate: Estimate, seeds: range) -> Runs:
    """Runs with these seeds, after a cold one that does not count."""
    found = Runs()
    estimate(seeds.start - 1)
    for seed in seeds:
        found.add(*estimate(seed))
    return found


def default(moving: Moving, spp: int) -> Setting:
    """What a user gets who sets nothing but the number of samples."""
    return Setting("direct_projective" if moving.max_depth == 2 else "prb_projective", "octree", 512, (spp, spp, spp))


def guided(moving: Moving, spp: int, guidings: tuple[tuple[str, int], ...] = GUIDINGS) -> list[Setting]:
    """The settings of the first step: integrators and guidings, without the terms that are 0."""
    counts = (spp, spp * ("seen" in moving.terms), spp * ("shadows" in moving.terms))
    integrators = ("direct_projective", "prb_projective") if moving.max_depth == 2 else ("prb_projective",)
    guidings = guidings if counts[2] else guidings[:1]
    return [Setting(integrator, *guiding, counts) for integrator in integrators for guiding in guidings]


def counted(best: Setting) -> list[Setting]:
    """The settings of the second step: other numbers of samples of the best one."""
    found = [tuple(n * f for n, f in zip(best.counts, factors, strict=True)) for factors in FACTORS]
    return [replace(best, counts=counts) for counts in dict.fromkeys(found) if counts != best.counts]


def search(
    moving: Moving,
    spp: int,
    seeds: range,
    estimate_of: Callable[[Setting], Estimate],
    true: float,
    quick: bool = False,
) -> tuple[dict[Setting, Runs], dict[Setting, str]]:
    """Runs of all settings that were tried, the best of the first step with other counts; what failed, and why."""
    tried: dict[Setting, Runs] = {}
    failed: dict[Setting, str] = {}

    def attempt(settings: list[Setting]) -> None:
        for setting in settings:
            try:
                tried[setting] = runs_of(estimate_of(setting), seeds)
            except PeerError as error:
                failed[setting] = str(error)

    attempt(guided(moving, spp, GUIDINGS[:1] if quick else GUIDINGS))
    if tried and not quick:
        attempt(counted(best_of(tried, true)))
    return tried, failed


def best_of(tried: dict[Setting, Runs], true: float) -> Setting:
    """That of the least mean squared error times seconds."""
    return min(tried, key=lambda setting: tried[setting].error(true))
