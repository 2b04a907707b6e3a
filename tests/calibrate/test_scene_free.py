"""Training of the scene-free concealer: it learns from pictures, and a seed makes it repeatable."""

import dataclasses

import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.calibrate.pseudo_loss import CalibrationData, calibration_data
from splatwire.calibrate.scene_free import SceneFreeConfig, train_scene_free
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.packets import Packetization

CONFIG = SceneFreeConfig(steps=24, learning_rate=0.02, drop_rates=(0.3, 0.3), hidden=6, floor=1e-6)


@pytest.fixture(scope="module")
def scene() -> CalibrationData:
    stream = encode_scene(tiny_scene(num_anchors=400), Packetization(block_size=64, lanes=4))
    complete, cameras = decode_stream(stream), tiny_cameras(num_views=2, width=48, height=32)
    return calibration_data(stream, complete, cameras)


def test_pictures_get_better_and_a_seed_repeats_the_run(scene: CalibrationData) -> None:
    losses: list[float] = []
    trained = train_scene_free([scene], CONFIG, progress=lambda step, loss: losses.append(loss))
    assert len(losses) == CONFIG.steps
    # each of the 4 pairs of loss and view comes once in 4 steps: the same pictures first and last
    assert sum(losses[-4:]) < sum(losses[:4])
    again = train_scene_free([scene], CONFIG).state_dict()
    for name, value in trained.state_dict().items():
        assert torch.equal(value, again[name]), name
    other = train_scene_free([scene], dataclasses.replace(CONFIG, seed=1)).state_dict()
    assert not torch.equal(other["layers.2.weight"], again["layers.2.weight"])


def test_without_a_step_it_is_the_untrained_network(scene: CalibrationData) -> None:
    network = train_scene_free([scene], dataclasses.replace(CONFIG, steps=0))
    assert not bool(network.state_dict()["layers.2.weight"].any())
    assert bool((network.state_dict()["spread"] > 0).all())


def test_nonsense_is_refused(scene: CalibrationData) -> None:
    with pytest.raises(InvalidValueError, match="no scene"):
        train_scene_free([], CONFIG)
    with pytest.raises(InvalidValueError, match="drop_rates"):
        SceneFreeConfig(drop_rates=(1.5,))
    with pytest.raises(InvalidValueError, match="without cameras"):
        train_scene_free([dataclasses.replace(scene, cameras=None)], CONFIG)
    with pytest.raises(DivergedError):
        train_scene_free([scene], dataclasses.replace(CONFIG, floor=-10.0))
