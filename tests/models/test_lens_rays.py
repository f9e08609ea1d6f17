"""Rays of every camera in PyTorch: where known points are seen, Mitsuba's rays, derivatives, what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.scene.camera_rays import distort, fisheye_angle, undistort

pytestmark = pytest.mark.once  # rays in PyTorch

SO3 = tr.rotation.so3_exp
R = SO3(torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64))
T = torch.tensor([0.1, -0.2, 3.0], dtype=torch.float64)
K = torch.tensor([[50.0, 0, 14], [0, 45, 18], [0, 0, 1]], dtype=torch.float64)
BROWN = torch.tensor([-0.3, 0.12, 0.01, -0.02, 0.03, 0.02, -0.03, 0.01], dtype=torch.float64)
KANNALA = torch.tensor([0.05, -0.02, 0.01, -0.003], dtype=torch.float64)
LOOK = tr.Transform.look_at([1, 2, 5], [0, 0.5, 0])
FILM = {"type": "hdrfilm", "width": 40, "height": 30}


def points(n: int = 40, spread: float = 0.5) -> torch.Tensor:
    """Points in front of the OpenCV camera (R, T), in world space."""
    generator = torch.Generator().manual_seed(1)
    x = torch.rand(n, 3, generator=generator, dtype=torch.float64) * 2 - 1
    local = torch.stack([x[:, 0] * spread, x[:, 1] * spread, torch.ones(n)], 1) * (2 + x[:, 2:])
    return (local - T) @ R


def assert_seen(camera, pixels: torch.Tensor, p: torch.Tensor) -> None:
    """The rays of these positions go through these points."""
    rays = camera.rays(pixels)
    away = p - rays.origins
    along = (away * rays.directions).sum(1, keepdim=True)
    assert bool((along > 0).all() and (rays.tmax > along[:, 0]).all())
    torch.testing.assert_close(along * rays.directions, away, atol=1e-9, rtol=0)


# --------------------------------------------------------------------------------------------------- known projections
def test_points_are_seen_where_opencv_projects_them():
    """The formula of cv::projectPoints, written out."""
    p = points()
    q = p @ R.T + T
    x, y = q[:, 0] / q[:, 2], q[:, 1] / q[:, 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = BROWN
    r2 = x**2 + y**2
    s = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * s + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * s + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    pixels = torch.stack([K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2]], 1)
    assert float((pixels - torch.stack([50 * x + 14, 45 * y + 18], 1)).abs().max()) > 1  # the lens matters
    assert_seen(tr.PerspectiveCamera.from_opencv(K, R, T, (40, 30), BROWN), pixels, p)


def test_points_are_seen_where_opencv_projects_them_with_a_fisheye():
    """The formula of cv::fisheye::projectPoints, written out; points up to 70 degrees from the axis."""
    p = points(spread=1.9)
    q = p @ R.T + T
    a, b = q[:, 0] / q[:, 2], q[:, 1] / q[:, 2]
    r = torch.sqrt(a**2 + b**2)
    theta = torch.atan(r)
    k1, k2, k3, k4 = KANNALA
    seen = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    pixels = torch.stack([K[0, 0] * seen / r * a + K[0, 2], K[1, 1] * seen / r * b + K[1, 2]], 1)
    camera = tr.FisheyeCamera.from_opencv(K, R, T, (40, 30), KANNALA)
    assert_seen(camera, pixels, p)
    torch.testing.assert_close(camera.K, K)


def test_fewer_coefficients_are_those_of_opencv():
    for n in (4, 5):
        short = tr.PerspectiveCamera.from_opencv(K, R, T, (40, 30), BROWN[:n])
        padded = torch.cat([BROWN[:n], torch.zeros(8 - n, dtype=torch.float64)])
        assert torch.equal(short.distortion, padded)


@pytest.mark.parametrize("shape", [(1, -1), (-1, 1)])
def test_coefficients_come_as_cv2_returns_them(shape):
    for cls, given in ((tr.PerspectiveCamera, BROWN[:5]), (tr.FisheyeCamera, KANNALA)):
        plain, as_table = (cls.from_opencv(K, R, T, (40, 30), k) for k in (given, given.numpy().reshape(shape)))
        torch.testing.assert_close(as_table.distortion, plain.distortion)
    with pytest.raises(ValueError, match=r"distortion: expected 4, 5 or 8 coefficients .* shape \(2, 2\)"):
        tr.PerspectiveCamera.from_opencv(K, R, T, (40, 30), np.zeros((2, 2)))


def test_a_reflection_is_no_rotation():
    mirrored = torch.as_tensor(R) @ torch.diag(torch.tensor([1.0, 1.0, -1.0], dtype=torch.as_tensor(R).dtype))
    with pytest.raises(ValueError, match=r"from_opencv\.R: expected a rotation, got a reflection"):
        tr.PerspectiveCamera.from_opencv(K, mirrored, T, (40, 30))


def test_without_distortion_the_rays_are_those_of_a_pinhole():
    plain = tr.PerspectiveCamera.from_opencv(K, R, T, (40, 30))
    for camera in (
        tr.PerspectiveCamera.from_opencv(K, R, T, (40, 30), [0.0] * 8),
        tr.ThinLensCamera.from_opencv(K, R, T, (40, 30), aperture_radius=0.0),
        tr.ThinLensCamera.from_opencv(K, R, T, (40, 30), aperture_radius=0.3),  # through the middle of the lens
    ):
        for a, b in zip(camera.rays(), plain.rays(), strict=True):
            torch.testing.assert_close(a, b, atol=1e-12, rtol=1e-12)
    assert plain.distortion is None


def test_rays_of_a_lens_meet_in_the_plane_of_focus():
    camera = tr.ThinLensCamera(
        to_world=LOOK, fov=40, aperture_radius=0.3, focus_distance=4.0, film=FILM, _context=None
    ).double()
    lens = torch.rand(50, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    rays = camera.rays(torch.tensor([[7.0, 21.0]]).expand(50, 2), lens)
    axis, origin = camera.to_world[:3, 2], camera.to_world[:3, 3]
    t = (4.0 - (rays.origins - origin) @ axis) / (rays.directions @ axis)
    met = rays.origins + rays.directions * t[:, None]
    torch.testing.assert_close(met, met[:1].expand(50, 3), atol=1e-5, rtol=0)
    # and they fill the disk: back on the lens the distances are those of uniform points
    back = rays.origins - rays.directions * (camera.near_clip / (rays.directions @ axis))[:, None]
    radius = torch.linalg.vector_norm(back - origin, dim=1)
    assert float(radius.max()) <= 0.3 + 1e-6 and float(radius.max()) > 0.25


def test_a_fisheye_without_coefficients_is_equidistant():
    camera = tr.FisheyeCamera(film={"type": "hdrfilm", "width": 36, "height": 36}).double()
    x = torch.arange(19.0, 36.0, dtype=torch.float64)
    directions = camera.rays(torch.stack([x, torch.full_like(x, 18.0)], 1)).directions
    angle = (x - 18) / 18 * (math.pi / 2)
    expected = torch.stack([-torch.sin(angle), torch.zeros_like(x), torch.cos(angle)], 1)
    torch.testing.assert_close(directions, expected, atol=1e-7, rtol=0)
    middle = camera.rays([[18.0, 18.0]]).directions
    torch.testing.assert_close(middle, torch.tensor([[0.0, 0, 1]], dtype=torch.float64))


def test_beyond_the_largest_angle_there_is_nothing():
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    seen = tr.FisheyeCamera(film=film, max_angle=90.0).rays().tmax.reshape(8, 8) > 0
    assert not bool(seen[0, 0]) and bool(seen[0, 3]) and bool(seen[4].all())
    assert bool((tr.FisheyeCamera(film=film).rays().tmax > 0).all())


def test_beyond_the_fold_of_a_lens_there_is_nothing():
    """r (1 - 0.3 r^2) is at most 0.7027, at r = 1.0541."""
    k = torch.tensor([-0.3, 0, 0, 0, 0, 0, 0, 0], dtype=torch.float64)
    x = torch.tensor([0.0, 0.5, 0.70, 0.71, 1.0, 3.0], dtype=torch.float64)
    px, _, found = undistort(k, x, torch.zeros_like(x))
    assert found.tolist() == [True, True, True, False, False, False]
    assert bool((px[found] < 1.0541).all())
    back = distort(k, px, torch.zeros_like(px))[0]
    torch.testing.assert_close(back[found], x[found], atol=1e-12, rtol=0)


def test_directions_of_a_panorama():
    camera = tr.PanoramaCamera(film={"type": "hdrfilm", "width": 8, "height": 4}).double()
    at = torch.tensor([[4.0, 2], [6, 2], [2, 2], [0, 2], [3, 0], [3, 4]])
    expected = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 1, 0], [0, -1, 0]])
    torch.testing.assert_close(camera.rays(at).directions, expected.double(), atol=1e-7, rtol=0)


# -------------------------------------------------------------------------------------------------------- as in Mitsuba
# Sensor.sample_ray of Mitsuba 3.9.1 (scalar_rgb) with LOOK, a film of 40 x 30, near_clip 0.1 and far_clip 50:
# (position in fractions of the film, sample of the lens), origin, direction, reach.
THINLENS = [
    ((0.2, 0.3), (0.1, 0.7), (1.1662005, 2.0681615, 4.8400102), (-0.4435016, -0.1917468, -0.8755224), 51.91544),
    ((0.2, 0.3), (0.5, 0.5), (0.9591671, 1.9822537, 4.9071889), (-0.3966764, -0.1723994, -0.9016242), 51.36583),
    ((0.9, 0.6), (0.1, 0.7), (1.2170733, 2.0524487, 4.8345494), (0.0459207, -0.3461207, -0.9370656), 51.41371),
]
ORTHOGRAPHIC = [
    ((2, 2, 1), (0.2, 0.3), (-0.2287196, 2.5473886, 4.9752259)),
    ((2, 2, 1), (0.9, 0.6), (2.5667186, 1.6839732, 4.6751633)),
    ((2, 2, 3), (0.9, 0.6), (2.5290894, 1.6275300, 4.4870190)),
]
CLIPS = {"near_clip": 0.1, "far_clip": 50.0, "film": FILM}


def film_point(x: float, y: float) -> list[list[float]]:
    return [[40 * x, 30 * y]]


@pytest.mark.parametrize(("at", "lens", "origin", "direction", "reach"), THINLENS)
def test_rays_of_a_thin_lens_are_mitsubas(at, lens, origin, direction, reach):
    camera = tr.ThinLensCamera(to_world=LOOK, fov=40, aperture_radius=0.3, focus_distance=4.0, **CLIPS)
    rays = camera.rays(film_point(*at), [lens])
    torch.testing.assert_close(rays.origins[0], torch.tensor(origin), atol=2e-5, rtol=0)
    torch.testing.assert_close(rays.directions[0], torch.tensor(direction), atol=2e-5, rtol=0)
    assert float(rays.tmax) == pytest.approx(reach, rel=1e-5)


@pytest.mark.parametrize(("scale", "at", "origin"), ORTHOGRAPHIC)
def test_rays_of_an_orthographic_camera_are_mitsubas(scale, at, origin):
    camera = tr.OrthographicCamera(to_world=LOOK @ tr.Transform.scale(scale), **CLIPS)
    rays = camera.rays(film_point(*at))
    torch.testing.assert_close(rays.origins[0], torch.tensor(origin), atol=2e-5, rtol=0)
    torch.testing.assert_close(
        rays.directions[0], torch.tensor([-0.1881442, -0.2822163, -0.9407209]), atol=1e-6, rtol=0
    )
    assert float(rays.tmax) == pytest.approx(49.9)


def test_rays_of_meters_are_mitsubas():
    (o,), (d,), _ = tr.RadianceMeter(origin=[1, 2, 3], direction=[0, 1, 1]).rays()
    torch.testing.assert_close(o, torch.tensor([1.0, 2, 3]))
    torch.testing.assert_close(d, torch.tensor([0.0, 0.7071068, 0.7071068]))
    # of a scene that is one rectangle; the origins of Mitsuba 3.9.1, which starts 0.9 in 10,000 further away
    bounds = torch.tensor([[-1.0, -1, 0], [1, 1, 0]])
    (o,), (d,), _ = tr.DistantSensor(direction=[0, 1, 1]).rays(bounds=bounds)
    torch.testing.assert_close(o, torch.tensor([0.0, -1.00009, -1.00009]), atol=2e-3, rtol=0)
    torch.testing.assert_close(d, torch.tensor([0.0, 0.7071068, 0.7071068]))
    (o,), (d,), _ = tr.DistantSensor(to_world=LOOK, target=[0.1, 0.2, 0.3]).rays(bounds=bounds)
    away = o - torch.tensor([0.1, 0.2, 0.3])
    torch.testing.assert_close(away / away.norm(), -d)
    lens = torch.rand(200, 2, generator=torch.Generator().manual_seed(3))
    rays = tr.DistantSensor(direction=[0, 1, 1]).rays(torch.zeros(200, 2), lens, bounds=bounds)
    across = torch.linalg.cross(rays.origins, rays.directions.expand(200, 3)).norm(dim=1)
    assert 1.3 < float(across.max()) <= math.sqrt(2) + 1e-4


# ---------------------------------------------------------------------------------------------------------- derivatives
CAMERAS = {
    "distorted": (tr.PerspectiveCamera, {"fov": 45.0, "distortion": BROWN}),
    "thinlens": (tr.ThinLensCamera, {"fov": 40.0, "aperture_radius": 0.2, "focus_distance": 3.0}),
    "orthographic": (tr.OrthographicCamera, {}),
    "fisheye": (tr.FisheyeCamera, {"fov": 150.0, "distortion": KANNALA}),
    "panorama": (tr.PanoramaCamera, {}),
    "radiancemeter": (tr.RadianceMeter, {"film": {"type": "hdrfilm", "width": 1, "height": 1}}),
    "distant": (tr.DistantSensor, {"target": [0.1, 0.2, 0.3], "film": {"type": "hdrfilm", "width": 1, "height": 1}}),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_are_differentiable_in_every_parameter(name):
    cls, properties = CAMERAS[name]
    camera = cls(to_world=LOOK, **{"film": FILM, **properties}).double()
    names = [n for n, p in camera.named_parameters() if camera.fields()[n].derivative.startswith("interior")]
    assert "to_world" in names
    generator = torch.Generator().manual_seed(4)
    at = torch.rand(3, 2, generator=generator, dtype=torch.float64) * torch.tensor([40.0, 30.0])
    lens = torch.rand(3, 2, generator=generator, dtype=torch.float64)
    more = {"lens": lens} if name in ("thinlens", "distant") else {}
    if name == "distant":
        more["bounds"] = torch.tensor([[-1.0, -1, 0], [1, 1, 0]])

    def f(*values):
        for n, v in zip(names, values, strict=True):
            camera._parameters.pop(n, None)
            camera.__dict__[n] = v
        origins, directions, _ = camera.rays(at, **more)
        if name == "distant":  # how far away they start carries no gradient
            origins = torch.linalg.cross(origins, directions)
        return origins, directions

    given = [getattr(camera, n).detach().clone().requires_grad_() for n in names]
    assert torch.autograd.gradcheck(f, given, check_forward_ad=True)


def test_the_inverse_of_a_lens_is_differentiable():
    x = torch.tensor([0.3, -0.2, 0.0], dtype=torch.float64, requires_grad=True)
    y = torch.tensor([0.1, 0.35, 0.0], dtype=torch.float64, requires_grad=True)
    k = BROWN.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda k, x, y: undistort(k, x, y)[:2], (k, x, y), check_forward_ad=True)
    theta = torch.linspace(0, 1.5, 7, dtype=torch.float64)
    assert bool((fisheye_angle(KANNALA, theta).diff() > 0).all())


def test_gradients_reach_what_a_camera_is_made_of():
    given = [x.clone().requires_grad_() for x in (K, R, T, BROWN)]
    camera = tr.PerspectiveCamera.from_opencv(*given[:3], (40, 30), given[3])
    weight = torch.rand(1200, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    gradients = torch.autograd.grad((camera.rays().directions * weight).sum(), given, allow_unused=True)
    assert all(bool((g != 0).any()) for g in (gradients[0], gradients[1], gradients[3]))
    assert bool((gradients[3] != 0).all())
    fisheye = tr.FisheyeCamera.from_opencv(*given[:3], (40, 30), KANNALA.requires_grad_())
    (g,) = torch.autograd.grad((fisheye.rays().directions * weight).sum(), KANNALA)
    KANNALA.requires_grad_(False)
    assert bool((g != 0).all())


# -------------------------------------------------------------------------------------------------------------- refused
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tr.PerspectiveCamera(distortion=[0.1, 0.2]), r"distortion: expected 4, 5 or 8 coefficients \(k1"),
        (lambda: tr.PerspectiveCamera(distortion="0.1, b"), r"distortion: "),
        (lambda: tr.PerspectiveCamera(distortion=[float("nan")] * 8), r"distortion: .*not finite"),
        (lambda: tr.FisheyeCamera(distortion=[0.1] * 5), r"distortion: expected 4 coefficients \(k1 k2 k3 k4\)"),
        (lambda: tr.FisheyeCamera(fov=800), r"fov: expected an angle between 0 and 720 degrees, got 800"),
        (lambda: tr.FisheyeCamera(fov=100, x_fov=100), "give one of fov, focal_length and x_fov"),
        (lambda: tr.FisheyeCamera(max_angle=200.0), r"max_angle: 200 is outside the range \[0, 180\]"),
        (lambda: tr.ThinLensCamera(), r"'aperture_radius' is missing"),
        (lambda: tr.ThinLensCamera(aperture_radius=-0.1), r"aperture_radius: -0.1 is outside the range"),
        (lambda: tr.ThinLensCamera(aperture_radius=0.1, focus_distance=0), r"focus_distance: 0 is outside the range"),
        (lambda: tr.ThinLensCamera(aperture_radius=0.1, distortion=[0.0] * 4), "no parameter 'distortion'"),
        (lambda: tr.ThinLensCamera(aperture_radius=0.1, to_world=tr.Transform.scale(2)), "not scale or shear"),
        (lambda: tr.OrthographicCamera(to_world=tr.Transform.scale([1, 0, 1])), "to_world: the matrix is singular"),
        (lambda: tr.OrthographicCamera(near_clip=2.0, far_clip=1.0), "expected 0 < near_clip < far_clip"),
        (lambda: tr.PanoramaCamera(fov=90), "panorama has no parameter 'fov'"),
        (lambda: tr.RadianceMeter(film=FILM), "radiancemeter: has one pixel, but its film is 30 x 40"),
        (lambda: tr.RadianceMeter(origin=[0, 0, 0]), "origin and direction belong together"),
        (lambda: tr.DistantSensor(direction=[0, 0, 0]), "direction: expected a vector of some length"),
        (lambda: tr.DistantSensor(direction=[0, 0, 1], to_world=LOOK), "to_world and direction are both given"),
        (lambda: tr.DistantSensor(target={"type": "rectangle"}), "target: .*shapes are not supported"),
        (lambda: tr.DistantSensor(target=[0.0, 1.0]), "target: expected three numbers"),
        (lambda: tr.ThinLensCamera(aperture_radius=0.1).rays(None, [[0.5, 0.5]]), r"lens: expected shape \("),
        (lambda: tr.OrthographicCamera().rays([1.0, 2.0]), r"positions: expected shape \(N, 2\)"),
    ],
)
def test_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
