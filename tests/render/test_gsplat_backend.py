import sys
import types

import pytest
import torch

import fake_gsplat
from splatwire.errors import BackendUnavailableError
from splatwire.neural.render.differentiable import draw_cpu
from splatwire.neural.render.gsplat_backend import GsplatRenderer, check_gsplat
from splatwire.neural.render.renderers import create_training_renderer
from splatwire.render import create_renderer
from splatwire.render.base import TrainingRenderer
from splatwire.types import Cameras, Gaussians


def test_missing_gsplat_error_names_the_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(BackendUnavailableError, match=r"splatwire\[gpu\]"):
        create_renderer("gsplat")


def test_missing_gpu_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", types.ModuleType("gsplat"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(BackendUnavailableError, match="CUDA device"):
        create_renderer("gsplat")


@pytest.fixture
def gsplat(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """A fake gsplat on the CPU."""
    module = fake_gsplat.module()
    monkeypatch.setitem(sys.modules, "gsplat", module)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    return module


def _gaussians(count: int) -> Gaussians:
    rng = torch.Generator().manual_seed(0)
    means = torch.rand(count, 3, generator=rng) * torch.tensor([3.0, 3.0, 1.0]) + torch.tensor([-1.5, -1.5, 2.0])
    quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=rng), dim=1)
    scales = 0.02 + 0.2 * torch.rand(count, 3, generator=rng)
    opacities, colors = 0.9 * torch.rand(count, generator=rng), torch.rand(count, 3, generator=rng)
    return Gaussians(*(t.requires_grad_() for t in (means, quats, scales, opacities, colors)))


def _camera() -> Cameras:
    return Cameras(torch.eye(4)[None], torch.tensor([[[40.0, 0, 20], [0, 44.0, 12], [0, 0, 1]]]), 40, 24, ("only",))


def _across(unit: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Vectors without their part along unit vectors, (N, K) each."""
    return vectors - (vectors * unit).sum(dim=1, keepdim=True) * unit


@pytest.mark.parametrize("count", [0, 60])
def test_training_renderers_return_centre_gradients(count: int, gsplat: types.ModuleType) -> None:
    background, weight = (
        torch.tensor([0.1, 0.2, 0.3]),
        torch.rand(24, 40, 3, generator=torch.Generator().manual_seed(1)),
    )
    results = []
    for draw in (draw_cpu, GsplatRenderer().draw):
        assert isinstance(draw, TrainingRenderer)
        gaussians = _gaussians(count)
        drawing = draw(gaussians, _camera(), background=background, center_gradients=True)
        assert drawing.d_centers is None
        (drawing.image * weight).sum().backward()
        assert drawing.d_centers is not None
        pulls = {name: t.grad for name, t in vars(gaussians).items()}
        # gsplat normalises quaternions, so its gradient has no part along them
        pulls["quats"] = _across(gaussians.quats.detach(), pulls["quats"])
        results.append([drawing.image.detach(), drawing.d_centers, *pulls.values()])
        assert draw(_gaussians(count), _camera(), background=background, center_gradients=False).d_centers is None
    assert count == 0 or float(results[0][1].norm(dim=1).max()) > 0.1
    assert [t.shape for t in results[0]] == [t.shape for t in results[1]]
    for own, theirs in zip(*results, strict=True):
        torch.testing.assert_close(own, theirs, atol=2e-3, rtol=2e-3)


def test_centre_gradients_are_in_pixels(gsplat: types.ModuleType) -> None:
    """A Gaussian and the principal point, moved together by a part of a pixel, against the gradient."""
    weight = torch.linspace(0, 1, 40)[None, :, None].expand(24, 40, 3)
    place = torch.tensor([[0.1, 0.05, 2.0]], requires_grad=True)
    one = torch.ones(1)
    gaussians = Gaussians(place, torch.eye(4)[:1], torch.full((1, 3), 0.15), 0.8 * one, torch.ones(1, 3))
    for draw in (draw_cpu, GsplatRenderer().draw):
        camera = _camera()
        drawing = draw(gaussians, camera, background=torch.zeros(3), center_gradients=True)
        (drawing.image * weight).sum().backward()
        assert drawing.d_centers is not None
        sums = []
        for shift in (0.05, -0.05):
            Ks = camera.Ks.clone()
            Ks[0, 0, 2] += shift
            moved = Cameras(camera.viewmats, Ks, camera.width, camera.height, camera.names)
            image = draw(gaussians, moved, background=torch.zeros(3), center_gradients=False).image
            sums.append(float((image.detach() * weight).sum()))
        assert abs(sums[0] - sums[1]) > 0.1
        assert float(drawing.d_centers[0, 0]) == pytest.approx((sums[0] - sums[1]) / 0.1, rel=0.05)


def test_gsplat_is_probed_with_one_gaussian(gsplat: types.ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    check_gsplat("cpu")

    def without_kernels(*words: object, **more: object) -> None:
        raise AttributeError("'NoneType' object has no attribute 'projection'")

    def without_centres(*words: object, **more: object) -> object:
        images, alphas, found = fake_gsplat.rasterization(*words, **more)  # type: ignore[arg-type]
        return images, alphas, {"means2d": found["means2d"].detach()}

    for broken in (without_kernels, without_centres):
        monkeypatch.setattr(gsplat, "rasterization", broken)
        with pytest.raises(BackendUnavailableError, match="do not run here"):
            check_gsplat("cpu")


def test_training_refuses_unknown_devices(gsplat: types.ModuleType) -> None:
    assert create_training_renderer(torch.device("cpu")) is draw_cpu
    assert isinstance(create_training_renderer(torch.device("cuda")), TrainingRenderer)
    with pytest.raises(BackendUnavailableError, match="'meta'"):
        create_training_renderer(torch.device("meta"))
