"""Run the tutorials and keep what a page about each needs: its pictures, what it printed, the time it takes.

    make docs-tutorials                                # all of them: about half an hour on two cores
    python docs/site/run_tutorials.py cornell_box smoke    # these

Pictures become `docs/images/tutorials/NAME.jpg`, the rest is in `docs/site/tutorials.json`; `make docs` runs none.
"""

from __future__ import annotations

import ast
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = ROOT / "tutorials"
RECORDS = Path(__file__).with_name("tutorials.json")
PICTURES = ROOT / "docs" / "images" / "tutorials"
HEIGHT, WIDTH, QUALITY = 256, 1280, 82  # of the pictures that are kept: JPEG, of rows about so high and at most so wide


@dataclass(frozen=True)
class Run:
    """How a tutorial is run for its page, and which of the pictures that it writes are shown, row by row."""

    options: str = ""
    rows: tuple[str, ...] = ("start result target",)


# Those that are not named are run without options and show the usual pictures.
RUNS = {
    "achromat": Run("", ("spots", "focus")),
    "camera_calibration": Run("--demo", ("start result target derivative_turn",)),
    "caustics": Run("--iterations 150", ("target result heights",)),
    "cornell_box": Run("--demo", ("start result target derivative_red_wall",)),
    "ellipsometer": Run("", ("fit",)),
    "environment_map": Run("--demo", ("map_target map_result", "target_front result_front relit_target relit_result")),
    "glass_ball": Run("--demo", ("start result target derivative_eta",)),
    "grin_cube": Run("", ("target result", "index")),
    "grin_lens": Run("", ("spots", "lens")),
    "luneburg": Run("", ("result",)),
    "many_machines": Run("--demo", ("result texture_target texture_result",)),
    "mesh_from_pictures": Run("--demo", ("turntable",)),
    "mirage": Run("", ("photograph start result", "temperature")),
    "neural_bsdf": Run("--demo", ("target", "start", "result")),
    "neural_texture": Run("--demo", ("target result texture_target texture_result",)),
    "polarised_ball": Run("", ("photograph", "error")),
    "pose": Run("--demo"),
    "room": Run("--demo", ("start result target0",)),
    "shadow_art": Run("--demo", ("target", "result")),
    "paint_spectra": Run("", ("charts", "reflectances")),
    "schlieren": Run("", ("result",)),
    "shape_from_polarisation": Run("", ("photograph", "heights")),
    "slab": Run("", ("target start result albedo_result",)),
    "smoke": Run("--iterations 100", ("target result held_back_target held_back_result",)),
    "svbrdf": Run("--demo", ("target_first target_new result_new",)),
    "textured_monkey": Run("--demo", ("start result target texture_result",)),
    "watch_training": Run("", ()),  # pictures go to TensorBoard
    "which_glass": Run("", ("rainbows",)),
}


@cache
def programs() -> tuple[str, ...]:
    """Names of the tutorials: the programs in `tutorials/` whose docstring says how they are run."""
    found = [path.stem for path in sorted(PROGRAMS.glob("*.py")) if f"python tutorials/{path.name}" in docstring(path)]
    return tuple(name for name in found if not name.startswith("make_"))


def docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text())) or ""


def joined(folder: Path, rows: tuple[str, ...]) -> Image.Image:
    """The pictures of a run (names without ``.png``) beside each other, of equal height, in rows of equal width.

    A row that would be too high then is narrower, and in the middle.
    """
    from PIL import Image

    gap = 8
    strips = [[Image.open(folder / f"{name}.png").convert("RGB") for name in row.split()] for row in rows]
    aspects = [sum(part.width / part.height for part in strip) for strip in strips]
    gaps = [gap * (len(strip) - 1) for strip in strips]
    width = min(WIDTH, max(round(HEIGHT * a) + g for a, g in zip(aspects, gaps, strict=True)))
    heights = [min(2 * HEIGHT, (width - g) / a) for a, g in zip(aspects, gaps, strict=True)]
    sheet = Image.new("RGB", (width, sum(map(round, heights))), "white")
    y = 0
    for strip, height, aspect, between in zip(strips, heights, aspects, gaps, strict=True):
        x = round(width - aspect * height - between) // 2
        for part in strip:
            size = round(part.width * height / part.height), round(height)
            scaled = part.resize(size, Image.Resampling.LANCZOS)
            sheet.paste(scaled, (x, y))
            x += scaled.width + gap
        y += round(height)
    return sheet


def run(name: str) -> dict[str, object]:
    """Run a tutorial; its record."""
    folder = ROOT / "output" / "docs" / name
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier run, which this one would go on from
    options = RUNS.get(name, Run()).options.split()
    command = [sys.executable, str(PROGRAMS / f"{name}.py"), *options, "--output", str(folder)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=os.environ | {"COLUMNS": "100"})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    rows = RUNS.get(name, Run()).rows
    if rows:
        PICTURES.mkdir(parents=True, exist_ok=True)
        joined(folder, rows).save(PICTURES / f"{name}.jpg", quality=QUALITY)
    printed = re.sub(r"; [\d.]+ s$", "", done.stdout.replace(str(ROOT) + "/", ""), flags=re.MULTILINE)  # busy or not
    return {
        "command": " ".join(["python", f"tutorials/{name}.py", *options]),
        # of the processor, so that other programs do not count
        "seconds": round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1),
        "date": time.strftime("%Y-%m-%d"),
        "printed": printed,
    }


def main(names: list[str]) -> None:
    for name in names or programs():
        print(name, flush=True)
        record = run(name)
        print(record["seconds"], flush=True)
        records = json.loads(RECORDS.read_text()) if RECORDS.exists() else {}
        records[name] = record
        RECORDS.write_text(json.dumps(dict(sorted(records.items())), indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
