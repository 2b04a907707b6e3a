import pytest
import torch

from close import assert_close
from splatwire.anchors.projection import project
from splatwire.neural.model.tensor_projection import ProjectedTensors, project_tensors
from splatwire.ops.arrays import to_arrays
from splatwire.types import Cameras


def camera(width: int = 64, height: int = 48) -> Cameras:
    K = torch.tensor([[[80.0, 0, width / 2], [0, 80.0, height / 2], [0, 0, 1]]])
    return Cameras(torch.eye(4)[None], K, width, height, ("only",))


def test_projected_covariance_equals_that_of_samples() -> None:
    """A small Gaussian on the viewing axis: the linearisation is nearly exact."""
    angle = torch.tensor(0.6)
    turn = torch.tensor([[angle.cos(), -angle.sin(), 0], [angle.sin(), angle.cos(), 0], [0, 0, 1]])
    scales, mean = torch.tensor([0.05, 0.01, 0.02]), torch.tensor([0.3, -0.2, 4.0])
    flat = project_tensors(mean[None], scales[None], turn[None], camera(), 0)
    samples = mean + (torch.randn(200_000, 3, generator=torch.Generator().manual_seed(0)) * scales) @ turn.T
    pixels = 80 * samples[:, :2] / samples[:, 2:] + torch.tensor([32.0, 24.0]) - 0.5
    sampled = torch.cov(pixels.T)
    assert torch.allclose(flat.means2d[0], pixels.mean(0), atol=0.01)
    expected = [sampled[0, 0].item() + 0.3, sampled[0, 1].item(), sampled[1, 1].item() + 0.3]
    assert flat.covs2d[0].tolist() == pytest.approx(expected, rel=0.02)


def test_partial_tiles_count_as_part_of_the_image() -> None:
    """Tiles of 16 pixels: a square touches the image if it reaches a listed tile, even one half outside."""
    centres = torch.tensor([[-6.0, 20.0], [-4.0, 20.0], [66.0, 20.0], [69.0, 20.0], [20.0, 52.9], [20.0, 53.1]])
    n = len(centres)
    flat = ProjectedTensors(centres, torch.ones(n, 3), torch.ones(n), torch.full((n,), 5.0))
    assert flat.touches_image(64, 48).tolist() == [False, True, True, False, True, False]


def test_near_gaussians_have_no_radius_and_finite_gradients() -> None:
    means = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [0.0, 0.0, 1.0]], requires_grad=True)
    flat = project_tensors(means, torch.full((3, 3), 0.1), None, camera(), 0)
    assert (flat.radii > 0).tolist() == [False, False, True]
    (flat.means2d.sum() + flat.covs2d.sum()).backward()
    assert means.grad is not None
    assert torch.isfinite(means.grad).all()


def test_numpy_and_torch_projections_agree() -> None:
    generator = torch.Generator().manual_seed(3)
    means = 4 * torch.rand(300, 3, generator=generator) + torch.tensor([-2.0, -2.0, -0.5])
    scales = 0.2 * torch.rand(300, 3, generator=generator)
    turns = torch.linalg.qr(torch.randn(300, 3, 3, generator=generator))[0]
    for rotations in (turns, None):
        theirs = project_tensors(means, scales, rotations, camera(), 0)
        ours = project(*to_arrays((means, scales, rotations, camera())), 0)
        for name in ("means2d", "covs2d", "depths", "radii"):
            assert_close(getattr(ours, name), getattr(theirs, name), rtol=1e-5, atol=1e-4)
        assert (ours.touches_image(64, 48) == theirs.touches_image(64, 48).numpy()).all()
