"""Cameras from COLMAP's files: every model against its projection, and files that are damaged or wrong."""

from __future__ import annotations

import math
import struct
import time

import numpy as np
import pytest
import torch

import torchrender as tr

# The parameters of COLMAP's camera models, and their projections written out (COLMAP's documentation, "Camera Models").
MODELS = {
    "SIMPLE_PINHOLE": [50.0, 14.0, 18.0],
    "PINHOLE": [50.0, 45.0, 14.0, 18.0],
    "SIMPLE_RADIAL": [50.0, 14.0, 18.0, -0.1],
    "RADIAL": [50.0, 14.0, 18.0, -0.1, 0.03],
    "OPENCV": [50.0, 45.0, 14.0, 18.0, -0.2, 0.08, 0.01, -0.02],
    "OPENCV_FISHEYE": [50.0, 45.0, 14.0, 18.0, 0.05, -0.02, 0.01, -0.003],
    "FULL_OPENCV": [50.0, 45.0, 14.0, 18.0, -0.2, 0.08, 0.01, -0.02, 0.03, 0.02, -0.03, 0.01],
}
QUATERNION = np.array([0.9, 0.2, -0.3, 0.1]) / math.sqrt(0.95)
T = np.array([0.1, -0.2, 3.0])


def rotated(p: np.ndarray) -> np.ndarray:
    """q p q^-1 of points (N, 3), by v + 2 w (u x v) + 2 u x (u x v)."""
    w, u = QUATERNION[0], QUATERNION[1:]
    across = np.cross(u, p)
    return p + 2 * w * across + 2 * np.cross(u, across)


def project(model: str, v: list[float], p: np.ndarray) -> np.ndarray:
    a, b = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    rr = a * a + b * b
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        v = [v[0], *v]
    fx, fy, cx, cy, *k = v
    if model == "OPENCV_FISHEYE":
        r = np.sqrt(rr)
        theta = np.arctan(r)
        s = theta * (1 + sum(c * theta ** (2 * i + 2) for i, c in enumerate(k))) / r
        return np.stack([fx * s * a + cx, fy * s * b + cy], 1)
    k1, k2, p1, p2, k3, k4, k5, k6 = [*k, *[0.0] * (8 - len(k))]
    s = (1 + k1 * rr + k2 * rr**2 + k3 * rr**3) / (1 + k4 * rr + k5 * rr**2 + k6 * rr**3)
    x = a * s + 2 * p1 * a * b + p2 * (rr + 2 * a * a)
    y = b * s + p1 * (rr + 2 * b * b) + 2 * p2 * a * b
    return np.stack([fx * x + cx, fy * y + cy], 1)


def write(folder, cameras: str | None = None, images: str | None = None):
    if cameras is None:
        cameras = "# Camera list\n" + "".join(
            f"{i + 1} {name} 30 40 {' '.join(map(str, v))}\n" for i, (name, v) in enumerate(MODELS.items())
        )
    if images is None:
        pose = " ".join(f"{x:.17g}" for x in (*QUATERNION, *T))
        images = "# Image list\n# two lines an image\n" + "".join(
            f"{i + 1} {pose} {i + 1} {name.lower()} view.jpg\n{'' if i % 2 else '1.5 2.5 -1'}\n"
            for i, name in enumerate(MODELS)
        )
    (folder / "cameras.txt").write_text(cameras)
    (folder / "images.txt").write_text(images)
    return folder


@pytest.mark.parametrize("model", MODELS)
def test_points_are_seen_where_colmap_projects_them(tmp_path, model):
    cameras = tr.load_colmap(write(tmp_path), filter="box", near_clip=0.1)
    assert list(cameras) == [f"{name.lower()} view.jpg" for name in MODELS]  # names with spaces, in their order
    camera = cameras[f"{model.lower()} view.jpg"]
    assert isinstance(camera, tr.FisheyeCamera if model == "OPENCV_FISHEYE" else tr.PerspectiveCamera)
    assert (camera.film.height, camera.film.width, camera.film.filter.type) == (40, 30, "box")
    assert (camera.near_clip.item(), camera.to_world.dtype) == (pytest.approx(0.1), torch.float32)
    rng = np.random.default_rng(1)
    local = np.stack([rng.uniform(-0.5, 0.5, 30), rng.uniform(-0.5, 0.5, 30), np.ones(30)], 1)
    local *= rng.uniform(1, 3, (30, 1))
    pixels = torch.from_numpy(project(model, MODELS[model], local))
    rays = camera.rays(pixels)
    seen = rotated((rays.origins + rays.directions).double().numpy()) + T  # in the camera's frame
    torch.testing.assert_close(
        torch.from_numpy(seen[:, :2] / seen[:, 2:]), torch.from_numpy(local[:, :2] / local[:, 2:]), atol=3e-5, rtol=0
    )


def write_binary(folder):
    """The same reconstruction; written out as COLMAP's documentation describes the format."""
    cameras = struct.pack("<Q", len(MODELS))
    images = struct.pack("<Q", len(MODELS))
    for i, (name, v) in enumerate(MODELS.items()):
        cameras += struct.pack(f"<IiQQ{len(v)}d", i + 1, i, 30, 40, *v)
        images += struct.pack("<I7dI", i + 1, *QUATERNION, *T, i + 1) + f"{name.lower()} view.jpg\0".encode()
        images += struct.pack("<Q", i % 2) + struct.pack("<ddQ", 1.5, 2.5, 2**64 - 1) * (i % 2)
    (folder / "cameras.bin").write_bytes(cameras)
    (folder / "images.bin").write_bytes(images)
    return folder


def test_binary_files_give_the_same_cameras(tmp_path):
    """Where both are there, the binary ones are read, as COLMAP does."""
    text = tr.load_colmap(write(tmp_path))
    write_binary(tmp_path)
    (tmp_path / "images.txt").write_text("nothing")
    binary = tr.load_colmap(tmp_path)
    assert list(binary) == list(text)
    for name, camera in text.items():
        assert type(camera) is type(binary[name]) and camera.film.width == binary[name].film.width == 30
        ours, theirs = camera.state_dict(), binary[name].state_dict()
        assert list(ours) == list(theirs) and all(torch.equal(ours[n], theirs[n]) for n in ours)
    (tmp_path / "images.bin").unlink()
    with pytest.raises(ValueError, match=r"images\.txt:1: expected IMAGE_ID"):
        tr.load_colmap(tmp_path)


def changed(content: bytes, at: int, new: bytes) -> bytes:
    return content[:at] + new + content[at + len(new) :]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("cameras.bin", lambda c: b"", r"cameras\.bin: the file is truncated or damaged: 8 bytes expected, 0 left"),
        ("cameras.bin", lambda c: c[:-1], r"cameras\.bin: the file is truncated .*: 96 bytes expected, 95 left"),
        ("cameras.bin", lambda c: c + b"x", r"cameras\.bin: the file is damaged: 1 bytes after its end"),
        ("cameras.bin", lambda c: b"\xff" * 8 + c[8:], r"claims to hold 18446744073709551615 cameras in \d+ bytes"),
        ("cameras.bin", lambda c: changed(c, 12, b"\x08"), "camera 1: the camera model SIMPLE_RADIAL_FISHEYE is not"),
        ("cameras.bin", lambda c: changed(c, 12, b"\xff" * 4), "camera 1: the camera model number -1 is not supported"),
        (
            "cameras.bin",
            lambda c: changed(c, 16, b"\0"),
            "camera 1: expected a size from 1 to 65536 pixels, got 0 x 40",
        ),
        ("cameras.bin", lambda c: changed(c, 32, b"\xff" * 8), "camera 1: f: expected a finite number, got 'nan'"),
        ("cameras.bin", lambda c: changed(c, 39, b"\xc0"), "camera 1: f: expected a positive focal length, got -50"),
        ("cameras.bin", lambda c: changed(c, 8, b"\x02"), "camera 2: a second camera 2"),
        ("images.bin", lambda c: c[:100], r"images\.bin"),
        ("images.bin", lambda c: changed(c, 12, b"\xff" * 8), r"images\.bin: image 1: QW: expected a finite number"),
        ("images.bin", lambda c: changed(c, 12, b"\0" * 32), "image 1: expected a quaternion of length 1, got"),
        ("images.bin", lambda c: changed(c, 68, b"\x63"), "image 1: there is no camera 99 in"),
        ("images.bin", lambda c: changed(c, 72, b"\xff"), "image 1: its name is not text"),
        ("images.bin", lambda c: c[:8] + c[8:].replace(b"\0", b"\1"), r"images\.bin: image"),
        ("images.bin", lambda c: changed(c, 72 + 24, b"\xff" * 8), "truncated or damaged: 442721857769029238760 bytes"),
    ],
)
def test_wrong_binary_files(tmp_path, name, change, message):
    write_binary(tmp_path)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(change(content))
    with pytest.raises(ValueError, match=message):
        tr.load_colmap(tmp_path)


def test_they_render(tmp_path):
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere"}, "sky": {"type": "constant"}})
    views = tr.render(scene, sensor=list(tr.load_colmap(write(tmp_path)).values()), spp=1, seed=0)
    assert views.shape == (7, 40, 30, 3)
    assert bool(torch.isfinite(views).all())


CAMERA = "1 PINHOLE 30 40 50 45 14 18\n"
IMAGE = "1 1 0 0 0 0 0 3 1 a.jpg\n\n"


@pytest.mark.parametrize(
    ("cameras", "images", "message"),
    [
        ("1 THIN_PRISM_FISHEYE 3 4 1 2\n", IMAGE, r"cameras\.txt:1: the camera model 'THIN_PRISM_FISHEYE' is not"),
        ("1 PINHOLE 30 40 50 45 14\n", IMAGE, r"PINHOLE has 4 parameters \(fx fy cx cy\), got 3"),
        ("\n1 PINHOLE 0 40 50 45 14 18\n", IMAGE, r"cameras\.txt:2: expected a size from 1 to 65536 pixels, got 0"),
        ("1 PINHOLE 30 99999999 50 45 14 18\n", IMAGE, "got 30 x 99999999"),
        ("1 PINHOLE 30 4x 50 45 14 18\n", IMAGE, "HEIGHT: expected a whole number, got '4x'"),
        ("1 PINHOLE 30 40 -50 45 14 18\n", IMAGE, "fx: expected a positive focal length, got -50"),
        ("1 PINHOLE 30 40 50 45 nan 18\n", IMAGE, "cx: expected a finite number, got 'nan'"),
        ("1 PINHOLE\n", IMAGE, "expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS"),
        (CAMERA + CAMERA, IMAGE, r"cameras\.txt:2: a second camera 1"),
        (CAMERA, "1 1 0 0 0 0 0 3 2 a.jpg\n\n", r"images\.txt:1: there is no camera 2"),
        (CAMERA, "1 1 0 0 0 0 0 3 1\n\n", "expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"),
        (CAMERA, "1 0 0 0 0 0 0 3 1 a.jpg\n\n", "expected a quaternion of length 1, got one of length 0"),
        (CAMERA, "1 1 0 0 0 0 1e999 3 1 a.jpg\n\n", "TY: expected a finite number"),
        (CAMERA, IMAGE + IMAGE, r"images\.txt:3: a second image 'a\.jpg'"),
    ],
)
def test_wrong_files(tmp_path, cameras, images, message):
    with pytest.raises(ValueError, match=message):
        tr.load_colmap(write(tmp_path, cameras, images))


def test_wrong_arguments(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*cameras\.txt"):
        tr.load_colmap(tmp_path)
    with pytest.raises(ValueError, match=r"images\.txt:3: image .*no parameter 'fish'"):
        tr.load_colmap(write(tmp_path), fish=1)
    (tmp_path / "cameras.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="is not text"):
        tr.load_colmap(tmp_path)


def test_damaged_files_end_in_errors_that_name_them(tmp_path):
    """Cut off anywhere, and with single bits turned over: cameras, or an error with file and line, at once."""
    write(tmp_path)
    rng = np.random.default_rng(3)
    refused = 0
    for name in ("cameras.txt", "images.txt"):
        content = (tmp_path / name).read_bytes()
        for i in range(120):
            damaged = bytearray(content[: rng.integers(len(content))] if i < 40 else content)
            if i >= 40:
                damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
            (tmp_path / name).write_bytes(damaged)
            begin = time.process_time()
            try:
                found = tr.load_colmap(tmp_path)
            except ValueError as error:
                assert ".txt" in str(error), error
                refused += 1
            else:
                assert all(bool(torch.isfinite(c.to_world).all()) for c in found.values())
            assert time.process_time() - begin < 10
        (tmp_path / name).write_bytes(content)
    assert 60 < refused < 240  # many bits are digits, and those of comments do not matter
