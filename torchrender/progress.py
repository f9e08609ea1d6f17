"""A progress bar that appears only where somebody is watching."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from .image import in_notebook

if TYPE_CHECKING:
    from tqdm import tqdm

T = TypeVar("T")


def watched() -> bool:
    """Whether standard error is a terminal, or the code runs in a notebook."""
    stream = sys.stderr
    return in_notebook() or bool(stream is not None and hasattr(stream, "isatty") and stream.isatty())


def progress(
    iterable: Iterable[T] | None = None, *, total: int | None = None, desc: str | None = None, **kwargs: Any
) -> tqdm[T]:
    """Wrap an iterable in a tqdm bar where a terminal or notebook is watching, and in a silent one elsewhere.

    Args:
        iterable: what to loop over; ``None`` for a bar that is advanced by ``update``.
        total: number of steps, where ``len(iterable)`` does not say it.
        desc: text in front of the bar.
        **kwargs: further arguments of ``tqdm.tqdm``; ``disable=True`` or ``False`` decides by hand.

    Returns:
        A ``tqdm`` object: iterate over it, call ``set_postfix``, ``set_description`` or ``update``.
    """
    if in_notebook():
        from tqdm.auto import tqdm
    else:
        from tqdm import tqdm
    kwargs.setdefault("disable", not watched())
    bar: Any = tqdm(iterable, total=total, desc=desc, **kwargs)
    return bar


def steps(items: Sequence[T], desc: str, shown: bool | None) -> Iterable[T]:
    """`items`, if there are several of them in a bar, which is `shown` as that of `tracked`."""
    if len(items) < 2 or not _wanted(shown):
        return items
    return progress(items, desc=desc, leave=False, delay=_delay(shown), disable=False)


def _wanted(shown: bool | None) -> bool:
    return watched() if shown is None else shown


def _delay(shown: bool | None) -> float:
    """Seconds that a rendering takes before a bar appears."""
    return 0.0 if shown else 1.0


def tracked(
    configs: Sequence[dict[str, Any]], desc: str, shown: bool | None, shares: Sequence[float] | None = None
) -> Iterator[dict[str, Any]]:
    """Settings of the core for each of several passes, with a function that it tells how far it is.

    The bar is `shown`, or not, or with None where somebody is watching and it takes longer than a second. Parts of
    passes have `shares` of one.
    """
    if not _wanted(shown):
        yield from configs
        return
    form = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}, {remaining} left"
    options: dict[str, Any] = {"leave": False, "delay": _delay(shown), "disable": False, "bar_format": form}
    shares = [1.0] * len(configs) if shares is None else shares
    with progress(total=round(sum(shares)), desc=desc, **options) as bar:
        before = 0.0
        for config, share in zip(configs, shares, strict=True):

            def report(done: float, before: float = before, share: float = share) -> None:
                bar.update(before + done * share - bar.n)

            yield {**config, "progress": report}
            report(1.0)
            before += share
