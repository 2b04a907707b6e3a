from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from reference.squared_gradients import squared
from splatwire.render._precision_kernels import NUM_SUMS, add_squared
from splatwire.render.backends import _each_gradient
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.differentiable import render_differentiable
from splatwire.render.importance import cameras_around
from splatwire.render.precision import SIZE, VIEWS_OF_PART, precision_classes
from splatwire.scene.splats import Splats


def two_shells() -> Splats:
    """200 Gaussians on an opaque shell, 40 more inside it, where no camera sees them."""
    rng = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(240, 3, generator=rng), dim=1)
    radius = torch.where(torch.arange(240) < 200, 1.0, 0.2)[:, None]
    scales = torch.where(torch.arange(240) < 200, 0.25, 0.05)[:, None].expand(240, 3)
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(240, 4)
    columns = (directions * radius, quats, scales, torch.full((240,), 0.98), torch.rand(240, 1, 3, generator=rng))
    return Splats(*(np.ascontiguousarray(column) for column in columns))


def test_what_is_hidden_may_be_coarse() -> None:
    splats = two_shells()
    classes = precision_classes(splats, cameras_around(splats.means[:200], 4, 48))
    assert classes.shape == (240,)
    assert classes[:200].mean() > classes[200:].mean() + 3
    assert (classes <= 0).mean() > 0.9


def test_classes_repeat() -> None:
    splats = two_shells()
    cameras = cameras_around(splats.means, 2, 32)
    assert (precision_classes(splats, cameras) == precision_classes(splats, cameras)).all()


def test_the_quick_way_finds_the_gradients_of_torch() -> None:
    splats = two_shells()
    seen, cameras = splats.seen_from(np.zeros(3, np.float32)), cameras_around(splats.means, 1, 48)
    rng = torch.Generator().manual_seed(2)
    found = []
    for find in (each_gradient_cpu, partial(_each_gradient, render_differentiable)):
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


def test_large_scenes_are_looked_at_part_by_part() -> None:
    """A part knows nothing of the others: what is far away from it may be anything."""
    near = two_shells()
    far = replace(near, means=near.means + np.array([1000.0, 0.0, 0.0], np.float32))
    both = Splats(**{name: np.concatenate([getattr(one, name) for one in (near, far)]) for name in vars(near)})
    classes = precision_classes(both, part=240)
    alone = precision_classes(near, cameras_around(near.means, VIEWS_OF_PART, SIZE))
    assert (classes[:240] == alone).all()
    assert (precision_classes(near, part=240) == precision_classes(near)).all()


def test_squared_gradients_are_those_of_the_plain_sum() -> None:
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
