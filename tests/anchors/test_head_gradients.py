"""Back-propagation through the networks that generate Gaussians, against the gradients of torch."""

import dataclasses

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.head_gradients import Spawning, visible_anchors
from splatwire.types import Mlp

torch = pytest.importorskip("torch")
FIELDS = ("means", "quats", "scales", "opacities", "colors")


@pytest.mark.parametrize("slope", [0.0, 0.01])
def test_gaussians_and_gradients_are_those_of_torch(slope: float) -> None:
    from splatwire.neural.model.gaussian_heads import spawn_gaussians
    from splatwire.neural.model.tensors import to_tensors

    scene = tiny_scene(seed=1, num_anchors=80)
    heads = dataclasses.replace(scene.heads, **{
        name: Mlp(mlp.hidden, mlp.output, slope) for name, mlp in vars(scene.heads).items()
    })  # fmt: skip
    center = tiny_cameras().centers[0].astype(np.float32)
    ours = Spawning(scene.anchors, heads, center)
    tensors = to_tensors(scene.anchors)
    inputs = [t.clone().requires_grad_() for t in (tensors.features, tensors.scalings, tensors.offsets)]
    moved = dataclasses.replace(tensors, features=inputs[0], scalings=inputs[1], offsets=inputs[2])
    everything = torch.ones(80, dtype=torch.bool)
    theirs = spawn_gaussians(moved, to_tensors(heads), torch.from_numpy(center), everything)
    assert np.array_equal(ours.anchor_index, theirs.anchor_index.numpy())
    assert np.array_equal(ours.offset_index, theirs.offset_index.numpy())
    outputs = [getattr(theirs.gaussians, name) for name in FIELDS]
    for name, values in zip(FIELDS, outputs, strict=True):
        np.testing.assert_allclose(getattr(ours.gaussians, name), values.detach().numpy(), rtol=1e-5, atol=1e-6)
    rng = np.random.default_rng(0)
    upstream = [rng.standard_normal(values.shape, np.float32) for values in outputs]
    found = ours.gradients(upstream)
    expected = torch.autograd.grad(outputs, inputs, [torch.from_numpy(g) for g in upstream])
    for own, other in zip((found.features, found.scalings, found.offsets), expected, strict=True):
        np.testing.assert_allclose(own, other.numpy(), rtol=2e-4, atol=2e-5)


def test_visible_anchors_are_those_of_torch() -> None:
    from splatwire.neural.model import gaussian_heads
    from splatwire.neural.model.tensors import to_tensors

    scene, cameras = tiny_scene(num_anchors=300), tiny_cameras(4, 40, 24, distance=1.0)
    for view in range(cameras.num_views):
        ours = visible_anchors(scene.anchors, cameras, view)
        theirs = gaussian_heads.visible_anchors(to_tensors(scene.anchors), cameras, view).numpy()
        assert 0 < ours.sum() < 300
        assert int((ours != theirs).sum()) <= 1  # rounding at the rim
