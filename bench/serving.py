"""What the two halves of a comparison share: this module is also imported by the servers, in the peers' environments.

A server reads one JSON request a line from standard input and answers each with one JSON line. The first answer,
before any request, is {"version": str, "import_seconds": float}.

    {"do": "load", "path": str, "arguments": {...}, "parameters": [...], "resolution": int | null, "spp": int,
     "arrays": str}
                                        resolution: null where the file leaves neither it nor spp open;
                                        arrays: the same scene as NumPy arrays, see `scene_arrays.py`; optional:
                                        "integrator", a dict of its type and settings, "variant", Mitsuba's
    {"do": "forward", "seed": int}   -> {"forward": seconds}                 an image without derivatives
    {"do": "step", "seed": int}      -> {"forward": seconds, "backward": seconds}     loss: mean square of the image
    {"do": "image", "seed": int, "spp": int, "file": str}      -> {"seconds": float}  saved with numpy.save, (H, W, 3)
    {"do": "gradient", "seed": int, "spp": int, "file": str | null}
                                     -> {"sums": [...], "seconds": float}    of mean(image * weight), with independent
                                        samples; `file`: the gradients in order, with numpy.savez
    {"do": "iteration", "seed": int, "views": [int], "spp": int, "spp_grad": int, "passes": int}
                                     -> {"forward": seconds, "backward": seconds, "bad image": int,
                                         "bad gradient": int}    sums over sensors and passes; bad: NaN or infinite
    {"do": "loss_gradient", "seed": int, "values": str, "target": str, "view": int, "spp": int, "spp_grad": int,
     "file": str}                    -> {"seconds": float}    of the mean squared difference from `target` (numpy.save),
                                        by `values` of the one parameter, which may have a new size; saved to `file`
    {"do": "load_caustics", "folder": str, "front": 4x4}
                                        heights.npy, target.npy and scene.json (a dict without its lens) in a folder,
                                        and the matrix of the lens
    {"do": "caustics", "seed": int, "spp": int, "spp_grad": int}
                                     -> {"forward": seconds, "backward": seconds, "loss": float, "bad image": int,
                                         "bad gradient": int}
    {"do": "load_moved", "direction": [x, y, z]}       the one parameter of the loaded scene is moved; torchrender gets
                                        "name", "resolution" and "spp", and loads the scene itself, Redner its "arrays"
                                        and the "name" of what moves, "max_depth", "resolution" and "spp" besides
    {"do": "derivative", "seed": int, "settings": dict, "seeds": int}
                                     -> {"derivative": float, "seconds": float}    of mean(image * weight) by the
                                        motion; "settings" and "seeds" are Mitsuba's alone
    {"do": "settle"}                 -> {"memory": MiB}       what is in use now; its peak is measured anew from here
    {"do": "memory"}                 -> {"peak": MiB}
    {"do": "quit"}
"""

from __future__ import annotations

import json
import os
import sys


def memory(key: str) -> float:
    """Memory of this process in MiB: "VmHWM", the peak, or "VmRSS", what is resident now."""
    with open("/proc/self/status") as status:
        for line in status:
            if line.startswith(key + ":"):
                return int(line.split()[1]) / 1024
    raise RuntimeError(f"/proc/self/status has no {key} line")


def settled_memory() -> float:
    """Memory in use, in MiB, from which its peak is measured anew; where the system does not allow that, the peak.

    What loading has used and given back must not hide what rendering takes.
    """
    try:
        with open("/proc/self/clear_refs", "w") as control:
            control.write("5")
    except OSError:
        return memory("VmHWM")
    now = memory("VmRSS")
    return now if memory("VmHWM") - now < 1 else memory("VmHWM")


def weight_of(height: int, width: int, np):
    """The weight of the scalar whose gradient is compared, (H, W, 3) float32; `np` is the numpy module."""
    x, y = 2 * np.pi * np.arange(width) / width, 2 * np.pi * np.arange(height) / height
    pattern = 1 + 0.5 * np.sin(x)[None, :] * np.cos(y)[:, None]
    return (pattern[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)


def serve(make) -> None:
    """Serve requests with the methods of `make(threads)`, which imports the renderer and has its `version`."""
    # Renderers log to standard output: keep a private copy of it for the answers and send the rest to standard error.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    server = make(int(sys.argv[1]))
    print(json.dumps({"version": server.version, "import_seconds": server.import_seconds}), file=answers)
    for line in sys.stdin:
        request = json.loads(line)
        action = request.pop("do")
        if action == "quit":
            break
        try:
            if action == "memory":
                answer = {"peak": memory("VmHWM")}
            elif action == "settle":
                answer = {"memory": settled_memory()}
            else:
                answer = getattr(server, action)(**request)
        except Exception as error:  # the caller reports it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers)
