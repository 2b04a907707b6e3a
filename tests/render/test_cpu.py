"""The compiled renderer against the plain one, and its invariances."""

import math

import numpy as np
import pytest
import torch

from splatwire.neural.render.differentiable import render_differentiable
from splatwire.neural.render.reference import render_reference
from splatwire.ops import threads as ops_threads
from splatwire.ops.arrays import to_arrays
from splatwire.render import cpu
from splatwire.render.cpu import render_cpu
from splatwire.types import Cameras, Gaussians

BACKGROUND = torch.tensor([0.2, 0.5, 0.9])


def make_cameras(width: int = 45, height: int = 37, num_views: int = 1) -> Cameras:
    """Off-centre principal point, different focal lengths, sizes that are no multiple of a tile."""
    poses = torch.eye(4).repeat(num_views, 1, 1)
    for v in range(num_views):
        c, s = math.cos(0.2 * v), math.sin(0.2 * v)
        poses[v, :3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        poses[v, :3, 3] = torch.tensor([0.1 * v, -0.05, 0.2])
    K = torch.tensor([[50.0, 0, 24.3], [0, 48.0, 17.2], [0, 0, 1]])
    return Cameras(poses, K.repeat(num_views, 1, 1), width, height, tuple(f"v{v}" for v in range(num_views)))


def make_gaussians(count: int, seed: int, dtype: torch.dtype = torch.float64) -> list[torch.Tensor]:
    """Gaussians behind the near plane, far outside the image, above the opacity cap, and invisible."""
    generator = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    means = (rand(count, 3) - 0.5) * torch.tensor([6.0, 5.0, 4.5]) + torch.tensor([0.0, 0.0, 2.0])
    quats = torch.nn.functional.normalize(rand(count, 4) - 0.5, dim=1)
    scales = torch.exp(-3.5 + 1.8 * rand(count, 3))
    return [t.to(dtype) for t in (means, quats, scales, rand(count) * 1.2, rand(count, 3))]


def drawn(gaussians: Gaussians, cameras: Cameras, background: torch.Tensor) -> np.ndarray:
    """Picture of the renderer of numpy arrays."""
    return render_cpu(*to_arrays((gaussians, cameras)), background=background.numpy())


@pytest.mark.parametrize("seed", range(3))
def test_picture_and_gradients_match_the_reference(seed: int) -> None:
    cameras = make_cameras(num_views=2)
    exact = [t.requires_grad_() for t in [*make_gaussians(200, seed), BACKGROUND.double()]]
    single = [t.detach().float().requires_grad_() for t in exact]
    probe = torch.zeros(2, 200, 2, requires_grad=True)
    expected = render_reference(Gaussians(*exact[:5]), cameras, background=exact[5])
    actual = render_differentiable(Gaussians(*single[:5]), cameras, background=single[5], probe=probe)
    assert (actual - expected).abs().max() < 5e-6
    weights = torch.randn(expected.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    (expected * weights).sum().backward()
    (actual * weights.float()).sum().backward()
    for a, e in zip(single, exact, strict=True):
        assert (a.grad - e.grad).abs().max() < 1e-5 * e.grad.abs().max()
    assert probe.grad is not None
    assert probe.grad.abs().max() > 0


def test_probe_receives_centre_gradients_in_pixels() -> None:
    """A moved principal point moves all centres and changes nothing else, as long as no Jacobian is clamped."""
    means = torch.tensor([[0.1, -0.1, 2.0], [-0.3, 0.2, 3.0]])
    fields = [means, *[t[:2] for t in make_gaussians(2, 5, torch.float32)[1:]]]
    cameras = make_cameras()
    probe = torch.zeros(1, 2, 2, requires_grad=True)
    weights = torch.randn(1, 37, 45, 3, generator=torch.Generator().manual_seed(0))
    (render_differentiable(Gaussians(*fields), cameras, background=BACKGROUND, probe=probe) * weights).sum().backward()

    def loss(shift: tuple[float, float]) -> float:
        K = cameras.Ks.double().clone()
        K[0, 0, 2] += shift[0]
        K[0, 1, 2] += shift[1]
        moved = Cameras(cameras.viewmats, K, cameras.width, cameras.height, cameras.names)
        picture = render_reference(Gaussians(*[t.double() for t in fields]), moved, background=BACKGROUND.double())
        return float((picture * weights).sum())

    step = 1e-5
    for axis in range(2):
        shift = (step, 0.0) if axis == 0 else (0.0, step)
        slope = (loss(shift) - loss((-shift[0], -shift[1]))) / (2 * step)
        assert probe.grad[0, :, axis].sum().item() == pytest.approx(slope, rel=1e-3, abs=1e-4)


def test_result_does_not_depend_on_threads_or_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = make_cameras(210, 150)
    results = []
    for threads, entries in ((1, 1 << 23), (2, 1 << 23), (2, 1000)):
        monkeypatch.setattr(cpu, "MAX_ENTRIES", entries)
        monkeypatch.setattr(cpu, "allowed_threads", lambda threads=threads: threads)
        monkeypatch.setattr(ops_threads, "allowed_threads", lambda threads=threads: threads)
        fields = [t.requires_grad_() for t in make_gaussians(3000, 1, torch.float32)]
        picture = render_differentiable(Gaussians(*fields), cameras, background=BACKGROUND)
        gradients = torch.autograd.grad((picture * picture).sum(), fields)
        results.append([picture.detach(), *gradients])
    assert all(torch.equal(a, b) for a, b in zip(results[0], results[1], strict=True))
    assert torch.equal(results[0][0], results[2][0])
    for a, b in zip(results[0], results[2], strict=True):  # sums over tiles are added in another grouping
        assert torch.allclose(a, b, rtol=1e-4, atol=1e-5 * float(a.abs().max()))


def test_band_memory_stays_within_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpu, "MAX_ENTRIES", 1000)
    arrays = [t.numpy() for t in make_gaussians(3000, 1, torch.float32)]
    picture = cpu.ViewRasterizer(arrays, make_cameras(210, 150), 0, for_gradients=False)
    bands = list(picture._bands())
    assert len(bands) > 3
    assert [b.first_row for b in bands] == [first for first, _ in picture.band_ranges]
    assert all(
        len(b.ids) <= 1000 or last - first == 1 for b, (first, last) in zip(bands, picture.band_ranges, strict=True)
    )


def make_needles(count: int, seed: int) -> list[torch.Tensor]:
    """Long and thin in all directions, so that most tiles of their boxes are empty."""
    fields = make_gaussians(count, seed)
    fields[2] = torch.tensor([0.4, 0.003, 0.003]).expand(count, 3).double()
    return fields


def test_elongated_gaussians_are_binned_tightly_and_rendered_like_the_reference() -> None:
    cameras, fields = make_cameras(90, 70), make_needles(80, 4)
    single = [t.float() for t in fields]
    expected = render_reference(Gaussians(*fields), cameras, background=BACKGROUND.double())
    # Exponents of elongated near Gaussians have many digits, which single precision rounds; a missing row would show
    # ten times more.
    assert np.abs(drawn(Gaussians(*single), cameras, background=BACKGROUND) - expected.numpy()).max() < 2e-4
    picture = cpu.ViewRasterizer([t.numpy() for t in single], cameras, 0, for_gradients=False)
    boxes = np.prod(picture.tiles[:, 2:] - picture.tiles[:, :2], axis=1).sum()
    bands = list(picture._bands())
    assert sum(len(band.ids) for band in bands) < 0.7 * boxes
    assert all((band.spans[:, 0] < band.spans[:, 1]).all() for band in bands)


def test_empty_scene_renders_the_background() -> None:
    cameras = make_cameras()
    for fields in (make_gaussians(0, 0, torch.float32), make_gaussians(30, 0, torch.float32)):
        fields[0] = fields[0] - torch.tensor([0.0, 0.0, 50.0])
        picture = drawn(Gaussians(*fields), cameras, background=BACKGROUND)
        assert np.array_equal(picture, np.broadcast_to(BACKGROUND, (1, 37, 45, 3)))


@pytest.mark.parametrize(
    ("field", "value"),
    [(f, v) for f in range(4) for v in (math.nan, math.inf, -math.inf) if (f, v) != (3, math.inf)],
)
def test_non_finite_gaussians_are_not_drawn(field: int, value: float) -> None:
    fields = make_gaussians(40, 3, torch.float32)
    without = Gaussians(*[t[1:] for t in fields])
    fields[field] = fields[field].clone()
    fields[field][0] = value
    picture = drawn(Gaussians(*fields), make_cameras(), background=BACKGROUND)
    assert np.array_equal(picture, drawn(without, make_cameras(), background=BACKGROUND))


def test_equal_depths_keep_their_order() -> None:
    mean = torch.tensor([[0.0, 0.0, 2.0]]).repeat(2, 1)
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1)
    colors = torch.tensor([[1.0, 0, 0], [0, 1.0, 0]])
    gaussians = Gaussians(mean, quats, torch.full((2, 3), 0.3), torch.full((2,), 0.9), colors)
    picture = drawn(gaussians, make_cameras(), background=torch.zeros(3))[0]
    brightest = picture[..., 0].argmax()
    red, green = picture.reshape(-1, 3)[brightest, :2]
    assert red > 5 * green > 0


def test_work_of_a_huge_gaussian_is_bounded() -> None:
    """Ten thousand opaque Gaussians cover every tile: the lists are long but rendering stops early."""
    fields = make_gaussians(10_000, 2, torch.float32)
    fields[0] = torch.tensor([0.0, 0.0, 3.0]) + 0.01 * fields[0]
    fields[2] = torch.full((10_000, 3), 5.0)
    fields[3] = torch.full((10_000,), 0.9)
    picture = drawn(Gaussians(*fields), make_cameras(160, 160), background=BACKGROUND)
    assert np.isfinite(picture).all()
    assert np.ptp(picture) < 1.5
