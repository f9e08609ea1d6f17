"""Which core runs and where Embree comes from; what is missing is said in one sentence."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import fresh_python
import pytest

import torchrender as tr
from torchrender import backends

RENDER = (
    "import torchrender as tr; s = tr.load_dict({'type': 'scene', 'a': {'type': 'perspective', 'film': {'type': "
    "'hdrfilm', 'width': 4, 'height': 4}}, 'sky': {'type': 'constant'}}); i = tr.render(s, spp=1, seed=0); "
    "print(tr.backends.isa(), float(i.mean()))"
)


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return fresh_python.run(code, {**os.environ, **environment})


def test_one_core_is_used():
    report = backends.status()
    assert list(report) == list(backends.PREFERENCE)
    used = [isa for isa, state in report.items() if state.startswith("used")]
    assert used == [backends.isa()]
    assert used[0] in backends.compiled()


@pytest.mark.parametrize("isa", backends.PREFERENCE)
def test_every_compiled_core_can_be_forced(isa):
    result = run(RENDER, TORCHRENDER_ISA=isa)
    if "does not support" in result.stderr or isa not in backends.compiled():
        assert result.returncode != 0 and "ImportError" in result.stderr and "TORCHRENDER_ISA" in result.stderr
    else:
        assert result.stdout.split()[0] == isa, result.stderr
        assert float(result.stdout.split()[1]) == pytest.approx(1, abs=1e-5)


def test_an_unknown_core_is_refused():
    result = run(RENDER, TORCHRENDER_ISA="mmx")
    assert "TORCHRENDER_ISA: expected one of avx512, avx2, v2, scalar, got 'mmx'" in result.stderr


def test_embree_is_found_and_tested():
    found = backends.embree()
    assert found["version"].startswith("4.")
    assert Path(found["path"]).exists()


def test_another_embree_can_be_given(tmp_path):
    original = Path(backends.find_embree())
    (tmp_path / "libs").symlink_to(original.parent)  # what the library needs lies beside it
    copy = tmp_path / "libs" / original.name
    result = run(RENDER + "; print(tr.backends.embree()['path'])", TORCHRENDER_EMBREE=str(copy))
    assert result.stdout.splitlines()[-1] == str(copy), result.stderr


def test_a_missing_embree_is_named():
    result = run(RENDER, TORCHRENDER_EMBREE="/nowhere/libembree4.so")
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].endswith("Embree: no such file: /nowhere/libembree4.so")


def test_a_library_that_is_no_embree_is_refused(tmp_path):
    wrong = tmp_path / "libembree4.so.4"
    wrong.write_bytes(b"not a library")
    result = run(RENDER, TORCHRENDER_EMBREE=str(wrong))
    assert result.returncode == 1
    assert f"ImportError: Embree at {wrong} cannot be used: " in result.stderr


def test_use_embree_after_the_first_scene():
    backends.use_embree(backends.embree()["path"])  # the one in use: nothing to do
    with pytest.raises(FileNotFoundError, match="nowhere"):
        backends.use_embree("/nowhere/libembree4.so")
    with pytest.raises(RuntimeError, match="already loaded"):
        backends.use_embree(__file__)


def test_configuration_can_be_shown(capsys):
    text = tr.show_config()
    assert capsys.readouterr().out.strip() == text
    for part in (tr.__version__, "torch", "threads", f"core {backends.isa()}", "embree"):
        assert part in text
