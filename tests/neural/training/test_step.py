"""The gradient of the whole loss with respect to the parameters, against finite differences."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from splatwire.data import Dataset
from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import PacketLossConfig, TrainConfig
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.photometric_loss import prepare_photo
from splatwire.neural.training.state import TrainState
from splatwire.neural.training.step import TrainingStep

pytestmark = pytest.mark.slow

STEP = 2e-3


def _loss(state: TrainState, dataset: Dataset, config: TrainConfig) -> float:
    """The loss of the next iteration, without an update."""
    frozen = dataclasses.replace(config, rates=_still(config))
    return TrainingStep(frozen, dataset.cameras)(state, 1, prepare_photo(torch.from_numpy(dataset.image(1)))).loss


def _still(config: TrainConfig) -> object:
    from splatwire.neural.training.config import LearningRate

    tiny = LearningRate(1e-30, 1e-30)
    return dataclasses.replace(config.rates, **dict.fromkeys(vars(config.rates), tiny))


def _lossy(config: TrainConfig) -> TrainConfig:
    """Every iteration after growth loses packets."""
    return dataclasses.replace(config, packet_loss=PacketLossConfig(("bernoulli:0.3",), lossy_share=1.0))


@pytest.fixture(scope="module")
def checkpoint(
    dataset: Dataset, config: TrainConfig, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[int, bool], Path]:
    """Function that trains once for a number of iterations, with or without packet losses, and returns a checkpoint."""

    @functools.cache
    def trained(iterations: int, lossy: bool) -> Path:
        path, recipe = tmp_path_factory.mktemp("trained") / "run.checkpoint", _lossy(config) if lossy else config
        state, step = initial_state(dataset, recipe), TrainingStep(recipe, dataset.cameras)
        photo = prepare_photo(torch.from_numpy(dataset.image(1)))
        for _ in range(iterations):
            step(state, 1, photo)
        save_checkpoint(state, recipe, path)
        return path

    return trained


PICTURE = [("heads.color.output.bias", i) for i in (10, 25, 40)] + [("heads.color.hidden.weight", 40)]
LOSSY = ("heads.color.output.bias", 52)
"""Includes packet losses."""
RATE = [(name, 40) for name in ("features", "log_scalings", "offsets", "prior.hidden.weight", "channel.1.output.bias")]


# Moving or resizing a Gaussian shifts the border where alpha passes 1/255, which has no gradient. For those parameters
# the rate outweighs the picture here; other tests cover the gradient of the rasteriser.
@pytest.mark.parametrize(
    ("name", "iterations", "rate"), [(*c, 0.004) for c in [*PICTURE, LOSSY]] + [(*c, 100.0) for c in RATE]
)
def test_step_gradient_equals_the_directional_derivative(
    name: str, iterations: int, rate: float, dataset: Dataset, checkpoint: Callable[[int, bool], Path]
) -> None:
    state, config = load_checkpoint(checkpoint(iterations, (name, iterations) == LOSSY))
    config = dataclasses.replace(config, weights=dataclasses.replace(config.weights, rate=rate))
    luck = state.generator.get_state()
    rng = torch.Generator().manual_seed(iterations)
    gradients: list[torch.Tensor] = []
    start = state.parameters[name].detach().clone()
    state.parameters[name].register_hook(gradients.append)
    size = STEP * float(start.abs().mean().clamp(min=0.01))
    direction = torch.zeros_like(start)
    measured: list[float] = []
    for sign in (0, 1, -1):
        state.iteration = iterations
        state.generator.set_state(luck)
        with torch.no_grad():
            state.parameters[name].copy_(start + sign * direction)
        measured.append(_loss(state, dataset, config))
        # a random ascent direction: orthogonal to the gradient, the loss changes less than float32 resolves
        if sign == 0:
            direction = gradients[0].sign() * torch.rand(start.shape, generator=rng) * size
    expected = float((gradients[0] * direction).sum())
    assert expected > 1e-6
    assert (measured[1] - measured[2]) / 2 == pytest.approx(expected, rel=0.03, abs=1e-7)
