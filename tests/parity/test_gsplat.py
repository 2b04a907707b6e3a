"""The renderers against gsplat, where a GPU exists."""

import numpy as np
import pytest
import torch

from gpu import DEVICE, NEEDS_GPU
from splatwire.neural.render.renderers import create_training_renderer
from splatwire.ops.arrays import to_arrays
from splatwire.render import create_renderer
from splatwire.types import Cameras, Gaussians

pytestmark = [*NEEDS_GPU, pytest.mark.slow]


def _gaussians(max_opacity: float) -> Gaussians:
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(2000, 3, generator=generator) * 2 - 1 + torch.tensor([0.0, 0.0, 3.0])
    quats = torch.nn.functional.normalize(torch.randn(2000, 4, generator=generator), dim=1)
    scales = 0.01 + 0.05 * torch.rand(2000, 3, generator=generator)
    opacities, colors = max_opacity * torch.rand(2000, generator=generator), torch.rand(2000, 3, generator=generator)
    return Gaussians(means, quats, scales, opacities, colors)


def _camera() -> Cameras:
    K = np.float32([[[150.0, 0, 80], [0, 150.0, 60], [0, 0, 1]]])
    return Cameras(np.eye(4, dtype=np.float32)[None], K, 160, 120, ("only",))


def test_gsplat_renders_like_the_cpu_renderer() -> None:
    gaussians, background = to_arrays(_gaussians(1.0)), np.float32([0.1, 0.2, 0.3])
    ours = create_renderer("cpu")(gaussians, _camera(), background=background)
    theirs = create_renderer("gsplat")(gaussians, _camera(), background=background)
    assert -10 * np.log10(np.mean((ours - theirs) ** 2)) > 50


def _gradients(device: str) -> dict[str, torch.Tensor]:
    """Gradients of a weighted pixel sum with respect to the Gaussians and their 2D centres, in pixels."""
    fields = {name: value.to(device).requires_grad_() for name, value in vars(_gaussians(0.9)).items()}
    draw, background = create_training_renderer(torch.device(device)), torch.tensor([0.1, 0.2, 0.3]).to(device)
    drawing = draw(Gaussians(**fields), _camera(), background=background, center_gradients=True)
    weight = torch.rand(120, 160, 3, generator=torch.Generator().manual_seed(1)).to(device)
    (drawing.image * weight).sum().backward()
    assert drawing.d_centers is not None
    found = {"image": drawing.image.detach().cpu(), "centers": drawing.d_centers.cpu()}
    for name, value in fields.items():
        assert value.grad is not None
        found[name] = value.grad.cpu()
    # gsplat normalises quaternions, so its gradient has no part along them; the spawning code removes that part
    quats, along = fields["quats"].detach().cpu(), found["quats"]
    found["quats"] = along - (along * quats).sum(dim=1, keepdim=True) * quats
    return found


def test_gsplat_gradients_equal_those_of_the_cpu_renderer() -> None:
    ours, theirs = _gradients("cpu"), _gradients(DEVICE)
    for name, expected in ours.items():
        assert float(expected.norm()) > 0, name
        assert float((theirs[name] - expected).norm() / expected.norm()) < 0.03, name


def test_scene_without_gaussians_renders_the_background() -> None:
    none = Gaussians(**{name: value[:0].to(DEVICE).requires_grad_() for name, value in vars(_gaussians(1.0)).items()})
    background = torch.tensor([0.1, 0.2, 0.3]).to(DEVICE)
    drawing = create_training_renderer(torch.device(DEVICE))(
        none, _camera(), background=background, center_gradients=True
    )
    drawing.image.sum().backward()
    assert torch.equal(drawing.image.cpu()[5, 7], background.cpu())
    assert drawing.d_centers is not None
    assert tuple(drawing.d_centers.shape) == (0, 2)
