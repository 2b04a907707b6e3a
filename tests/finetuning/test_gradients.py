"""Gradients of fine-tuning agree with those of the readable reference renderer in float64."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from close import assert_close
from shells import shell
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.rounding import coding_for, round_splats
from splatwire.files import mmap_array
from splatwire.finetuning.latents import Gradients, Latents, RoundingErrors, gradients_of
from splatwire.finetuning.receptions import SimulatedReception
from splatwire.finetuning.tune import picture_gradients
from splatwire.render.importance import cameras_around

torch = pytest.importorskip("torch")
from splatwire.neural.render.reference import render_reference  # noqa: E402 - needs torch
from splatwire.ops.spherical_harmonics import sh_basis  # noqa: E402
from splatwire.types import Gaussians  # noqa: E402

pytestmark = pytest.mark.needs_torch
NAMES = ("displacements", "rotations", "logs", "logits", "base", "harmonics")


def _product(p: Any, q: Any) -> Any:
    """Product of quaternions, tensors (N, 4)."""
    a, b = p[:, :1], p[:, 1:]
    c, d = q[:, :1], q[:, 1:]
    vector = a * d + c * b + torch.linalg.cross(b, d)
    return torch.cat([a * c - (b * d).sum(dim=1, keepdim=True), vector], dim=1)


def test_gaussians_of_an_iteration_need_no_temporary_file(monkeypatch: pytest.MonkeyPatch) -> None:
    latents = Latents.of(shell(60, 1).splats)
    monkeypatch.setattr(mmap_array, "LARGE_BYTES", 0)
    monkeypatch.setattr(mmap_array.tempfile, "TemporaryFile", lambda: pytest.fail("a file is written"))
    assert latents.splats().num_gaussians == 60


@pytest.mark.parametrize("rounded", [False, True])
@pytest.mark.parametrize("lossy", [False, True])
def test_gradients_equal_those_of_the_reference(rounded: bool, lossy: bool) -> None:
    scene = shell(60, 1)
    cameras = cameras_around(scene.splats.means, 3, 48)
    latents, offsets = Latents.of(scene.splats), None
    if rounded:
        exact = latents.splats()
        offsets = RoundingErrors.between(exact, round_splats(exact, coding_for(exact, Quality(level=4.0), None)))
    known = np.arange(60) % 5 > 0
    reception = SimulatedReception.from_mask(known) if lossy else None
    target = np.full((48, 48, 3), 0.4, np.float32)
    decoded = latents.splats(offsets)
    shown = decoded if reception is None else reception.received_splats(decoded)
    error, found = picture_gradients(replace(scene, splats=shown), cameras, 1, target)
    found = found if reception is None else reception.gradients(decoded, found)
    ours = gradients_of(latents, decoded, offsets, found)

    t = {name: torch.tensor(getattr(latents, name), dtype=torch.float64, requires_grad=True) for name in NAMES}
    fixed = {name: torch.tensor(getattr(latents, name), dtype=torch.float64) for name in ("centres", "units", "quats")}
    o = {} if offsets is None else {name: torch.tensor(v, dtype=torch.float64) for name, v in vars(offsets).items()}
    means = fixed["centres"] + fixed["units"][:, None] * t["displacements"] + o.get("means", 0)
    turn = torch.nn.functional.normalize(torch.cat([torch.ones(60, 1).double(), t["rotations"] / 2], dim=1), dim=1)
    quats = _product(fixed["quats"], turn)
    quats = _product(quats, o["quats"]) if o else quats
    scales, opacities = (t["logs"] + o.get("logs", 0)).exp(), (t["logits"] + o.get("logits", 0)).sigmoid()
    sh = torch.cat([(t["base"] + o.get("base", 0))[:, None], t["harmonics"] + o.get("harmonics", 0)], dim=1)
    if reception is not None:
        opacities = 1 - (1 - opacities.clamp(max=0.999)) ** reception.exponent
        scales = scales * reception.size_gain
    rays = means.detach().numpy() - cameras.centers[1]
    basis = torch.tensor(sh_basis(rays / np.linalg.norm(rays, axis=1, keepdims=True), 1))
    colors = (torch.einsum("gd,gdc->gc", basis, sh) + 0.5).clamp(min=0)
    some = torch.tensor(known if lossy else np.ones(60, bool))
    gaussians = Gaussians(*(values[some] for values in (means, quats, scales, opacities, colors)))
    behind = torch.tensor(scene.background, dtype=torch.float64)
    image = render_reference(gaussians, cameras.select([1]), background=behind)[0]
    loss = (image.clamp(0, 1) - torch.tensor(target)).square().mean().log()
    loss.backward()
    assert_close(np.exp(loss.item()), error, rtol=1e-4)
    for name in NAMES:
        expected = t[name].grad.numpy()
        assert np.abs(ours[name] - expected).max() < 1e-3 * np.abs(expected).max(), name


def test_gradients_of_lost_gaussians_are_zero() -> None:
    known = np.array([True, False, True])
    shapes = {"means": (2, 3), "quats": (2, 4), "scales": (2, 3), "opacities": (2,), "sh": (2, 1, 3)}
    found = Gradients(**{name: np.ones(shape, np.float32) for name, shape in shapes.items()})
    whole = SimulatedReception.from_mask(known).gradients(shell(3).splats, found)
    assert all((values[1] == 0).all() and (values[[0, 2]] != 0).all() for values in vars(whole).values())


def test_offsets_lead_from_exact_to_rounded_gaussians() -> None:
    splats = shell(300, 1).splats
    rounded = round_splats(splats, coding_for(splats, Quality(level=3.0), None))
    latents = Latents.of(splats)
    drawn = latents.splats(RoundingErrors.between(latents.splats(), rounded))
    assert_close(drawn.means, rounded.means, atol=1e-6)
    assert_close(np.sort(drawn.scales, axis=1)[:, ::-1], rounded.scales, rtol=1e-4)
    assert_close(drawn.opacities, rounded.opacities, atol=1e-4)
    assert_close(drawn.sh, rounded.sh, atol=1e-5)
    assert_close(_covariances(drawn), _covariances(rounded), atol=1e-5)


def _covariances(splats) -> np.ndarray:
    from splatwire.ops.quaternions import rotation_matrices

    axes = rotation_matrices(splats.quats.astype(np.float64)) * splats.scales[:, None, :]
    return axes @ axes.swapaxes(1, 2)
