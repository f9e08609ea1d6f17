"""Runs in a fresh process: start-up time and peak memory of torchrender for one row, printed as one line of JSON.

python -m bench.child ROW THREADS RESOLUTION SPP STEPS
"""

from __future__ import annotations

import json
import sys
import time

from .mitsuba_server import peak_memory


def main() -> None:
    index, threads, resolution, spp, steps = map(int, sys.argv[1:])
    import torch

    torch.set_num_threads(threads)
    # A first backward pass starts torch's own autograd machinery; it is torch's, so it belongs to the base.
    torch.ones(3, requires_grad=True).square().sum().backward()
    base = peak_memory()
    start = time.perf_counter()
    import torchrender  # noqa: F401

    imported = time.perf_counter()
    from .ours import Ours
    from .rows import ROWS

    ours = Ours(ROWS[index], resolution, spp)
    loaded = time.perf_counter()
    ours.step(0)
    done = time.perf_counter()
    for seed in range(1, steps):
        ours.step(seed)
    result = {"import": imported - start, "load": loaded - imported, "first_gradient": done - loaded}
    print(json.dumps({**result, "memory": peak_memory() - base, "base_memory": base}))


if __name__ == "__main__":
    main()
