"""Processes in which nothing but torch is imported: forks of one, so that these seconds are spent once.

They are what an interpreter is after its first line, ``import torch``. What is to come before that needs a new one, as
do variables that are read when a process starts: ``LD_LIBRARY_PATH``, ``OMP_THREAD_LIMIT``, ``PYTHONWARNINGS``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# Reads requests, a line each, and writes each process's number, and then how it has ended: as an interpreter does.
SERVER = """
import json, os, signal, sys
import torch
for line in sys.stdin:
    request = json.loads(line)
    child = os.fork()
    if child == 0:
        for number, name in enumerate((os.devnull, request["out"], request["err"])):
            os.dup2(os.open(name, os.O_RDWR), number)
        signal.alarm(request["timeout"])
        os.environ.clear()
        os.environ.update(request["environment"])
        exec(compile(request["code"], "<string>", "exec"), {"__name__": "__main__"})
        break
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

_servers: list[subprocess.Popen[str]] = []


def _server() -> subprocess.Popen[str]:
    if not _servers:
        # no variable of ours is read before torchrender is imported, and that is later
        command = [sys.executable, "-c", SERVER]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        _servers.append(subprocess.Popen(command, cwd=ROOT, text=True, **pipes))
    return _servers[0]


def run(
    code: str,
    environment: dict[str, str] | None = None,
    timeout: int = 120,
    meanwhile: Callable[[int], object] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run `code` in a process of its own in the repository's root: what it wrote, and its exit status.

    Args:
        code: Python.
        environment: all variables; those of this process unless given.
        timeout: seconds after which it is ended by a signal.
        meanwhile: is called with the process's number while that runs.
    """
    server = _server()
    assert server.stdin is not None and server.stdout is not None
    with tempfile.NamedTemporaryFile("r") as out, tempfile.NamedTemporaryFile("r") as err:
        request = {"code": code, "out": out.name, "err": err.name, "timeout": timeout}
        request["environment"] = dict(os.environ) if environment is None else environment
        print(json.dumps(request), file=server.stdin, flush=True)
        process = int(server.stdout.readline())
        try:
            if meanwhile:
                meanwhile(process)
        finally:
            status = int(server.stdout.readline())
        return subprocess.CompletedProcess(["python"], status, out.read(), err.read())


def interpreter(command: Sequence[str], **_: object) -> subprocess.CompletedProcess[str]:
    """In place of ``subprocess.run`` for ``python -m MODULE ...`` and ``python FILE ...``, which have torch then."""
    what, by = (command[2:], "run_module") if command[1] == "-m" else (command[1:], "run_path")
    return run(f"import runpy, sys\nsys.argv = {list(what)!r}\nrunpy.{by}({what[0]!r}, run_name='__main__')")
