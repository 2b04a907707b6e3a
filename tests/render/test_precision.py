from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from explicit import ball_of_gaussians
from reference.squared_gradients import squared
from splatwire.neural.render.differentiable import render_differentiable
from splatwire.render import iterate_views
from splatwire.render._precision_kernels import NUM_SUMS, add_squared
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.importance import cameras_around, surrounding_cameras
from splatwire.render.precision import (
    MEASURED_VIEWS,
    VIEW_SIZE,
    VIEWS_OF_PART,
    measure_class_offsets,
    measure_further_removal,
    measure_gaussians,
)
from splatwire.types import Cameras, Gaussians, SplatScene
from splatwire.types.splats import Splats


def two_shells() -> Splats:
    """200 Gaussians on an opaque shell, and 40 inside it that no camera sees."""
    rng = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(240, 3, generator=rng), dim=1)
    radius = torch.where(torch.arange(240) < 200, 1.0, 0.2)[:, None]
    scales = torch.where(torch.arange(240) < 200, 0.25, 0.05)[:, None].expand(240, 3)
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(240, 4)
    columns = (directions * radius, quats, scales, torch.full((240,), 0.98), torch.rand(240, 1, 3, generator=rng))
    return Splats(*(np.ascontiguousarray(column) for column in columns))


def test_hidden_gaussians_get_coarser_classes() -> None:
    splats = two_shells()
    classes = measure_class_offsets(splats, cameras_around(splats.means[:200], 4, 48))
    assert classes.shape == (240,)
    assert classes[:200].mean() > classes[200:].mean() + 3
    assert (classes <= 0).mean() > 0.9


def test_precision_classes_are_repeatable() -> None:
    splats = two_shells()
    cameras = cameras_around(splats.means, 2, 32)
    assert (measure_class_offsets(splats, cameras) == measure_class_offsets(splats, cameras)).all()


def _gradients_of_torch(
    gaussians: Gaussians, cameras: Cameras, d_image: Callable[..., Iterator[np.ndarray]], use: Callable[..., None]
) -> None:
    """Does as `each_gradient_cpu`, with the differentiable renderer."""
    inputs = [torch.from_numpy(values.copy()).requires_grad_() for values in vars(gaussians).values()]
    picture = render_differentiable(Gaussians(*inputs), cameras, background=torch.zeros(3))[0]
    for gradient in d_image(tuple(picture.shape)):
        found = torch.autograd.grad(picture, inputs, torch.from_numpy(gradient).to(picture), retain_graph=True)
        use(slice(0, gaussians.num_gaussians), *(g.contiguous().numpy() for g in found))


def test_fast_gradients_equal_torch_gradients() -> None:
    splats = two_shells()
    seen, cameras = splats.seen_from(np.zeros(3, np.float32)), cameras_around(splats.means, 1, 48)
    rng = torch.Generator().manual_seed(2)
    found = []
    for find in (each_gradient_cpu, _gradients_of_torch):
        rows = [np.zeros(tuple(values.shape), np.float32) for values in vars(seen).values()]

        def use(some: slice, *gradients: np.ndarray, rows: list[np.ndarray] = rows) -> None:
            for row, gradient in zip(rows, gradients, strict=True):
                row[some] = gradient

        def signs(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
            yield np.sign(torch.randn(shape, generator=rng.manual_seed(2)).numpy())

        find(seen, cameras, signs, use)
        found.append(rows)
    for quick, whole in zip(*found, strict=True):
        assert np.abs(whole).max() > 0
        np.testing.assert_allclose(quick, whole, rtol=1e-4, atol=1e-5 * np.abs(whole).max())


def test_large_scenes_are_processed_in_parts() -> None:
    """Parts are independent: distant Gaussians may have any value."""
    near = two_shells()
    far = replace(near, means=near.means + np.array([1000.0, 0.0, 0.0], np.float32))
    both = Splats(**{name: np.concatenate([getattr(one, name) for one in (near, far)]) for name in vars(near)})
    classes = measure_class_offsets(both, part=240)
    alone = measure_class_offsets(near, cameras_around(near.means, VIEWS_OF_PART, VIEW_SIZE))
    assert (classes[:240] == alone).all()
    assert (measure_class_offsets(near, part=240) == measure_class_offsets(near)).all()


def test_squared_gradients_equal_the_plain_sum() -> None:
    rng, num = torch.Generator().manual_seed(1), 1000
    gradients = [torch.randn(num, *size, generator=rng) for size in ((3,), (4,), (3,), (), (3,))]
    scales = torch.rand(num, 3, generator=rng)
    known = [
        scales,
        torch.nn.functional.normalize(torch.randn(num, 4, generator=rng), dim=1),
        torch.rand(num, generator=rng),
        scales.argsort(dim=1, descending=True),
        torch.randint(0, 2, (num,), generator=rng) * 2,
    ]
    sums = np.zeros((num, NUM_SUMS))
    add_squared(*(t.numpy() for t in (*gradients, *known)), sums, 0, 400)
    add_squared(*(t.numpy() for t in (*gradients, *known)), sums, 400, num)
    np.testing.assert_allclose(sums, squared(*gradients, *known).numpy(), rtol=1e-12)


def _resized(splats: Splats, factor: float) -> Splats:
    return replace(splats, means=splats.means * np.float32(factor), scales=splats.scales * np.float32(factor))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0**-20, 2.0**-10, 2.0**-3, 2.0**3, 2.0**20])
def test_classes_do_not_depend_on_the_unit_of_length(factor: float) -> None:
    """From 0.5 units away, a scene of a millimetre is smaller than a pixel and has the classes of a scene unseen."""
    splats = two_shells()
    # The class offsets of the others, which no camera sees, are due to rounding.
    wanted = measure_class_offsets(splats)[:200]
    assert len(np.unique(wanted)) > 2
    assert np.array_equal(measure_class_offsets(_resized(splats, factor))[:200], wanted)
    measured, expected = (measure_gaussians(SplatScene(some)) for some in (_resized(splats, factor), splats))
    assert np.array_equal(measured.class_offsets[:200], expected.class_offsets[:200])
    np.testing.assert_allclose(measured.removal, expected.removal, rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("antialiased", [False, True])
def test_further_removal_predicts_the_error(antialiased: bool) -> None:
    scene = SplatScene(ball_of_gaussians(), background=(0.1, 0.2, 0.3), antialiased=antialiased)
    cameras = cameras_around(scene.splats.means, 3, 48)
    complete = _images(scene, cameras)
    pruned = scene.select(np.arange(0, 200, 2))
    found, now = measure_further_removal(pruned, cameras, complete), _images(pruned, cameras)
    for row in np.argsort(-np.abs(found.interaction))[:40:4]:
        less = _images(pruned.select(np.delete(np.arange(100), row)), cameras)
        growth = np.square(less - complete).mean() - np.square(now - complete).mean()
        expected = growth - np.square(less - now).mean()
        np.testing.assert_allclose(found.interaction[row], expected, rtol=0.05, atol=1e-7)
    assert (found.interaction < 0).any()
    assert (found.interaction > 0).any()


def test_own_error_equals_the_removal_error_in_a_complete_scene() -> None:
    scene = SplatScene(ball_of_gaussians())
    cameras = cameras_around(scene.splats.means, 3, 48)
    found = measure_further_removal(scene, cameras, _images(scene, cameras))
    np.testing.assert_allclose(found.own_error, measure_gaussians(scene, cameras).removal, rtol=1e-4)
    assert not found.interaction.any()


def test_ends_of_a_long_scene_are_measured_as_well() -> None:
    body, end = ball_of_gaussians(), ball_of_gaussians()
    end = replace(end.select(np.arange(0, 200, 8)), means=0.3 * end.means[::8] + np.float32([0, 3.5, 0]))
    long = SplatScene(Splats(**{name: np.concatenate([vars(body)[name], vars(end)[name]]) for name in vars(body)}))
    measured = measure_gaussians(long)
    around = measure_gaussians(long, surrounding_cameras(long, MEASURED_VIEWS, VIEW_SIZE))
    gain = measured.class_offsets.astype(np.int64) - around.class_offsets
    assert gain[200:].mean() > gain[:200].mean() + 0.5
    assert np.median(measured.removal[200:] / around.removal[200:]) > 2


def _images(scene: SplatScene, cameras: Cameras) -> np.ndarray:
    return np.stack(list(iterate_views(scene, cameras)))
