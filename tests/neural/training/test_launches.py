"""Kernel launches and synchronisations of an iteration, which make a GPU wait for the host."""

import dataclasses
import types

import pytest
import torch

from fake_device import DEVICE, fake_device
from launches import Launches
from scenes import SMALL_CAUSAL
from splatwire.data import Dataset
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.render.gsplat_backend import GsplatRenderer
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import plain_kernels
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.progress import RunningMeans
from splatwire.neural.training.state import move_state
from splatwire.neural.training.step import TrainingStep

pytestmark = pytest.mark.slow

ITERATIONS = 20
"""Iterations between two readings of the loss."""


@pytest.fixture
def counter(monkeypatch: pytest.MonkeyPatch) -> Launches:
    """Returns counts; the pretend device has no generators."""
    monkeypatch.setattr("splatwire.neural.training.kernels._seeded", lambda generator, device: None)
    return Launches()


def _counted(counter: Launches, dataset: Dataset, config: TrainConfig, start: int) -> tuple[float, float]:
    """Kernel launches and synchronisations of one iteration after `start`, without those of gsplat."""
    renderer = object.__new__(GsplatRenderer)
    renderer._gsplat = types.SimpleNamespace(rasterization=counter.rasterization)
    with fake_device():
        state = move_state(initial_state(dataset, config), DEVICE)
        kernels = plain_kernels(renderer.draw)
        photos = PhotoStore(dataset, DEVICE, kernels.prepare_photo)
        cameras = to_tensors(dataset.cameras, DEVICE)
        step, means = (
            TrainingStep(config, cameras, kernels),
            RunningMeans(config.milestones.iterations, kernels.report_interval),
        )
        state.iteration = start - 1
        step(state, 0, photos.photo(0))
        photos.photo(1)
        with counter:
            for _ in range(ITERATIONS):
                means.update(state, step(state, 1, photos.photo(1)), 0.01, 1.0)
    return sum(counter.operations.values()) / ITERATIONS, sum(counter.host.values()) / ITERATIONS


def _stretched(config: TrainConfig) -> TrainConfig:
    """Phases long enough for counting, without new anchors."""
    marks = dataclasses.replace(
        config.milestones, iterations=400, statistics_start=40, growth_start=380, noise_start=100, growth_pause_end=100,
        context_start=200, growth_end=300,
    )  # fmt: skip
    return dataclasses.replace(config, model=SMALL_CAUSAL, milestones=marks, mask_threshold=0.1)


@pytest.mark.parametrize(
    ("start", "most"), [(10, 230), (60, 260), (120, 290), (240, 380), (320, 350)],
    ids=["pictures", "statistics", "noise", "rate and statistics", "rate"],
)  # fmt: skip
def test_causal_iteration_has_few_launches_and_synchronisations(
    start: int, most: int, counter: Launches, dataset: Dataset, config: TrainConfig
) -> None:
    launches, waits = _counted(counter, dataset, _stretched(config), start)
    assert 100 < launches <= most
    assert counter.host["nonzero"] == ITERATIONS  # the visible anchors
    assert waits <= 1.3  # the loss and the progress are read once in twenty iterations


def test_counter_counts_launches_copies_and_synchronisations() -> None:
    counter = Launches()
    with fake_device():
        values = torch.arange(6.0).to(DEVICE)
        with counter:
            doubled = (values * 2).view(2, 3).T[0]
            doubled.sum().cpu()
            (values > 2).nonzero()
            torch.ones(3).to(DEVICE)
            with counter.paused():
                values.exp()
    assert counter.operations == {"mul": 1, "sum": 1, "_to_copy": 2, "gt": 1, "nonzero": 1}
    assert counter.host == {"_to_copy": 2, "nonzero": 1}
