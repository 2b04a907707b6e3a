"""Training of the scene-free concealer for explicit Gaussians: pictures get better, and a seed repeats it."""

import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.calibrate.scene_free import SceneFreeConfig
from splatwire.calibrate.scene_free_gaussians import LossyStream, train_for_gaussians
from splatwire.codec import encode_scene
from splatwire.errors import InvalidValueError
from splatwire.model import SplatScene
from splatwire.packets import Packetization
from splatwire.scene.splats import Splats

CONFIG = SceneFreeConfig(steps=16, learning_rate=0.02, drop_rates=(0.3, 0.3), hidden=6, floor=1e-6)


def test_pictures_get_better_and_a_seed_repeats_the_run() -> None:
    rng = torch.Generator().manual_seed(3)
    quats = torch.nn.functional.normalize(torch.randn(500, 4, generator=rng), dim=1)
    splats = Splats(
        torch.rand(500, 3, generator=rng) - 0.5, quats, torch.rand(500, 3, generator=rng) * 0.03 + 0.01,
        torch.rand(500, generator=rng) * 0.8 + 0.1, torch.randn(500, 1, 3, generator=rng) * 0.5,
    )  # fmt: skip
    stream = encode_scene(SplatScene(splats), Packetization(block_size=64, lanes=4))
    lossy, losses = LossyStream(stream, tiny_cameras(num_views=2, width=48, height=32)), list[float]()
    trained = train_for_gaussians([lossy], CONFIG, progress=lambda step, loss: losses.append(loss)).state_dict()
    assert sum(losses[-4:]) < sum(losses[:4])  # each of the 4 pairs of loss and view comes once in 4 steps
    again = train_for_gaussians([lossy], CONFIG).state_dict()
    assert all(torch.equal(value, again[name]) for name, value in trained.items())
    with pytest.raises(InvalidValueError, match="not for anchors"):
        train_for_gaussians([LossyStream(encode_scene(tiny_scene()), lossy.cameras)], CONFIG)
