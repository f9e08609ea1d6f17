"""Rays of every camera in PyTorch, differentiable: the same maps as those of the native core.

A camera is a map from positions on the film to rays in its own frame, which looks along +z, with +x to the left in the
image and +y up; its matrix takes them to the world.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch


class Rays(NamedTuple):
    """Camera rays: `origins`, unit `directions` (N, 3), world space, and how far they reach, `tmax` (N,)."""

    origins: torch.Tensor
    directions: torch.Tensor
    tmax: torch.Tensor


def perspective_rays(
    to_world: torch.Tensor,
    x_fov: torch.Tensor,
    offset_x: torch.Tensor,
    offset_y: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    pixel_aspect: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> Rays:
    """Rays of a pinhole camera with these parameters, see `PerspectiveCamera.rays`; `size` of the film is (H, W)."""
    height, width = size
    tangent = torch.tan(x_fov * (math.pi / 360))
    x = 2 * (positions[:, 0] * (1 / width) + offset_x)
    y = 2 * (positions[:, 1] * (1 / height) + offset_y)
    local = torch.stack([(1 - x) * tangent, (1 - y) * (tangent * height / width * pixel_aspect), torch.ones_like(x)], 1)
    local = local / torch.linalg.vector_norm(local, dim=1, keepdim=True)
    directions = (to_world[:3, :3] * local[:, None]).sum(2)  # not a matrix product, which autocast would round
    directions = directions / torch.linalg.vector_norm(directions, dim=1, keepdim=True)
    stretch = 1 / local[:, 2]
    origins = to_world[:3, 3] + directions * (stretch * near_clip)[:, None]
    return Rays(origins, directions, (stretch * (far_clip - near_clip)).detach())


def film_slopes(
    half_width: torch.Tensor,
    offset_x: torch.Tensor,
    offset_y: torch.Tensor,
    pixel_aspect: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions on the film, half of whose width is `half_width`, in front of a focal length of 1; +x left, +y up."""
    height, width = size
    x = 1 - 2 * (positions[:, 0] * (1 / width) + offset_x)
    y = 1 - 2 * (positions[:, 1] * (1 / height) + offset_y)
    return x * half_width, y * (half_width * pixel_aspect * (height / width))


def distort(k: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Where a lens with OpenCV's coefficients k1 k2 p1 p2 k3 k4 k5 k6 shows (x, y, 1), +x to the right and +y down.

    Args:
        k: (8,).
        x, y: of any shape.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    rr = x * x + y * y
    s = (1 + rr * (k1 + rr * (k2 + rr * k3))) / (1 + rr * (k4 + rr * (k5 + rr * k6)))
    xy, xx, yy = 2 * x * y, rr + 2 * x * x, rr + 2 * y * y
    return x * s + p1 * xy + p2 * xx, y * s + p1 * yy + p2 * xy


def undistort(k: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The inverse of `distort` by Newton's method, attached to its arguments by two more steps of it.

    The first makes first derivatives right, which is the implicit function theorem, the second those up to the third.

    Returns:
        x and y, 0 where there is no such point, and whether there is.
    """

    def step(k: torch.Tensor, px: torch.Tensor, py: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """How far (px, py) is from its image (x, y), in either space, and the determinant of the lens' Jacobian."""
        k1, k2, p1, p2, k3, k4, k5, k6 = k
        rr = px * px + py * py
        above, below = 1 + rr * (k1 + rr * (k2 + rr * k3)), 1 + rr * (k4 + rr * (k5 + rr * k6))
        slope = (k1 + rr * (2 * k2 + 3 * rr * k3)) - above / below * (k4 + rr * (2 * k5 + 3 * rr * k6))
        s, change = above / below, 2 * slope / below  # of s, by x: x times this
        across = px * py * change + 2 * p1 * px + 2 * p2 * py
        a = s + px * px * change + 2 * p1 * py + 6 * p2 * px
        d = s + py * py * change + 6 * p1 * py + 2 * p2 * px
        determinant = a * d - across * across
        folded = determinant == 0
        scale = torch.where(folded, 0, 1 / torch.where(folded, 1, determinant))
        seen_x, seen_y = distort(k, px, py)
        ex, ey = seen_x - x, seen_y - y
        return (d * ex - across * ey) * scale, (a * ey - across * ex) * scale, ex, ey, determinant

    given = x, y
    with torch.no_grad():
        x, y = x.detach(), y.detach()
        px, py = x.clone(), y.clone()
        for _ in range(20):
            dx, dy, *_ = step(k.detach(), px, py)
            px, py = px - dx, py - dy
        *_, ex, ey, determinant = step(k.detach(), px, py)
        found = (ex.abs() + ey.abs() < 1e-4 * (1 + x.abs() + y.abs())) & (determinant > 0) & (px * x + py * y >= 0)
        px, py = (torch.where(found, v, torch.zeros_like(v)) for v in (px, py))
    x, y = given
    for _ in range(2):
        dx, dy, *_ = step(k, px, py)
        px, py = px - torch.where(found, dx, 0), py - torch.where(found, dy, 0)
    return px, py, found


def to_world_rays(
    to_world: torch.Tensor,
    origins: torch.Tensor,
    directions: torch.Tensor,
    start: torch.Tensor,
    reach: torch.Tensor,
    exists: torch.Tensor | None = None,
    base: torch.Tensor | None = None,
) -> Rays:
    """Rays from the camera's frame (`origins`, unit `directions`, where they start and how far they go) to the world.

    `base` is the frame's place, if not that of the matrix. A ray that does not `exist` gets `tmax` 0.
    """
    linear = to_world[:3, :3]
    origins = (linear * origins[:, None]).sum(2) + (to_world[:3, 3] if base is None else base)
    directions = (linear * directions[:, None]).sum(2)
    length = torch.linalg.vector_norm(directions, dim=1)
    directions = directions / length[:, None]
    reach = reach.detach()
    if exists is not None:
        reach = torch.where(exists, reach, torch.zeros_like(reach))
    return Rays(origins + directions * (start * length)[:, None], directions, reach)


def planar_rays(
    to_world: torch.Tensor,
    origins: torch.Tensor,
    towards: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    exists: torch.Tensor | None = None,
) -> Rays:
    """Rays between planes in front of a camera; `towards` are directions of any length."""
    directions = towards / torch.linalg.vector_norm(towards, dim=1, keepdim=True)
    stretch = 1 / directions[:, 2]
    return to_world_rays(to_world, origins, directions, stretch * near_clip, stretch * (far_clip - near_clip), exists)


def distorted_rays(
    to_world: torch.Tensor,
    x_fov: torch.Tensor,
    offset_x: torch.Tensor,
    offset_y: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    pixel_aspect: torch.Tensor,
    distortion: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> Rays:
    """Rays of a camera whose lens distorts."""
    tangent = torch.tan(x_fov * (math.pi / 360))
    x, y = film_slopes(tangent, offset_x, offset_y, pixel_aspect, size, positions)
    x, y, found = undistort(distortion, -x, -y)
    towards = torch.stack([-x, -y, torch.ones_like(x)], 1)
    return planar_rays(to_world, torch.zeros_like(towards), towards, near_clip, far_clip, found)


def on_disk(lens: torch.Tensor) -> torch.Tensor:
    """The concentric map of the unit square (N, 2) to the unit disk: Shirley and Chiu 1997, in Cline's form (2011)."""
    x, y = 2 * lens[:, 0] - 1, 2 * lens[:, 1] - 1
    wide = x.abs() > y.abs()
    r, other = torch.where(wide, x, y), torch.where(wide, y, x)
    phi = torch.where(r == 0, torch.zeros_like(r), other / r) * (math.pi / 4)
    phi = torch.where(wide, phi, math.pi / 2 - phi)
    return torch.stack([r * torch.cos(phi), r * torch.sin(phi)], 1)


def thinlens_rays(
    to_world: torch.Tensor,
    x_fov: torch.Tensor,
    offset_x: torch.Tensor,
    offset_y: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    pixel_aspect: torch.Tensor,
    aperture_radius: torch.Tensor,
    focus_distance: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
    lens: torch.Tensor,
) -> Rays:
    """Rays of a camera with a lens; `lens` (N, 2) in the unit square."""
    tangent = torch.tan(x_fov * (math.pi / 360))
    x, y = film_slopes(tangent, offset_x, offset_y, pixel_aspect, size, positions)
    origins = torch.nn.functional.pad(on_disk(lens) * aperture_radius, (0, 1))
    focus = torch.stack([x, y, torch.ones_like(x)], 1) * focus_distance
    return planar_rays(to_world, origins, focus - origins, near_clip, far_clip)


def orthographic_rays(
    to_world: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> Rays:
    """Parallel rays; the film's width is [-1, 1] of the camera's frame."""
    height, width = size
    x, y = 1 - 2 * positions[:, 0] * (1 / width), (1 - 2 * positions[:, 1] * (1 / height)) * (height / width)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    directions = torch.stack([zero, zero, one], 1)
    return to_world_rays(
        to_world, torch.stack([x, y, zero], 1), directions, near_clip * one, (far_clip - near_clip) * one
    )


def fisheye_angle(k: torch.Tensor, theta: torch.Tensor) -> torch.Tensor:
    """Distance from the principal point over the focal length, at an angle to the axis; `k` (4,)."""
    square = theta * theta
    return theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))


def fisheye_rays(
    to_world: torch.Tensor,
    x_fov: torch.Tensor,
    offset_x: torch.Tensor,
    offset_y: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    pixel_aspect: torch.Tensor,
    distortion: torch.Tensor,
    max_angle: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> Rays:
    """Rays of a fisheye lens."""
    x, y = film_slopes(x_fov * (math.pi / 360), offset_x, offset_y, pixel_aspect, size, positions)
    off_axis = (x != 0) | (y != 0)
    radius = torch.sqrt(torch.where(off_axis, x * x + y * y, torch.ones_like(x)))  # not 0, which has no derivative
    radius = torch.where(off_axis, radius, torch.zeros_like(radius))
    limit = (max_angle * (math.pi / 180)).detach()

    def slope_at(k: torch.Tensor, theta: torch.Tensor) -> torch.Tensor:
        square = theta * theta
        return 1 + square * (3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3])))

    with torch.no_grad():
        k, seen = distortion.detach(), radius.detach()
        theta = torch.minimum(seen, limit)
        for _ in range(20):
            step = (fisheye_angle(k, theta) - seen) / slope_at(k, theta).clamp_min(1e-3)
            theta = (theta - step).clamp(0, math.pi)
        found = ((fisheye_angle(k, theta) - seen).abs() < 1e-4 * (1 + seen)) & (slope_at(k, theta) > 1e-3)
        found = found & (theta <= limit * (1 + 4 * torch.finfo(theta.dtype).eps))
        theta = torch.where(found, theta, 0)
    angle = theta
    for _ in range(2):  # attached, as in `undistort`
        slope = torch.where(found, slope_at(distortion, angle), torch.inf)
        angle = angle - (fisheye_angle(distortion, angle) - radius) / slope
    ratio = torch.where(off_axis, torch.sin(angle) / torch.where(off_axis, radius, torch.ones_like(radius)), 1)
    directions = torch.stack([x * ratio, y * ratio, torch.cos(angle)], 1)
    one = torch.ones_like(x)
    return to_world_rays(
        to_world, torch.zeros_like(directions), directions, near_clip * one, (far_clip - near_clip) * one, found
    )


def panorama_rays(
    to_world: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> Rays:
    """Rays in all directions: columns are longitudes, rows latitudes."""
    height, width = size
    theta, phi = positions[:, 1] * (math.pi / height), (positions[:, 0] * (1 / width) - 0.5) * (2 * math.pi)
    s, one = torch.sin(theta), torch.ones_like(theta)
    directions = torch.stack([-torch.sin(phi) * s, torch.cos(theta), torch.cos(phi) * s], 1)
    return to_world_rays(
        to_world, torch.zeros_like(directions), directions, near_clip * one, (far_clip - near_clip) * one
    )


def radiancemeter_rays(to_world: torch.Tensor, count: int) -> Rays:
    """The same ray `count` times."""
    zero = to_world.new_zeros(count)
    directions = torch.stack([zero, zero, zero + 1], 1)
    return to_world_rays(to_world, torch.zeros_like(directions), directions, zero, zero + torch.inf)


def distant_rays(to_world: torch.Tensor, target: torch.Tensor | None, bounds: torch.Tensor, lens: torch.Tensor) -> Rays:
    """Rays along the frame's z axis towards `target`, or over a ball around `bounds` (2, 3), from outside of it."""
    center = bounds.mean(0)
    radius = torch.linalg.vector_norm(bounds[1] - center)
    far = radius * 1.001 + 1e-6
    base, disk = center, on_disk(lens) * far / 1.001
    if target is not None:
        base, disk = target, torch.zeros_like(disk)
        far = far + torch.linalg.vector_norm(target.detach() - center)
    zero = disk.new_zeros(len(disk))
    directions = torch.stack([zero, zero, zero + 1], 1)
    origins = torch.cat([disk, (zero - far)[:, None]], 1)
    return to_world_rays(to_world, origins, directions, zero, zero + torch.inf, base=base)
