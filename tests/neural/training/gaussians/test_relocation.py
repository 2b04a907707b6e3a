"""Laws of moving and adding Gaussians."""

import itertools
import math

import numpy as np
import pytest
import torch

from scenes import tiny_cameras
from splatwire.neural.training.gaussians.config import GaussianConfig
from splatwire.neural.training.gaussians.relocation import MAX_COPIES, add_noise, relocate, shared_appearance
from splatwire.neural.training.gaussians.state import GaussianState, parameter_shapes
from splatwire.neural.training.kernels import uniform_from_host
from splatwire.neural.training.state import Moments
from splatwire.render.render import render_scene
from splatwire.types.background import BLACK


def state_of(opacities: list[float], degree: int = 1) -> GaussianState:
    """Gaussians in a row, with moments that are not 0."""
    generator = torch.Generator().manual_seed(1)
    shapes = parameter_shapes(len(opacities), degree)
    parameters = {name: 0.3 * torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    parameters["means"][:, 0] = torch.linspace(-1, 1, len(opacities))
    parameters["log_scales"] -= 2.0
    parameters["logits"] = torch.logit(torch.tensor(opacities))
    moments = {name: Moments(torch.ones(shape), torch.ones(shape), 3) for name, shape in shapes.items()}
    trained = {name: value.requires_grad_() for name, value in parameters.items()}
    return GaussianState(0, trained, moments, 1.0, generator)


def test_one_copy_is_the_gaussian_itself() -> None:
    opacities = torch.tensor([0.01, 0.3, 0.9])
    shared, factor = shared_appearance(opacities, torch.ones(3, dtype=torch.int64))
    torch.testing.assert_close(shared, opacities)
    torch.testing.assert_close(factor, torch.ones(3))


@pytest.mark.parametrize("copies", [2, 3, 7, 20, MAX_COPIES])
@pytest.mark.parametrize("opacity", [0.01, 0.5, 0.95])
def test_copies_have_the_opacity_at_the_centre_and_its_integral(copies: int, opacity: float) -> None:
    """The opacity of several equal Gaussians, one behind the other, is integrated numerically along a line."""
    shared, factor = (float(v[0]) for v in shared_appearance(torch.tensor([opacity]), torch.tensor([copies])))
    x = np.linspace(-12, 12, 200_001)

    def integral(values: np.ndarray) -> float:
        return float(values.sum() * (x[1] - x[0]))

    single = opacity * np.exp(-x * x / 2)
    together = 1 - (1 - shared * np.exp(-((x / factor) ** 2) / 2)) ** copies
    assert together.max() == pytest.approx(opacity, rel=1e-5)
    assert integral(together) == pytest.approx(integral(single), rel=1e-4)


def test_relocation_hardly_changes_the_picture() -> None:
    state = state_of([0.7, 0.6, 1e-4, 0.5, 2e-4, 0.8, 1e-4])
    cameras = tiny_cameras(3)
    before = render_scene(state.scene(1, BLACK), cameras)
    copied = state.scene(1, BLACK).splats
    relocate(state, 9, 0.005)
    after = render_scene(state.scene(1, BLACK), cameras)
    assert state.num_gaussians == 9
    assert bool((state.opacities > 0.005).all())
    assert before.max() > 0.3
    error = float(np.abs(after - before).mean())
    splats = state.scene(1, BLACK).splats
    assert len(np.unique(splats.means[:, 0])) == 4  # those of the visible Gaussians
    assert set(np.unique(splats.means[:, 0])) <= set(copied.means[:, 0])
    # copies without the formulas of the paper are far from it
    naive = state_of([0.7, 0.6, 1e-4, 0.5, 2e-4, 0.8, 1e-4])
    with torch.no_grad():
        index = torch.tensor([int(np.abs(copied.means[:, 0] - x).argmin()) for x in splats.means[:, 0]])
        naive.parameters = {name: value[index] for name, value in naive.parameters.items()}
    worse = float(np.abs(render_scene(naive.scene(1, BLACK), cameras) - before).mean())
    assert error < 0.25 * worse


def test_relocation_resets_the_moments_of_changed_gaussians_only() -> None:
    state = state_of([0.7, 1e-4, 0.6, 0.9])
    before = {name: value.detach().clone() for name, value in state.parameters.items()}
    relocate(state, 5, 0.005)
    same = [row for row in range(4) if bool((state.parameters["logits"][row] == before["logits"][row]).all())]
    assert same
    for name, moments in state.moments.items():
        assert moments.first.shape == state.parameters[name].shape
        for row, (first, second) in enumerate(zip(moments.first, moments.second, strict=True)):
            wanted = 1.0 if row in same else 0.0
            assert bool((first == wanted).all())
            assert bool((second == wanted).all())


def test_relocation_without_visible_gaussians_changes_nothing() -> None:
    state = state_of([1e-4, 2e-4])
    relocate(state, 4, 0.005)
    assert state.num_gaussians == 2


@pytest.mark.parametrize(("iterations", "count"), [(20, 10), (100, 3), (2400, 500), (30_000, 40_000)])
def test_number_of_gaussians_reaches_the_budget(iterations: int, count: int) -> None:
    config = GaussianConfig(gaussians=40_000, iterations=iterations)
    numbers = [count]
    for iteration in range(1, iterations + 1):
        if config.relocates(iteration):
            numbers.append(config.target_count(iteration, numbers[-1]))
    assert numbers[-1] == 40_000
    assert all(before <= after for before, after in itertools.pairwise(numbers))
    growing = [i for i in range(1, iterations + 1) if config.relocates(i)]
    assert growing
    assert max(growing) <= config.relocation.end * iterations


def test_noise_moves_transparent_gaussians_by_their_covariance() -> None:
    count = 4000
    state = state_of([1e-4] * count)
    with torch.no_grad():
        for name, value in state.parameters.items():
            value[:] = 0.0 if name == "means" else value[0].clone()
        state.parameters["logits"][: count // 2] = 3.0
    splats = state.scene(0, BLACK).splats
    add_noise(state, 2.0, uniform_from_host)
    moved = state.parameters["means"].detach().double().numpy()
    assert float(np.abs(moved[: count // 2]).max()) < 1e-6  # opaque Gaussians stay
    w, x, y, z = splats.quats[0].astype(np.float64)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    covariance = rotation @ np.diag(splats.scales[0].astype(np.float64) ** 2) @ rotation.T
    gate = 1 / (1 + math.exp(100 * (1e-4 - 0.005)))
    wanted = (2 * gate * covariance) @ (2 * gate * covariance).T
    found = np.cov(moved[count // 2 :].T)
    assert np.abs(found - wanted).max() < 0.15 * np.abs(wanted).max()
