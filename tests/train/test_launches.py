"""What an iteration on a device asks of it; a GPU waits for the host where that is much."""

import dataclasses
import types

import pytest
import torch

from launches import Launches
from pretend_device import DEVICE, pretend_device
from scenes import SMALL_CAUSAL
from splatwire.data import Dataset
from splatwire.model.tensors import to_tensors
from splatwire.render.gsplat_backend import GsplatRenderer
from splatwire.train.config import TrainConfig
from splatwire.train.initial import initial_state
from splatwire.train.kernels import plain_kernels
from splatwire.train.photos import PhotoStore
from splatwire.train.progress import RunningMeans
from splatwire.train.state import move_state
from splatwire.train.step import TrainingStep

ITERATIONS = 20
"""As many as there are between two readings of the loss."""


@pytest.fixture
def counter(monkeypatch: pytest.MonkeyPatch) -> Launches:
    """Counts; the pretend device has no generators of its own."""
    monkeypatch.setattr("splatwire.train.kernels._seeded", lambda generator, device: None)
    return Launches()


def _counted(counter: Launches, dataset: Dataset, config: TrainConfig, start: int) -> tuple[float, float]:
    """Launches and waits of an iteration after `start`, gsplat's own left out."""
    renderer = object.__new__(GsplatRenderer)
    renderer._gsplat = types.SimpleNamespace(rasterization=counter.rasterization)
    with pretend_device():
        state = move_state(initial_state(dataset, config), DEVICE)
        kernels = plain_kernels(renderer.draw)
        photos = PhotoStore(dataset, DEVICE, kernels.prepare_photo)
        cameras = to_tensors(dataset.cameras, DEVICE)
        step, means = TrainingStep(config, cameras, kernels), RunningMeans(config, kernels.report_interval)
        state.iteration = start - 1
        step(state, 0, photos.photo(0))
        photos.photo(1)
        with counter:
            for _ in range(ITERATIONS):
                means.after(state, step(state, 1, photos.photo(1)), 0.01, 1.0)
    return sum(counter.operations.values()) / ITERATIONS, sum(counter.host.values()) / ITERATIONS


def _stretched(config: TrainConfig) -> TrainConfig:
    """Phases long enough to count in each; no anchors are added."""
    marks = dataclasses.replace(
        config.marks, iterations=400, statistics_start=40, growth_start=380, noise_start=100, growth_pause_end=100,
        context_start=200, growth_end=300,
    )  # fmt: skip
    return dataclasses.replace(config, model=SMALL_CAUSAL, marks=marks, mask_threshold=0.1)


@pytest.mark.parametrize(
    ("start", "most"), [(10, 230), (60, 260), (120, 290), (240, 380), (320, 350)],
    ids=["pictures", "statistics", "noise", "rate and statistics", "rate"],
)  # fmt: skip
def test_an_iteration_of_the_causal_model_is_few_launches_and_hardly_waits(
    start: int, most: int, counter: Launches, dataset: Dataset, config: TrainConfig
) -> None:
    launches, waits = _counted(counter, dataset, _stretched(config), start)
    assert 100 < launches <= most
    assert counter.host["nonzero"] == ITERATIONS  # the visible anchors
    assert waits <= 1.3  # the loss and the progress are read once in twenty iterations


def test_the_counter_counts_launches_copies_and_waits_but_no_views() -> None:
    counter = Launches()
    with pretend_device():
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
