"""The plain renderer against closed forms and finite differences."""

import math

import pytest
import torch

from splatwire.neural.render.reference import render_reference, rotation_matrices
from splatwire.types import Cameras, Gaussians

FOCAL, DEPTH, SIZE = 40.0, 2.0, 33
BLACK = torch.zeros(3, dtype=torch.float64)


def camera() -> Cameras:
    K = torch.tensor([[[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]]], dtype=torch.float64)
    return Cameras(torch.eye(4, dtype=torch.float64)[None], K, SIZE, SIZE, ("only",))


def stack(opacities: list[float], depths: list[float] | None = None, sigma: float = 0.1) -> Gaussians:
    """Round Gaussians on the viewing axis, each in a different colour."""
    n = len(opacities)
    means = torch.zeros(n, 3, dtype=torch.float64)
    means[:, 2] = torch.tensor(depths or [DEPTH] * n, dtype=torch.float64)
    quats = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).repeat(n, 1)
    colors = torch.eye(3, dtype=torch.float64)[torch.arange(n) % 3]
    return Gaussians(means, quats, torch.full((n, 3), sigma).double(), torch.tensor(opacities).double(), colors)


def test_one_gaussian_renders_its_closed_form() -> None:
    picture = render_reference(stack([0.8]), camera(), background=BLACK)[0, ..., 0]
    variance = (FOCAL / DEPTH * 0.1) ** 2 + 0.3
    middle = SIZE // 2  # pixel centre (16.5, 16.5) is the principal point
    for dx, dy in ((0, 0), (1, 0), (0, -2), (3, 1)):
        expected = 0.8 * math.exp(-(dx * dx + dy * dy) / (2 * variance))
        assert picture[middle + dy, middle + dx].item() == pytest.approx(expected, rel=1e-6)


def test_faint_parts_are_skipped_and_opaque_ones_capped() -> None:
    picture = render_reference(stack([0.8]), camera(), background=BLACK)[0, ..., 0]
    assert picture[picture > 0].min() >= 1 / 255
    assert picture[0, 0] == 0
    centre = render_reference(stack([1.0]), camera(), background=BLACK)[0, SIZE // 2, SIZE // 2, 0]
    assert centre.item() == pytest.approx(0.99)


def test_blending_is_front_to_back() -> None:
    gaussians = stack([0.6, 0.5], depths=[3.0, 2.0])
    background = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    centre = render_reference(gaussians, camera(), background=background)[0, SIZE // 2, SIZE // 2]
    assert centre.tolist() == pytest.approx([0.5 * 0.6, 0.5, 0.5 * 0.4])


def test_pixel_stops_before_transmittance_falls_below_the_limit() -> None:
    """0.01 remains after the first, and 0.0001 would fall below the limit after the second; the third is unused."""
    gaussians = stack([0.99, 0.9902, 0.9], depths=[1.0, 2.0, 3.0])
    kept = render_reference(stack([0.99], depths=[1.0]), camera(), background=BLACK)
    drawn = render_reference(gaussians, camera(), background=BLACK)
    limit = render_reference(stack([0.99, 0.98], depths=[1.0, 2.0]), camera(), background=BLACK)
    middle = (0, SIZE // 2, SIZE // 2)
    assert limit[middle].tolist() == pytest.approx([0.99, 0.0098, 0])
    assert drawn[middle][0] == kept[middle][0]
    assert drawn[middle][2] < 0.01


def test_near_gaussians_are_not_drawn() -> None:
    assert render_reference(stack([0.9], depths=[0.2]), camera(), background=BLACK).abs().max() == 0
    assert render_reference(stack([0.9], depths=[0.2001]), camera(), background=BLACK).abs().max() > 0


def test_rendering_is_invariant_to_rigid_motion() -> None:
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(20, 3, generator=generator, dtype=torch.float64) - 0.5 + torch.tensor([0, 0, 2.0])
    quats = torch.nn.functional.normalize(torch.randn(20, 4, generator=generator, dtype=torch.float64), dim=1)
    scales = 0.05 + 0.2 * torch.rand(20, 3, generator=generator, dtype=torch.float64)
    rest = (torch.rand(20, generator=generator).double(), torch.rand(20, 3, generator=generator).double())
    before = render_reference(Gaussians(means, quats, scales, *rest), camera(), background=BLACK)

    turn = torch.nn.functional.normalize(torch.randn(1, 4, generator=generator, dtype=torch.float64), dim=1)
    matrix = rotation_matrices(turn)[0]
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = matrix.T
    w1, v1 = turn[0, 0], turn[0, 1:]
    w2, v2 = quats[:, :1], quats[:, 1:]
    product = torch.cat(
        [w1 * w2 - (v1 * v2).sum(1, keepdim=True), w1 * v2 + w2 * v1 + torch.linalg.cross(v1.expand(20, 3), v2)], dim=1
    )
    cameras = Cameras(pose[None], camera().Ks, SIZE, SIZE, ("turned",))
    after = render_reference(Gaussians(means @ matrix.T, product, scales, *rest), cameras, background=BLACK)
    assert (before - after).abs().max() < 1e-9


def test_gradients_equal_finite_differences() -> None:
    fields = [torch.tensor([[0.1, -0.2, 2.0]]), torch.tensor([[0.7, 0.1, -0.5, 0.5]]), torch.tensor([[0.2, 0.05, 0.1]])]
    fields = [t.double() for t in [*fields, torch.tensor([0.7]), torch.tensor([[0.3, 0.6, 0.9]])]]
    fields[1] = torch.nn.functional.normalize(fields[1], dim=1)
    weights = torch.zeros(1, SIZE, SIZE, 3, dtype=torch.float64)
    weights[0, 10:20, 12:22] = torch.rand(10, 10, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def loss(*f: torch.Tensor) -> torch.Tensor:
        return (render_reference(Gaussians(*f), camera(), background=BLACK) * weights).sum()

    inputs = tuple(t.requires_grad_() for t in fields)
    assert torch.autograd.gradcheck(loss, inputs, eps=1e-6, atol=1e-6)
