"""Rendering: `render`, the function that a PyTorch program calls."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast, overload

import numpy as np
import torch

from .autograd import RenderFunction
from .compiling import opaque
from .devices import device, holds
from .errors import describe
from .first_hit_call import PATH_OUTPUTS, STOKES_OUTPUTS, channels_of
from .functions import refuse_batches
from .integrators import Stack, Stokes, WavefrontPathTracer
from .interruption import interruption_of
from .outputs import attributes_of, check_names, collect, first_hits
from .progress import steps
from .render_arguments import (
    as_integrator,
    check_kinds_of_derivative,
    check_words,
    count,
    film_config,
    film_of_size,
    measuring,
    pair,
    pixels_inside,
)
from .render_call import RenderCall
from .render_checks import (
    check_bending,
    check_light,
    check_media,
    check_sensor,
    check_torch_bsdfs,
    check_wavefront,
    warn_of_beams,
)
from .render_devices import check_device
from .render_polarized import check_polarized, polarized_call, stokes_image, stokes_outputs
from .render_sensors import chosen_sensors, layout_with_room
from .render_types import (
    IntegratorLike,
    InterruptMode,
    LayoutName,
    NanMode,
    OutputNames,
    Outputs,
    PixelsLike,
    RangeMode,
    RenderSettings,
    SamplerName,
    SensorLike,
)
from .scene.bands import check_bands, groups, joined
from .scene.boundaries import warn_of_glass_on_curves
from .scene.gather import gather, has_derivative, replace_placeholder
from .scene.gradient_requirements import GradientRequirements
from .scene.host_memory import results_at_the_scene
from .scene.packing import Layout
from .scene.ranges import check_ranges
from .scene.residence import staying
from .scene.scene import Scene, operation
from .scene.sensor import IrradianceMeter, Sensor, default_sampler
from .scene.spectral.core_values import for_core
from .scene.spectral.wavelengths import sensor_weights, wavelength_config
from .seeds import seeds
from .shares import ALONE
from .shares import current as current_share

if TYPE_CHECKING:
    from typing_extensions import Unpack


@overload
def render(scene: Scene, *, outputs: None = None, **settings: Unpack[RenderSettings]) -> torch.Tensor: ...


@overload
def render(scene: Scene, *, outputs: OutputNames, **settings: Unpack[RenderSettings]) -> Outputs: ...


@operation("render")
@opaque
@results_at_the_scene
def render(
    scene: Scene,
    *,
    sensor: SensorLike = 0,
    integrator: IntegratorLike | None = None,
    spp: int | None = None,
    seed: int | torch.Generator | None = None,
    spp_grad: int | None = None,
    seed_grad: int | torch.Generator | None = None,
    passes: int = 1,
    params: Mapping[str, torch.Tensor] | Sequence[Mapping[str, torch.Tensor]] | None = None,
    outputs: OutputNames | None = None,
    features: Mapping[str, torch.Tensor] | None = None,
    size: Sequence[int] | None = None,
    crop: Sequence[int] | None = None,
    pixels: PixelsLike | None = None,
    layout: LayoutName = "hwc",
    correlated: bool = False,
    adaptive_grad: bool = False,
    nan: NanMode = "drop",
    sampler: SamplerName | None = None,
    range: RangeMode = "warn",
    progress: bool | None = None,
    visibility: bool = True,
    spp_visibility: int | tuple[int, int] | None = None,
    on_interrupt: InterruptMode = "raise",
) -> torch.Tensor | Outputs:
    """Render `scene`: linear radiance (H, W, C), differentiable in the scene's parameters.

    Args:
        scene: what to render.
        sensor: index or name of a camera of the scene, a camera object, or a list of them (for indices also an integer
            tensor or array (B,)), whose films have one size.
        integrator: how; None takes the scene's own, else ``PathTracer()``.
        spp: samples a pixel; None takes the camera's own number, else 16.
        seed: an integer, a `torch.Generator`, or None, which draws from torch's default generator. The same seed gives
            the same image.
        spp_grad: samples a pixel of the derivative; None takes `spp`.
        seed_grad: seed of the derivative; None takes a hash of `seed`, so that image and derivative are independent.
        passes: number of independent passes, each of `spp` and `spp_grad`, that are averaged in constant memory.
        params: tensors, leaves or not, that replace parameters of these names in this call; gradients flow into them. A
            list of such mappings has one for each sensor of a list.
        outputs: names of what is wanted; a named tuple of tensors comes back. Radiance ``"rgb"`` (H, W, C), coverage
            ``"alpha"`` (H, W), ``"variance"`` (H, W, C) of the values of rgb and ``"second_moment"`` (H, W, C) of its
            samples, which carry no derivative: that of coverage consists of moving silhouettes alone. Of the first
            surface that is seen: ``"depth"`` along the camera's axis and ``"distance"`` from the camera (H, W);
            ``"position"``, geometric ``"normal"`` and ``"shading_normal"`` in world space, ``"normal_camera"`` and
            ``"shading_normal_camera"`` in the camera's frame (x left, y up, z into the image), all (H, W, 3); ``"uv"``
            and ``"barycentric"`` coordinates (H, W, 2); ``"dp_du"`` and ``"dp_dv"``, derivatives of the position by uv
            (H, W, 3); ``"albedo"`` (H, W, C): reflectance of diffuse surfaces, ``specular_reflectance`` of conductors,
            ``specular_transmittance`` of dielectrics, 1 for null; ``"specular_reflectance"`` (H, W, C) and
            ``"roughness"`` (H, W) of the material; colours of meshes by their names, such as ``"vertex_color"`` (H, W,
            C). These are averages over the samples that hit something, weighted by the filter; where none does, depth,
            distance and position are infinite, the others 0. ``"shape_id"``, ``"prim_id"`` and ``"material_id"`` (H,
            W), int32, belong to the ray through the pixel's centre: position among the scene's shapes, face, and a
            number that surfaces of one material share, -1 at a miss; so do ``"duv_dx"`` and ``"duv_dy"`` (H, W, 2),
            derivatives of uv by the place on the film, per pixel to the right and down, 0 at a miss. See
            `torchrender.outputs`.
        features: what the output ``"features"`` (H, W, N) shows, for any N: by a shape's name, a texture (H, W, N),
            bilinear and repeated, row 0 at v = 0, or for a mesh one row a vertex (V, N), interpolated. Other shapes
            carry zeros. For a decoder that turns features into colours, or for labels; differentiable in the features,
            in geometry and camera.
        size: (H, W) of the image in place of the film's own, which then has no crop window; the horizontal field of
            view stays.
        crop: (y0, x0, height, width) of the image; equal to that part of the whole, bit for bit.
        pixels: integer tensor (N, 2) of rows and columns of the image, in any order, repetitions allowed; the result is
            (N, C), equal to these pixels of the whole, bit for bit. Work and memory go with N and, where the filter
            is no box, all pixels within its reach, but light tracing has those of the whole film: its paths belong to
            no pixel. Not with `crop`.
        layout: ``"hwc"``, ``"chw"``, ``"bhwc"``, ``"bchw"``; a list of sensors adds the batch to the first two. With
            `pixels` N takes the place of H and W: (N, C), (C, N), (B, N, C), (B, C, N).
        correlated: differentiate the samples of the image, `seed_grad` being `seed`: gradients of nonlinear losses are
            then biased. Where a gradient can be asked for and `spp_grad` is `spp`, the hits of the image's rays are
            kept for `backward()`, which then traces nothing (see ``torchrender.autograd.STORED_HITS_LIMIT``); but not
            where blends or masks choose by chance.
        adaptive_grad: `backward()` through radiance gives each pixel samples in proportion to the size of its incoming
            gradient (at least 1, and about a fifth of `spp_grad`, where that is not zero; none where it is). `spp_grad`
            is their mean over the rendered pixels, those without any included. Unbiased as without it; forward mode and
            the other outputs take `spp_grad` everywhere. Not with `correlated`.
        nan: ``"drop"`` samples that are not finite and warn once, or ``"raise"`` a `RenderError`.
        sampler: how samples are spread, in image and derivative: ``"independent"``, ``"stratified"`` or ``"sobol"``
            (`tr.SAMPLERS`, see `Sampler`); None takes the camera's own, else ``"sobol"``.
        range: parameters that have left their physical range, such as an albedo that an optimiser has made 1.2:
            ``"warn"`` with a `RangeWarning`, once for each, which looks at the first few changes of a value and then at
            one of sixteen; ``"raise"`` a ValueError; ``"ignore"``.
        visibility: whether derivatives of shapes, cameras and lights have the motion of silhouettes, creases and
            shadows, of meshes, spheres, disks and cylinders; False leaves it out, and says nothing.
        spp_visibility: samples of outlines a pixel for it: a number, or one for those that the camera sees, one for
            shadows and reflections; None takes a 32nd of `spp_grad`, fewer where outlines are short, a 32nd (a 64th
            under skies) and a 64th, at least 1024 each, and shares them out by what few of each bring; of shadows the
            power of two that is next. 0 leaves these out.
        progress: show a bar with the time that is left, in ``backward()`` too: True, False, or None: in a terminal or
            notebook, if it takes longer than a second.
        on_interrupt: what Ctrl-C does: ``"raise"`` KeyboardInterrupt, or ``"return"`` a picture of the samples that are
            done, as unbiased as the whole, with an `InterruptionWarning` that says which share of them it has. Of
            several passes these are the complete ones; the first one is rendered in parts, of a million paths or more
            and of the same samples (their sums may be rounded otherwise), but not with `correlated` nor by the
            wavefront tracer, where whole passes count. Views of a list that were not begun have one part or pass each.
            Other outputs of a view follow, and ``backward()`` takes as many passes, with all of `spp_grad`. Ctrl-C
            before the first part is done, during other outputs, a derivative, or once more raises.

    Raises:
        TypeError, ValueError: before any work, naming the argument, what was expected and what came.
        NotDifferentiableError: a parameter requires a gradient that does not exist.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"render: scene: expected a Scene (see load_dict, load_file), got {describe(scene)}")
    if isinstance(params, Sequence):
        return _by_view(dict(locals()))
    settings: dict[str, Any] = dict(locals())
    chosen_integrator = as_integrator(scene, integrator)
    if isinstance(chosen_integrator, Stokes):
        settings |= {"integrator": chosen_integrator.integrator, "outputs": outputs or ("stokes",)}
        vectors: Any = render(**settings)
        return vectors if outputs is not None else vectors.stokes
    integrator_config = chosen_integrator.config()
    names = ("rgb",) if outputs is None else check_names(outputs)
    interruption = interruption_of(on_interrupt)
    stack = chosen_integrator if outputs is None and isinstance(chosen_integrator, Stack) else None
    if pixels is not None and crop is not None:
        raise ValueError("render: pixels and crop are both given; pixels count from the corner of the whole image")
    check_words(layout, nan, sampler, range)
    check_kinds_of_derivative(adaptive_grad, correlated)
    if not isinstance(visibility, bool):
        raise TypeError(f"render: visibility: expected True or False, got {describe(visibility)}")
    spp_outlines = pair("spp_visibility", spp_visibility)
    if progress is not None and not isinstance(progress, bool):
        raise TypeError(f"render: progress: expected True, False or None, got {describe(progress)}")
    passes = count("passes", passes)
    packed = layout_with_room(scene, sensor)
    attributes_of(packed, [n for n in names if n not in PATH_OUTPUTS])
    shown: dict[int, torch.Tensor] = {}
    if features is not None or "features" in names:
        from .features import check_features

        shown = check_features(scene, packed, features, names)
    cameras, batched = chosen_sensors(packed, sensor, one_size=size is None)
    if integrator is None:
        measured = measuring(scene, chosen_integrator, [camera for _, camera in cameras])
        if measured is not chosen_integrator:
            chosen_integrator, integrator_config = measured, measured.config()
    for value in params.values() if isinstance(params, Mapping) else ():
        refuse_batches(value)
    check_device(scene, packed, names)
    share = current_share()
    first_seed, gradient_seed = seeds(seed, seed_grad, correlated)
    of_paths = (*PATH_OUTPUTS, *STOKES_OUTPUTS)
    shows_radiance = stack.integrator is not None if stack is not None else any(n in of_paths for n in names)
    volumetric = shows_radiance and bool(integrator_config.get("volumetric"))
    light = shows_radiance and integrator_config["integrator"] == "ptracer"
    traces = chosen_integrator if stack is None else stack.integrator
    wavefront = shows_radiance and isinstance(traces, WavefrontPathTracer)
    polarized = any(n in STOKES_OUTPUTS for n in names) or (scene.polarized and stack is None and "rgb" in names)
    if polarized:
        check_polarized(traces, packed, names, adaptive_grad, scene.warned)
    of_torch: dict[str, torch.Tensor] = {}
    if packed.torch_bsdfs:
        params, of_torch = check_torch_bsdfs(packed, params, names, stack, traces, shows_radiance)
    share.check(
        names=names,
        passes=passes,
        wavefront=wavefront,
        light=light,
        pixels=pixels,
        boxes=all(camera.film.filter.type == "box" for _, camera in cameras),
    )
    stay = staying(packed) if share is ALONE and not wavefront and holds(device(scene.device), scene.device) else ()
    given = cast("Mapping[str, torch.Tensor] | None", params)
    tensors = share.replicated(gather(scene, packed, given, staying=stay))
    shown = dict(zip(shown, share.replicated(list(shown.values())), strict=True))
    check_ranges(scene, packed, tensors, range)
    if packed.spectral:
        if wavefront:
            raise ValueError("render: integrator: WavefrontPathTracer has no wavelengths; PathTracer has them")
        tensors = for_core(scene, packed, tensors)
    if shows_radiance and not packed.lights_seen:
        from .black_pictures import warn_of_missing_light  # when it is needed: importing the package is to be quick

        warn_of_missing_light(scene, packed)
        warn_of_glass_on_curves(scene)
    if wavefront:
        check_wavefront(packed, names, adaptive_grad)
    bends = shows_radiance and bool(packed.bending)
    if bends:
        check_bending(packed, tensors, traces, not (volumetric or wavefront))
    if light:
        check_light(packed, names, adaptive_grad)
    elif shows_radiance:
        warn_of_beams(scene, packed)
    if shows_radiance and packed.media:
        check_media(scene, packed, tensors, volumetric)
    seen_outlines = visibility and spp_outlines != (0, 0)
    # of radiance that the core knows
    outlines = seen_outlines and shows_radiance and not packed.torch_bsdfs
    views: list[dict[str, torch.Tensor]] = []
    chosen: np.ndarray | None = None
    for index, camera in steps(cameras, "views", progress):
        film, own = film_of_size(camera.film, size), default_sampler(camera)
        check_sensor(camera, light, names, stack, tensors, packed)
        check_bands(film, camera.srf, packed.spectral)
        samples = own.sample_count if spp is None else count("spp", spp)
        window, shape, config = film_config(film, share.crop(film.window[2:], crop))
        if pixels is not None:
            chosen = pixels_inside(pixels, shape)
            config["pixels"] = (chosen.ctypes.data, len(chosen))
            shape = (len(chosen),)
        used = tensors
        if index >= packed.own_sensors:
            used = replace_placeholder(scene, packed, tensors, packed.sensors[index], camera, share.replicated)
            if volumetric and getattr(camera, "medium", None) is not None:
                raise ValueError(
                    "render: sensor: a camera with a medium has to be one of the scene's: scene['inside'] = camera"
                )
        native = scene.native(packed, [tuple(t.shape) for t in used])
        if bends:
            # when it is needed: importing the package is to be quick
            from .gradientindex.apart import check_apart
            from .gradientindex.places import check_places

            if not views:
                check_apart(scene, packed, native, used)
            check_places(scene, packed, native, used, index, light)
        seen, held = {}, ()
        if packed.spectral:
            seen["spectral"], held = wavelength_config(scene, packed, tensors, sensor_weights(None, camera.srf))
        alpha = "alpha" in names or (stack is not None and not light and stack.wants_alpha(film))
        outlined = outlines and not isinstance(camera, IrradianceMeter)
        call = RenderCall(
            native=native,
            config={
                **({**integrator_config, "integrator": "path"} if wavefront else integrator_config),
                **config,
                "sensor": index,
                "crop": window,
                "sampler": own.type if sampler is None else sampler,
                **seen,
            },
            size=shape,
            spp=samples,
            seed=first_seed,
            spp_grad=samples if spp_grad is None else count("spp_grad", spp_grad),
            seed_grad=gradient_seed,
            passes=passes,
            nan=nan,
            pixels=chosen,
            alpha=alpha,
            variance="variance" in names,
            second_moment="second_moment" in names or (stack is not None and stack.second_moment),
            statistics=scene.statistics,
            requirements=GradientRequirements(
                packed,
                scene.warned,
                alpha,
                volumetric,
                steady=light and film.filter.type == "box",
                particles=light,
                outlines=outlined if shows_radiance else seen_outlines and not shown,
                silent=not visibility,
            ),
            film=film,
            features=shown,
            interruption=interruption,
            outlines=seen_outlines,
            spp_visibility=spp_outlines,
            adaptive_grad=adaptive_grad,
            progress=progress,
            held=held,
            share=share,
        )
        call.keep_hits = (
            correlated
            and not volumetric
            and not light
            and not wavefront
            and not bends
            and call.spp_grad == call.spp
            and not _mixes(packed)
            and native.device() == "cpu"
            and torch.is_grad_enabled()
            and any(tensor.requires_grad for tensor in used)
        )
        _check_derivatives(call, used)
        trace: Callable[[RenderCall, list[torch.Tensor]], Any] = _native
        if wavefront:
            from .wavefront.function import wavefront_call

            trace = functools.partial(_traced, wavefront_call(scene, call, integrator_config, of_torch))
        radiance = functools.partial(_radiance, scene, call, used, camera, trace, outlined)
        if polarized:
            of_vectors = polarized_call(call, packed)
            parts = _parts(scene, of_vectors, used, camera, trace, outlined)
            stokes = stokes_image(parts, len(film.channels or "rgb"[: native.channels]), of_vectors.stokes)
            of_stokes = stokes_outputs(stokes, names)
            rest = [n for n in names if n not in of_stokes]
            views.append({**(_view(scene, call, rest, stack, used, radiance) if rest else {}), **of_stokes})
        else:
            views.append(_view(scene, call, names, stack, used, radiance))
        views[-1] = share.gathered(views[-1])
        if "rgb" in views[-1] and crop is None and pixels is None and "black" not in scene.warned:
            from .black_pictures import warn_of_black_picture

            warn_of_black_picture(scene, packed, native, used, camera, views[-1]["rgb"])
    if interruption is not on_interrupt:
        interruption.warn()
    if stack is not None:
        return arrange([stack.stacked(v) for v in views], batched, layout, -1)
    found = [arrange([v[n] for v in views], batched, layout, channels_of(n)) for n in names]
    return found[0] if outputs is None else collect(names, found)


def sensors_of_list(sensors: Any, params: Sequence[Any]) -> Sequence[Any]:
    """The sensors that a list of parameters belongs to; errors unless it has a mapping for each."""
    for mapping in params:
        if not isinstance(mapping, Mapping):
            raise TypeError(f"render: params: expected a mapping from names to tensors, got {describe(mapping)}")
    if isinstance(sensors, (torch.Tensor, np.ndarray)):
        sensors = sensors.tolist()
    if not isinstance(sensors, (list, tuple)) or len(sensors) != len(params):
        other = f"{len(sensors)} sensors" if isinstance(sensors, (list, tuple)) else "one sensor"
        raise ValueError(
            f"render: params: a list has a mapping for each sensor of a list; got {len(params)} and {other}"
        )
    return sensors


def _by_view(settings: dict[str, Any]) -> torch.Tensor | Outputs:
    """`render` with parameters for each sensor: one after the other, since a view in a batch is that view alone."""
    params = settings.pop("params")
    sensors = sensors_of_list(settings.pop("sensor"), params)
    settings["seed"], gradient_seed = seeds(settings["seed"], settings["seed_grad"], settings["correlated"])
    settings["seed_grad"] = None if settings["correlated"] else gradient_seed
    scene = settings.pop("scene")
    settings["on_interrupt"] = interruption = interruption_of(settings["on_interrupt"])
    found = [render(scene, sensor=[s], params=p, **settings) for s, p in zip(sensors, params, strict=True)]
    interruption.warn()
    if settings["outputs"] is None:
        return torch.cat(found)
    return collect(check_names(settings["outputs"]), [torch.cat(parts) for parts in zip(*found, strict=True)])


def _mixes(packed: Layout) -> bool:
    """Whether there are blends or masks: paths of the derivative may choose other branches, and hit other things."""
    return any(kind in ("blendbsdf", "mask") for kind, _, _ in packed.objects["bsdf"])


def _view(
    scene: Scene,
    call: RenderCall,
    names: Sequence[str],
    stack: Stack | None,
    tensors: list[torch.Tensor],
    radiance: Callable[[], torch.Tensor | tuple[torch.Tensor, ...]],
) -> dict[str, Any]:
    """The outputs of one sensor by name; `radiance` renders what paths are traced for."""
    found: dict[str, torch.Tensor] = {}
    if stack is not None:
        found.update(first_hits(scene, call, stack.outputs(), tensors, zero_at_misses=True))
    if (stack is None and any(n in PATH_OUTPUTS for n in names)) or (stack is not None and stack.integrator):
        result = radiance()
        kinds = ("rgb", *call.extra)
        found.update(zip(kinds, result if isinstance(result, tuple) else (result,), strict=True))
    others = [n for n in names if n not in PATH_OUTPUTS]
    if others:
        found.update(first_hits(scene, call, others, tensors))
    return {name: value.to(call.place) for name, value in found.items()}


def _native(call: RenderCall, tensors: list[torch.Tensor]) -> Any:
    return RenderFunction.apply(call, *tensors)


def _traced(traced: Any, _: RenderCall, tensors: list[torch.Tensor]) -> Any:
    return traced.apply(tensors)


def _radiance(scene: Scene, call: RenderCall, *others: Any) -> Any:
    """What paths are traced for, see `_parts`."""
    return joined(_parts(scene, call, *others), call.film)


def _parts(
    scene: Scene,
    call: RenderCall,
    tensors: list[torch.Tensor],
    camera: Sensor,
    trace: Callable[[RenderCall, list[torch.Tensor]], Any],
    outlined: bool,
) -> list[Any]:
    """What paths are traced for: one time, or for each group of the film's bands."""
    parts = []
    for weights in groups(call.film):
        part, own = call, sensor_weights(weights, camera.srf)
        if weights is not None:
            wavelengths, held = wavelength_config(scene, call.layout, tensors, own)
            part = replace(call, config={**call.config, "spectral": wavelengths}, held=held)
        found = trace(part, tensors)
        if own is not None and has_derivative(own):
            from .film_responses import with_responses  # when it is needed

            found = with_responses(part, tensors, call.share.replicated([own])[0], found)
        whole = call.share.averaged(part, tensors, found if isinstance(found, tuple) else (found,))
        found = whole if isinstance(found, tuple) else whole[0]
        parts.append(_with_outlines(part, tensors, found) if outlined else found)
    return parts


def _with_outlines(
    call: RenderCall, tensors: list[torch.Tensor], result: torch.Tensor | tuple[torch.Tensor, ...]
) -> torch.Tensor | tuple[torch.Tensor, ...]:
    """`result` with the derivative of outlines that the camera sees, where something that moves them may have one."""
    if not call.may_move_outlines(tensors):
        return result
    from .visibility.boundary import outline_terms  # when it is needed

    terms = outline_terms(call, tensors)
    if terms is None:
        return result
    terms = call.share.summed(terms)
    if not isinstance(result, tuple):
        return result + terms[0].to(result.device)
    terms = [term.to(value.device) for value, term in zip(result, terms)]
    count = len(terms)  # the image, and alpha where that is wanted
    return *(value + term for value, term in zip(result[:count], terms, strict=True)), *result[count:]


def arrange(images: list[torch.Tensor], batched: bool, layout: str, channels: int) -> torch.Tensor:
    """`channels`: see `channels_of`."""
    want_batch = batched or layout.startswith("b")
    image = torch.stack(images) if want_batch else images[0]
    if not channels or not layout.endswith("chw"):
        return image
    first = 1 if want_batch else 0
    return image.movedim(-1, first) if channels != -4 else image.movedim((-1, -2), (first, first + 1))


def _check_derivatives(call: RenderCall, tensors: list[torch.Tensor]) -> None:
    if torch.is_grad_enabled():
        call.requirements.check(i for i, tensor in enumerate(tensors) if tensor.requires_grad)
