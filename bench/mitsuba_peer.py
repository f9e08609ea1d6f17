"""Client of `mitsuba_server.py`: starts Mitsuba in its own environment and talks to it by lines of JSON."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

SERVER = Path(__file__).resolve().parent / "mitsuba_server.py"

HELP = """Mitsuba is not measured: no interpreter that has it was given. To make one:
    python3 -m venv mitsuba-env && mitsuba-env/bin/pip install mitsuba==3.9.1 numpy
    apt install libllvm19        # older ones crash; set DRJIT_LIBLLVM_PATH to its libLLVM.so.19.1
    python -m bench table2 --mitsuba-python mitsuba-env/bin/python     # or set MITSUBA_PYTHON"""


class Peer:
    """A running Mitsuba process limited to `threads` threads."""

    def __init__(self, python: str, threads: int, environment: dict[str, str] | None = None) -> None:
        self.process = subprocess.Popen(
            [python, str(SERVER), str(threads)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, **(environment or {})},
        )
        greeting = self._read()
        self.version, self.import_seconds = greeting["version"], greeting["import_seconds"]

    def _read(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"Mitsuba's process ended with status {self.process.wait()}; is it installed there?")
        answer = json.loads(line)
        if "error" in answer:
            raise RuntimeError(f"Mitsuba: {answer['error']}")
        return answer

    def ask(self, action: str, **arguments) -> dict:
        self.process.stdin.write(json.dumps({"do": action, **arguments}) + "\n")
        self.process.stdin.flush()
        return self._read()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.stdin.write('{"do": "quit"}\n')
            self.process.stdin.close()
            self.process.wait(timeout=30)


def connect(python: str | None, threads: int, environment: dict[str, str] | None = None) -> Peer | None:
    """The peer, or None (after saying why on standard output) if there is no interpreter or it has no Mitsuba."""
    python = python or os.environ.get("MITSUBA_PYTHON")
    if not python:
        print(HELP)
        return None
    try:
        return Peer(python, threads, environment)
    except (OSError, RuntimeError) as error:
        print(f"{python}: {error}\n{HELP}")
        return None
