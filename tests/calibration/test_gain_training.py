"""Training of the scene-free gains in `benchmarks`, for anchors and Gaussians."""

import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from close import assert_close
from explicit import encode_splats
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization
from splatwire.calibration.pseudo_loss import calibration_data
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment.scene_free import AnchorNetwork, GaussianNetwork, default_anchor_weights
from splatwire.concealment.scene_free.elements import GaussianInputs
from splatwire.concealment.scene_free.network import AnchorInputs, Perceptron
from splatwire.concealment.scene_free.weights import default_gaussian_weights
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from web.test_page import ball

pytestmark = pytest.mark.slow

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


def weights(network: Perceptron) -> np.ndarray:
    layers = (network.hidden, network.output)
    return np.concatenate(
        [network.mean, network.spread, *(part.ravel() for layer in layers for part in vars(layer).values())]
    )


def test_torch_gains_equal_numpy_gains() -> None:
    rng = np.random.default_rng(4)
    signature = rng.normal(size=(50, AnchorNetwork.INPUTS)).astype(np.float32)
    known = AnchorInputs(np.arange(50), signature, rng.uniform(1, 2, 50).astype(np.float32))
    signature = rng.normal(size=(50, GaussianNetwork.INPUTS)).astype(np.float32)
    lost, opacity = rng.uniform(0, 2, (2, 50)).astype(np.float32)
    elements = GaussianInputs(np.arange(50), signature, lost, opacity / 2)
    for network, inputs in ((default_anchor_weights(), known), (default_gaussian_weights(), elements)):
        for ours, theirs in zip(MADE["tensor_gains"](to_tensors(network), inputs), network(inputs), strict=True):
            assert_close(ours, theirs, rtol=1e-4)


@pytest.mark.parametrize("kind", [anchors, gaussians])
def test_training_improves_pictures_and_repeats_with_the_same_seed(
    kind: Callable[[], tuple[Callable[..., Any], Any]],
) -> None:
    train, scene = kind()
    losses: list[float] = []
    trained = weights(train([scene], CONFIG, progress=lambda step, loss: losses.append(loss)))
    assert len(losses) == CONFIG.steps
    assert sum(losses[-4:]) < sum(losses[:4]), "each of the 4 pairs of loss and view comes once in 4 steps"
    again, other = (weights(train([scene], replace(CONFIG, seed=seed))) for seed in (CONFIG.seed, 1))
    assert np.array_equal(trained, again)
    assert not np.array_equal(trained, other)
    with pytest.raises(DivergedError):
        train([scene], replace(CONFIG, floor=-10.0))


def test_invalid_settings_are_refused() -> None:
    train, scene = anchors()
    with pytest.raises(InvalidValueError, match="no scene"):
        train([], CONFIG)
    with pytest.raises(InvalidValueError, match="without cameras"):
        train([replace(scene, cameras=None)], CONFIG)
    with pytest.raises(InvalidValueError, match="not for anchors"):
        MADE["train_for_gaussians"]([MADE["LossyStream"](encode_scene(tiny_scene(), SMALL), scene.cameras)], CONFIG)
