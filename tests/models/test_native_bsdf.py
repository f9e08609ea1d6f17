"""`tr.native_bsdf` against the same models in plain PyTorch (tests/oracle/bsdf), finite differences, the renderer."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest
import torch
from bsdf_models import CASES, DECLARED, in_plain_pytorch, pairs, parameters
from oracle.bsdf import MODELS
from torch.autograd import forward_ad
from uniform_numbers import uniform

import torchrender as tr

pytestmark = pytest.mark.once  # in double precision, which does not depend on it

N = 300


def models_with(flag: str = "") -> pytest.MarkDecorator:
    cases = [(kind, c) for kind, c in CASES if not flag or flag in DECLARED[kind].flags]
    names = [" ".join(map(str, (kind, *c.values()))) for kind, c in cases]
    return pytest.mark.parametrize(("kind", "choices"), cases, ids=names)


EACH, SMOOTH, DELTA = models_with(), models_with("has_smooth_lobes"), models_with("has_delta_lobes")


def close(found: torch.Tensor, expected: torch.Tensor, what: str, rtol: float = 1e-9) -> None:
    scale = max(1.0, float(expected.detach().abs().max())) if expected.numel() else 1.0
    torch.testing.assert_close(found, expected, rtol=rtol, atol=1e-13 * scale, msg=lambda text: f"{what}: {text}")


def attached(values: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: v.clone().requires_grad_() for name, v in values.items()}


def gradients(output: torch.Tensor, inputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Of a sum over the output with weights that are all different; zeros of what it does not depend on."""
    weight = torch.linspace(0.5, 1.5, output.numel(), dtype=output.dtype).reshape(output.shape)
    if not output.requires_grad:
        return {name: torch.zeros_like(x) for name, x in inputs.items()}
    found = torch.autograd.grad((output * weight).sum(), list(inputs.values()), retain_graph=True, allow_unused=True)
    return {n: torch.zeros_like(x) if g is None else g for (n, x), g in zip(inputs.items(), found, strict=True)}


def test_every_model_is_among_the_cases():
    assert {kind for kind, _ in CASES} == set(DECLARED) == set(MODELS) - {"mask"}


# ------------------------------------------------------------------------------------------------- plain PyTorch
@EACH
@pytest.mark.parametrize("channels", [1, 3])
def test_values_and_densities(kind, choices, channels):
    native = tr.native_bsdf(kind, channels=channels, **choices)
    values, (wi, wo) = parameters(kind, N, channels), pairs(N)
    plain, lobe = in_plain_pytorch(kind, choices, values, channels), torch.zeros(N, dtype=torch.int64)
    if plain.smooth:
        expected = plain.eval(wi, wo, lobe)
        assert float((expected > 0).double().mean()) > 0.2
        close(native.eval(values, wi, wo), expected, "value")
    else:
        assert not bool(native.eval(values, wi, wo).any())
    close(native.pdf(values, wi, wo), plain.pdf(wi, wo), "density")


@EACH
@pytest.mark.parametrize("channels", [1, 3])
def test_samples(kind, choices, channels):
    """Directions, densities, lobes and what is attached of them; and the value of the lobe that was sampled."""
    native = tr.native_bsdf(kind, channels=channels, **choices)
    values, wi, u = attached(parameters(kind, N, channels)), pairs(N)[0].requires_grad_(), uniform(N, 5).double()
    plain = in_plain_pytorch(kind, choices, values, channels)
    found, expected = native.sample(values, wi, u), plain.sample(wi, u)
    assert torch.equal(found.lobe, expected.lobe)
    assert bool((found.pdf > 0).any())
    taken = found.pdf > 0
    close(found.pdf, expected.pdf.detach(), "density", 1e-7)
    close(found.eta[taken], expected.eta.detach().expand(N)[taken], "index")
    close(found.wo[taken], expected.wo[taken], "direction", 1e-8)
    assert not any(t.requires_grad for t in (found.pdf, found.eta, found.lobe, found.delta, found.value))
    assert torch.equal(
        found.delta, torch.full_like(found.delta, plain.delta) & (~torch.tensor(plain.smooth) | (found.lobe > 0))
    )
    value = plain.eval(wi, found.wo, found.lobe)
    close(found.value[taken], value[taken].detach(), "value")
    close(native.eval(values, wi, found.wo, found.lobe)[taken], value[taken], "value of the lobe")
    if plain.delta:
        inputs = {"wi": wi, **values}
        used = (taken & found.delta)[:, None]
        for output in ("wo", "value"):
            a, b = (
                s.wo if output == "wo" else bsdf.eval(*given, s.wo, s.lobe)
                for s, bsdf, given in ((found, native, (values, wi)), (expected, plain, (wi,)))
            )
            a, b = (gradients(torch.where(used, x, 0.0), inputs) for x in (a, b))
            for name in inputs:
                close(a[name], b[name], f"{output} by {name}")


@SMOOTH
@pytest.mark.parametrize("channels", [1, 3])
def test_gradients(kind, choices, channels):
    """By all parameters and both directions."""
    native = tr.native_bsdf(kind, channels=channels, **choices)
    values = attached(parameters(kind, N, channels))
    wi, wo = (d.requires_grad_() for d in pairs(N))
    plain = in_plain_pytorch(kind, choices, values, channels)
    inputs = {"wi": wi, "wo": wo, **values}
    found = gradients(native.eval(values, wi, wo), inputs)
    expected = gradients(plain.eval(wi, wo, torch.zeros(N, dtype=torch.int64)), inputs)
    for name in inputs:
        close(found[name], expected[name], name, 1e-8)
    assert sum(bool(g.any()) for g in found.values()) > len(inputs) / 2


def test_what_says_the_index_of_the_principled_model():
    """Of `specular` and `eta` the one that counts has a gradient."""
    native, (wi, wo) = tr.native_bsdf("principled"), pairs(N)
    values = attached({**parameters("principled", N), "eta": torch.tensor(0.0, dtype=torch.float64)})
    inputs = {n: values[n] for n in ("specular", "eta")}
    plain = in_plain_pytorch("principled", {}, values).eval(wi, wo, torch.zeros(N, dtype=torch.int64))
    found, expected = gradients(native.eval(values, wi, wo), inputs), gradients(plain, inputs)
    assert found["specular"] != 0 and found["eta"] == 0
    close(found["specular"], expected["specular"], "specular", 1e-8)


# -------------------------------------------------------------------------------------------- finite differences
FEW = 6


def clear_pairs() -> tuple[torch.Tensor, torch.Tensor]:
    """A few that are away from the horizon, where functions have kinks."""
    wi, wo = pairs(100, seed=8)
    clear = (wi[:, 2].abs() > 0.1) & (wo[:, 2].abs() > 0.1)
    return wi[clear][:FEW], wo[clear][:FEW]


@SMOOTH
def test_finite_differences(kind, choices):
    """Both modes of the derivative, by everything at once."""
    native, values = tr.native_bsdf(kind, **choices), parameters(kind, FEW, seed=4)
    # the derivatives of a table are differences over some percent
    fixed = {n: values.pop(n) for n in ("eta", "alpha")} if kind == "roughplastic" else {}
    wi, wo = clear_pairs()

    def function(wi: torch.Tensor, wo: torch.Tensor, *given: torch.Tensor) -> torch.Tensor:
        return native.eval({**fixed, **dict(zip(values, given, strict=True))}, wi, wo)

    inputs = [t.clone().requires_grad_() for t in (wi, wo, *values.values())]
    assert torch.autograd.gradcheck(function, inputs, check_forward_ad=True, check_undefined_grad=False)


@DELTA
def test_finite_differences_of_delta_lobes(kind, choices):
    """Of directions and values of the lobes that were sampled, which are kept."""
    native, values = tr.native_bsdf(kind, **choices), parameters(kind, FEW, seed=4)
    wi, u = clear_pairs()[0], uniform(FEW, 2)
    lobe = native.sample(values, wi, u).lobe
    delta = native.sample(values, wi, u).delta[:, None]

    def function(wi: torch.Tensor, *given: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        params = dict(zip(values, given, strict=True))
        s = native.sample(params, wi, u)
        assert torch.equal(s.lobe, lobe)
        value = native.eval(params, wi, s.wo.detach(), lobe)
        return torch.where(delta, s.wo, 0.0), torch.where(delta, value, 0.0)

    assert bool(delta.any())
    inputs = [t.clone().requires_grad_() for t in (wi, *values.values())]
    assert torch.autograd.gradcheck(function, inputs, check_forward_ad=True, check_undefined_grad=False)


def test_the_table_of_rough_plastic_is_differentiated():
    """By differences over the percent that the table's derivatives are made of, coarse as these are."""
    native, (wi, wo) = tr.native_bsdf("roughplastic", distribution="ggx"), pairs(N)
    values = parameters("roughplastic", N)
    for name, step in (("eta", 0.01), ("alpha", 0.02)):
        inputs = attached({name: values[name]})
        found = gradients(native.eval({**values, **inputs}, wi, wo), inputs)[name]
        weight = torch.linspace(0.5, 1.5, 3 * N, dtype=torch.float64).reshape(N, 3)
        high, low = ((native.eval({**values, name: values[name] + h}, wi, wo) * weight).sum() for h in (step, -step))
        torch.testing.assert_close(found, (high - low) / (2 * step), rtol=0.05, atol=0.0)


# ------------------------------------------------------------------------------------------------------- autograd
def metal(n: int = N) -> tuple[Any, dict[str, torch.Tensor], torch.Tensor, torch.Tensor]:
    return tr.native_bsdf("roughconductor", distribution="ggx"), attached(parameters("roughconductor", n)), *pairs(n)


def test_forward_mode_is_the_adjoint_of_reverse_mode():
    native, values, wi, wo = metal()
    inputs = {"wi": wi.requires_grad_(), "wo": wo.requires_grad_(), **values}
    generator = torch.Generator().manual_seed(2)
    tangents = {n: torch.randn(x.shape, generator=generator, dtype=x.dtype) for n, x in inputs.items()}
    with forward_ad.dual_level():
        duals = {n: forward_ad.make_dual(x.detach(), tangents[n]) for n, x in inputs.items()}
        pushed = forward_ad.unpack_dual(native.eval({n: duals[n] for n in values}, duals["wi"], duals["wo"])).tangent
    value = native.eval(values, wi, wo)
    adjoint = torch.randn(value.shape, generator=generator, dtype=value.dtype)
    pulled = torch.autograd.grad(value, list(inputs.values()), adjoint)
    expected = sum((g * tangents[n]).sum() for n, g in zip(inputs, pulled, strict=True))
    close((pushed * adjoint).sum(), expected, "derivative", 1e-12)


def test_torch_func():
    native, values, wi, wo = metal()
    values, u = {n: v.detach() for n, v in values.items()}, uniform(len(wi), 3)

    def loss(alpha: torch.Tensor) -> torch.Tensor:
        s = native.sample({**values, "alpha": alpha}, wi, u)
        return native.eval({**values, "alpha": alpha}, wi, s.wo, s.lobe).square().sum()

    alpha = values["alpha"].clone().requires_grad_()
    (expected,) = torch.autograd.grad(loss(alpha), alpha)
    close(torch.func.grad(loss)(values["alpha"]), expected, "gradient")
    _, tangent = torch.func.jvp(loss, (values["alpha"],), (torch.ones_like(values["alpha"]),))
    close(tangent, expected.sum(), "derivative along a direction")
    rows = torch.func.jacrev(lambda v: native.eval({**values, "alpha": v}, wi, wo).sum(0))(values["alpha"])
    close(rows.sum(0), gradient_of_sum(native, values, wi, wo), "Jacobian")
    with pytest.raises(tr.NotDifferentiableError, match="vmap does not reach into a native BSDF"):
        torch.func.vmap(loss)(torch.stack([values["alpha"]] * 2))


def gradient_of_sum(native, values, wi, wo) -> torch.Tensor:
    alpha = values["alpha"].clone().requires_grad_()
    return torch.autograd.grad(native.eval({**values, "alpha": alpha}, wi, wo).sum(), alpha)[0]


def test_second_derivatives_are_refused():
    """But for that of a gradient by its adjoint, in which it is linear."""
    native, values, wi, wo = metal()
    value = native.eval(values, wi, wo)
    adjoint = torch.ones_like(value, requires_grad=True)
    (gradient,) = torch.autograd.grad(value, values["alpha"], adjoint, create_graph=True)
    (pushed,) = torch.autograd.grad(gradient.sum(), adjoint, retain_graph=True)
    with forward_ad.dual_level():
        alpha = forward_ad.make_dual(values["alpha"].detach(), torch.ones_like(values["alpha"]))
        expected = forward_ad.unpack_dual(native.eval({**values, "alpha": alpha}, wi, wo)).tangent
    close(pushed, expected.detach(), "derivative by the adjoint")
    with pytest.raises(tr.NotDifferentiableError, match="native BSDFs have first derivatives only"):
        gradient.sum().backward()
    glass = tr.native_bsdf("dielectric")
    eta = torch.tensor(1.5, dtype=torch.float64, requires_grad=True)
    s = glass.sample({"eta": eta}, wi.detach(), uniform(N))
    (gradient,) = torch.autograd.grad(s.wo.sum(), eta, create_graph=True)
    with pytest.raises(tr.NotDifferentiableError, match="native BSDFs have first derivatives only"):
        gradient.backward()


# ------------------------------------------------------------------------------------------------------ arguments
@pytest.mark.core
@EACH
def test_single_precision(kind, choices):
    """Values, densities and gradients are those in double precision, as far as that goes."""
    native, (wi, wo) = tr.native_bsdf(kind, **choices), pairs(N)
    clear = (wi[:, 2].abs() > 0.1) & (wo[:, 2].abs() > 0.1)
    values = {n: v[clear] if v.ndim else v for n, v in parameters(kind, N).items()}
    wi, wo = wi[clear], wo[clear]
    lobe = native.sample(values, wi, uniform(len(wi))).lobe
    results = []
    for dtype in (torch.float64, torch.float32):
        inputs = {n: v.to(dtype).requires_grad_() for n, v in {"wi": wi, "wo": wo, **values}.items()}
        params = {n: v for n, v in inputs.items() if n not in ("wi", "wo")}
        value = native.eval(params, inputs["wi"], inputs["wo"], lobe)
        assert value.dtype == dtype
        pdf = native.pdf(params, inputs["wi"], inputs["wo"])
        results.append({"value": value.detach(), "pdf": pdf, **gradients(value, inputs)})
    for name, exact in results[0].items():
        error = (results[1][name].double() - exact).abs()
        assert bool((error <= 2e-3 * exact.abs() + 1e-4 * exact.abs().max() + 1e-12).all()), name


def test_rows_are_broadcast_and_defaults_apply():
    native, (wi, wo) = tr.native_bsdf("roughconductor"), pairs(5)
    declared = {"eta": 0.0, "k": 1.0, "alpha": 0.1, "specular_reflectance": 1.0}
    expected = native.eval(declared, wi, wo)
    assert torch.equal(native.eval({}, wi, wo), expected)
    rows = {"k": torch.full((5, 3), 1.0), "alpha": torch.full((5,), 0.1, dtype=torch.float64), "eta": [0.0, 0.0, 0.0]}
    assert torch.equal(native.eval(rows, wi, wo), expected)
    single = native.eval({"k": torch.ones(5, 1)}, wi[:1], wo)
    assert torch.equal(single, native.eval({}, wi[:1].expand(5, 3), wo))
    alpha = torch.linspace(0.1, 0.5, 5, dtype=torch.float64)
    many = native.eval({"alpha": alpha}, wi, wo)
    assert torch.equal(many, torch.cat([native.eval({"alpha": a}, i[None], o[None]) for a, i, o in zip(alpha, wi, wo)]))
    assert native.eval({}, wi[:0], wo[:0]).shape == (0, 3)
    assert native.sample({}, wi[:0], wi[:0]).wo.shape == (0, 3)
    mono = tr.native_bsdf("roughconductor", channels=1)
    assert torch.equal(mono.eval({}, wi, wo), expected[:, :1])


def test_it_is_the_bsdf_of_a_scene():
    bsdf = {"type": "roughplastic", "distribution": "ggx", "nonlinear": True, "alpha": 0.3, "eta": 1.6}
    scene = {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}
    probe = tr.testing.BsdfProbe(tr.load_dict(scene, dtype=torch.float64), "ball.bsdf")
    native, (wi, wo) = tr.native_bsdf("roughplastic", distribution="ggx", nonlinear=True), pairs(N)
    value, pdf = probe.eval(wi, wo)
    assert torch.equal(native.eval({"alpha": 0.3, "eta": 1.6}, wi, wo), value)
    assert torch.equal(native.pdf({"alpha": 0.3, "eta": 1.6}, wi, wo), pdf)
    s, expected = native.sample({"alpha": 0.3, "eta": 1.6}, wi, uniform(N)), probe.sample(wi, uniform(N))
    assert torch.equal(s.wo, expected.wo) and torch.equal(s.pdf, expected.pdf) and torch.equal(s.delta, expected.delta)


def test_copies():
    native, (wi, wo) = tr.native_bsdf("plastic", channels=1, nonlinear=True), pairs(5)
    assert repr(native) == "native_bsdf('plastic', channels=1, nonlinear=True)"
    for other in (copy.deepcopy(native), pickle.loads(pickle.dumps(native))):
        assert repr(other) == repr(native)
        assert torch.equal(other.eval({}, wi, wo), native.eval({}, wi, wo))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"type": 3}, TypeError, r"native_bsdf: type: expected the name of a BSDF, got 3"),
        ({"type": "difuse"}, ValueError, r"type: there is no BSDF 'difuse'; did you mean 'diffuse'"),
        ({"type": "twosided"}, ValueError, r"type: 'twosided' contains other BSDFs and has no functions of its own"),
        ({"type": "diffuse", "channels": 2}, ValueError, r"channels: expected 1 or 3, got 2"),
        ({"type": "diffuse", "nonlinear": True}, ValueError, r"'diffuse' has no choice 'nonlinear'"),
        ({"type": "plastic", "nonlinaer": True}, ValueError, r"no choice 'nonlinaer'; did you mean 'nonlinear'"),
        ({"type": "plastic", "nonlinear": 1}, ValueError, r"native_bsdf.nonlinear: expected True or False, got 1"),
        ({"type": "plastic", "eta": 1.5}, ValueError, r"no choice 'eta'; .*give it to eval, pdf and sample"),
        ({"type": "roughplastic", "distribution": "phong"}, ValueError, r"distribution: unknown word 'phong'"),
    ],
)
def test_which_models_there_are(arguments, error, message):
    with pytest.raises(error, match=message):
        tr.native_bsdf(**arguments)


@pytest.mark.parametrize(
    ("params", "changed", "error", "message"),
    [
        ([1], {}, TypeError, r"eval: params: expected tensors by name, got \[1\]"),
        ({"alhpa": 0.1}, {}, ValueError, r"eval: params: there is no 'alhpa'; did you mean 'alpha'"),
        ({"distribution": "ggx"}, {}, ValueError, r"no 'distribution'; it is a choice of native_bsdf"),
        ({"alpha": torch.ones(4)}, {}, ValueError, r"params: alpha: has 4 rows, where others have 5"),
        ({"alpha": torch.ones(5, 1)}, {}, ValueError, r"params: alpha: expected a number or shape \(N,\), got"),
        (
            {"k": torch.ones(5)},
            {},
            ValueError,
            r"params: k: expected a number or a colour of shape \(3,\) or \(N, 3\), got",
        ),
        ({"k": torch.ones(4, 3)}, {}, ValueError, r"params: k: has 4 rows, where others have 5"),
        ({"alpha": "rough"}, {}, TypeError, r"params: alpha: expected a tensor, got 'rough'"),
        ({"k": [[1.0], [2.0, 3.0]]}, {}, TypeError, r"params: k: expected a tensor, got \[\[1.0\], \[2.0, 3.0\]\]"),
        ({"alpha": None}, {}, TypeError, r"params: alpha: expected a tensor, got None"),
        ({"alpha": torch.ones((), device="meta")}, {}, ValueError, r"params: alpha: lies on meta"),
        ({"alpha": torch.ones((), dtype=torch.complex64)}, {}, TypeError, r"alpha: expected real numbers, got"),
        ({}, {"wi": torch.ones(5, 2)}, ValueError, r"eval: wi: expected shape \(N, 3\), got"),
        ({}, {"wo": torch.ones(3)}, ValueError, r"eval: wo: expected shape \(N, 3\), got"),
        ({}, {"wi": torch.ones(5, 3).half()}, TypeError, r"eval: wi: expected float32 or float64, got"),
        ({}, {"wo": torch.ones(4, 3)}, ValueError, r"eval: wo: has 4 rows, where others have 5"),
        ({}, {"lobe": 0.5}, TypeError, r"eval: lobe: expected integers, got 0.5"),
        ({}, {"lobe": torch.zeros(4).long()}, ValueError, r"eval: lobe: expected shape \(5,\), got"),
    ],
)
def test_wrong_arguments_are_named(params, changed, error, message):
    native = tr.native_bsdf("roughconductor")
    with pytest.raises(error, match=message):
        native.eval(params, **{"wi": torch.ones(5, 3), "wo": torch.ones(5, 3), **changed})


def test_a_table_is_of_one_roughness():
    native, (wi, wo) = tr.native_bsdf("roughplastic"), pairs(5)
    with pytest.raises(ValueError, match="params: alpha: expected one number, of which a table is made, got"):
        native.eval({"alpha": torch.full((5,), 0.2)}, wi, wo)
