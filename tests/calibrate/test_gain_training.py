"""Training of the scene-free gains (benchmarks): pictures get better, and a seed repeats it; anchors and Gaussians."""

import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from explicit import encode_splats
from scenes import tiny_cameras, tiny_scene
from splatwire.calibrate.pseudo_loss import calibration_data
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.packets import Packetization
from web.test_page import ball

MADE = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "gain_training.py"))
CONFIG = MADE["SceneFreeConfig"](steps=16, learning_rate=0.02, drop_rates=(0.3, 0.3), hidden=6, floor=1e-6)
SMALL = Packetization(block_size=64, lanes=4)


def anchors() -> tuple[Callable[..., Any], Any]:
    stream = encode_scene(tiny_scene(num_anchors=400), SMALL)
    scene = calibration_data(stream, decode_stream(stream), tiny_cameras(num_views=2, width=48, height=32))
    return MADE["train_scene_free"], scene


def gaussians() -> tuple[Callable[..., Any], Any]:
    stream = encode_splats(ball(500), SMALL)
    return MADE["train_for_gaussians"], MADE["LossyStream"](stream, tiny_cameras(num_views=2, width=48, height=32))


@pytest.mark.parametrize("kind", [anchors, gaussians])
def test_pictures_get_better_and_a_seed_repeats_the_run(kind: Callable[[], tuple[Callable[..., Any], Any]]) -> None:
    train, scene = kind()
    losses: list[float] = []
    trained = train([scene], CONFIG, progress=lambda step, loss: losses.append(loss)).state_dict()
    assert len(losses) == CONFIG.steps
    assert sum(losses[-4:]) < sum(losses[:4]), "each of the 4 pairs of loss and view comes once in 4 steps"
    again, other = (train([scene], replace(CONFIG, seed=seed)).state_dict() for seed in (CONFIG.seed, 1))
    assert all(torch.equal(value, again[name]) for name, value in trained.items())
    assert any(not torch.equal(value, other[name]) for name, value in trained.items())
    with pytest.raises(DivergedError):
        train([scene], replace(CONFIG, floor=-10.0))


def test_nonsense_is_refused() -> None:
    train, scene = anchors()
    with pytest.raises(InvalidValueError, match="no scene"):
        train([], CONFIG)
    with pytest.raises(InvalidValueError, match="without cameras"):
        train([replace(scene, cameras=None)], CONFIG)
    with pytest.raises(InvalidValueError, match="not for anchors"):
        MADE["train_for_gaussians"]([MADE["LossyStream"](encode_scene(tiny_scene(), SMALL), scene.cameras)], CONFIG)
