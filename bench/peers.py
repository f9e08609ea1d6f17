"""Other renderers, each a process in an environment of its own that is talked to by lines of JSON (`serving.py`).

One of them may be torchrender itself, in the state before a change.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Known:
    """A renderer that can be measured beside this one."""

    title: str
    server: str
    needs: str  # how an environment that has it is made
    python: str = ""  # where that environment's interpreter then is
    reads_arrays: bool = False  # cannot read the scenes' files
    keeps_kernels: bool = False  # compiles when it first renders, and keeps that for the next process
    samplers: tuple[str, ...] = ()  # those of the scenes' files that take powers of four; none: it has no choice
    ourselves: bool = False  # another state of this renderer, which is asked for the same work with the same settings


KNOWN = {
    "mitsuba": Known(
        "Mitsuba",
        "mitsuba_server.py",
        """    python3 -m venv mitsuba-env && mitsuba-env/bin/pip install mitsuba==3.9.1 numpy
    apt install libllvm19        # older ones crash; set DRJIT_LIBLLVM_PATH to its libLLVM.so.19.1""",
        python="mitsuba-env/bin/python",
        keeps_kernels=True,
        samplers=("independent", "stratified", "multijitter", "ldsampler"),
    ),
    "redner": Known(
        "Redner",
        "redner_server.py",
        """    python3.7 -m venv redner-env         # the last Python that its wheels are for
    redner-env/bin/pip install torch==1.10.2 "numpy<1.22" imageio scikit-image redner==0.4.28""",
        python="redner-env/bin/python",
        reads_arrays=True,
    ),
    "torchrender": Known(
        "torchrender before",
        "torchrender_server.py",
        """    git worktree add ../before COMMIT && make -C ../before build""",
        python="../before/.venv/bin/python",
        ourselves=True,
    ),
}


class PeerError(RuntimeError):
    """A peer that was asked for cannot be measured, or one of its answers is an error."""


def parse(text: str) -> tuple[str, str]:
    """``NAME=PYTHON``, or ``NAME`` with the interpreter in the environment variable ``NAME_PYTHON``.

    ValueError names what is wrong.
    """
    name, _, python = text.partition("=")
    if name not in KNOWN:
        raise ValueError(f"expected one of {', '.join(KNOWN)}, got {name!r}")
    variable = f"{name.upper()}_PYTHON"
    python = python or os.environ.get(variable, "")
    if not python:
        raise ValueError(f"expected {name}=PYTHON, the interpreter that has it (or set {variable}):\n{help_of(name)}")
    return name, python


def help_of(name: str) -> str:
    """How an environment with a peer is made."""
    return f"{KNOWN[name].needs}\n    python -m bench table2 --peer {name}={KNOWN[name].python}"


class Peer:
    """A running peer, limited to `threads` threads. PeerError says what is missing if it does not start.

    `settings` of `torchrender.Renderer` reach a peer that is torchrender itself.
    """

    def __init__(
        self,
        name: str,
        python: str,
        threads: int,
        environment: dict[str, str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self.name, self.title, self.ourselves = name, KNOWN[name].title, KNOWN[name].ourselves
        variables = {**os.environ, **(environment or {})}
        command = [python, str(FOLDER / KNOWN[name].server), str(threads)]
        if self.ourselves:
            command.append(json.dumps(dict(settings or {})))
            variables.pop("PYTHONPATH", None)  # which would lead to the torchrender that is running here
        self.said = tempfile.TemporaryFile()
        try:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.said,
                text=True,
                env=variables,
            )
        except OSError as error:
            raise PeerError(f"{self.title}: {python}: {error.strerror}; it is made by\n{help_of(name)}") from error
        try:
            greeting = self._read()
        except PeerError as error:
            self.process.kill()
            self.process.wait()
            raise PeerError(f"{error}; is it installed with {python}?\n{help_of(name)}") from error
        self.version, self.import_seconds = greeting["version"], greeting["import_seconds"]

    @property
    def key(self) -> str:
        """What its version goes by, beside that of this torchrender."""
        return self.title if self.ourselves else self.name

    def _read(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            status = self.process.wait()
            raise PeerError(f"{self.title}: its process ended with status {status}{self._last_words()}")
        try:
            answer = json.loads(line)
        except json.JSONDecodeError as error:
            raise PeerError(f"{self.title}: not an answer: {line.strip()[:200]!r}") from error
        if "error" in answer:
            raise PeerError(f"{self.title}: {answer['error']}")
        return answer

    def _last_words(self) -> str:
        """The last line on its standard error, which says what went wrong."""
        self.said.seek(0)
        lines = self.said.read().decode(errors="replace").split("\n")
        last = [line.strip() for line in lines if line.strip()][-1:]
        return f" ({last[0][:200]})" if last else ""

    def ask(self, action: str, **arguments) -> dict:
        try:
            self.process.stdin.write(json.dumps({"do": action, **arguments}) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # reading says with which status it ended
        return self._read()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.stdin.write('{"do": "quit"}\n')
            self.process.stdin.close()
            self.process.wait(timeout=30)
        self.said.close()


class Peers:
    """The peers that were asked for, running, in a ``with`` block."""

    def __init__(
        self,
        chosen: list[tuple[str, str]],
        threads: int,
        settings: Iterable[tuple[str, Any]] = (),
        environment: dict[str, str] | None = None,
    ) -> None:
        names = [name for name, _ in chosen]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise PeerError(f"--peer: {twice[0]} is given twice")
        self.chosen, self.threads, self.settings, self.environment = chosen, threads, dict(settings), environment
        self.running: list[Peer] = []

    def __enter__(self) -> list[Peer]:
        try:
            for name, python in self.chosen:
                self.running.append(Peer(name, python, self.threads, self.environment, self.settings))
        except BaseException:
            self.__exit__()
            raise
        return self.running

    def __exit__(self, *_: object) -> None:
        for peer in self.running:
            peer.close()
