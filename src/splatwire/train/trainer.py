"""The loop around the step: views in random order, test pictures, checkpoints, news for whoever listens."""

import time
from dataclasses import dataclass
from pathlib import Path

import torch

from splatwire.data import Dataset
from splatwire.errors import DatasetError, DivergedError
from splatwire.model import AnchorScene
from splatwire.model.tensors import to_tensors
from splatwire.render.backends import create_renderer
from splatwire.scene import Cameras
from splatwire.train.checkpoint import save_checkpoint
from splatwire.train.config import TrainConfig
from splatwire.train.export import export_scene
from splatwire.train.initial import initial_state
from splatwire.train.kernels import Kernels, choose_kernels
from splatwire.train.photos import PhotoStore, check_photos
from splatwire.train.progress import Listener, RunningMeans
from splatwire.train.quality import QualityReport, assess_scene
from splatwire.train.refine import refine_context
from splatwire.train.size import steer
from splatwire.train.state import TrainState, move_state
from splatwire.train.step import TrainingStep


@dataclass(frozen=True)
class RunOptions:
    """How a run is watched and kept; nothing here changes the result.

    Attributes:
        checkpoint: Where checkpoints go; None for none.
        checkpoint_interval: Iterations between checkpoints.
        test_interval: Iterations between tests; 0 for one at the end only.
        max_test_views: Views of a test on the way; all are drawn at the end.
    """

    checkpoint: Path | None = None
    checkpoint_interval: int = 1000
    test_interval: int = 1000
    max_test_views: int = 8


@dataclass(frozen=True, eq=False)
class TrainResult:
    """What a run left.

    Attributes:
        scene: The scene as it stands, on the CPU; its context model fitted again unless the run was stopped.
        state: The state, where it was trained.
        test: The last test; None without test views, or if the run was stopped.
        stopped: True if the listener ended the run early.
        seconds: Time in the loop, without tests.
    """

    scene: AnchorScene
    state: TrainState
    test: QualityReport | None
    stopped: bool
    seconds: float


def train_scene(
    train: Dataset,
    test: Dataset | None,
    config: TrainConfig,
    *,
    state: TrainState | None = None,
    options: RunOptions | None = None,
    listener: Listener | None = None,
    device: str = "cpu",
) -> TrainResult:
    """Trains a scene, or goes on with one.

    Args:
        train: Training views and points.
        test: Test views, if any.
        config: The recipe.
        state: Where to go on from (it is changed if it is on the device already); None to start.
        options: Checkpoints and tests.
        listener: Who wants to know.
        device: Where to train: `cpu`, or `cuda` with gsplat.

    Raises:
        BackendUnavailableError: If the device, or what draws on it, is not here; before anything else.
        DatasetError: If the photos, poses or points cannot be trained on; before the first iteration.
        DivergedError: If the loss stops being finite.
        OSError: If a checkpoint cannot be written.
    """
    options, listener = options or RunOptions(), listener or Listener()
    place = torch.device(device)
    kernels = choose_kernels(place)
    run = _Run(config, options, listener, train, test, place, kernels)
    photos = PhotoStore(train, place, kernels.prepare_photo)
    if test is not None:
        check_photos(test)
    if state is None:
        state = initial_state(train, config)
    if max(state.queue, default=0) >= train.num_views:
        raise DatasetError("the checkpoint is of a run with more training views than there are here")
    state = move_state(state, place)
    stopped = run.loop(state, photos)
    if options.checkpoint is not None:
        save_checkpoint(state, config, options.checkpoint)
    report = None if test is None or stopped else run.test(state, test.num_views)
    scene = export_scene(state, config)
    if not stopped:
        started = time.perf_counter()
        scene = refine_context(scene, config.refine, progress=listener.refining)
        run.seconds += time.perf_counter() - started
    return TrainResult(scene, state, report, stopped, run.seconds)


@dataclass
class _Run:
    """The loop."""

    config: TrainConfig
    options: RunOptions
    listener: Listener
    train: Dataset
    test_views: Dataset | None
    device: torch.device
    kernels: Kernels
    seconds: float = 0.0

    def loop(self, state: TrainState, photos: PhotoStore) -> bool:
        """Trains to the end; returns True if it was stopped before."""
        step, means = (
            TrainingStep(self.config, self._cameras(), self.kernels),
            RunningMeans(self.config, self.kernels.report_interval),
        )
        while state.iteration < self.config.marks.iterations:
            started = time.perf_counter()
            if not state.queue:
                state.queue = torch.randperm(self.train.num_views, generator=state.generator).tolist()
            view = state.queue.pop()
            report = step(state, view, photos.photo(view))
            steer(state, self.config, step.size_estimate)
            elapsed = time.perf_counter() - started
            self.seconds += elapsed
            self.listener.progress(means.after(state, report, elapsed, self.seconds))
            if self.listener.should_stop():
                return state.iteration < self.config.marks.iterations
            self._keep(state)
        return False

    def test(self, state: TrainState, num_views: int) -> QualityReport | None:
        """Draws test views and tells the listener."""
        if self.test_views is None:
            return None
        scene = export_scene(state, self.config, self.device)
        renderer = create_renderer("cpu" if self.device.type == "cpu" else "gsplat")
        report = assess_scene(scene, self.test_views, num_views, state.iteration, renderer)
        self.listener.tested(report)
        return report

    def _cameras(self) -> Cameras:
        """The training cameras where the state is, so that they are not sent there in each iteration."""
        cameras = self.train.cameras
        return to_tensors(cameras, self.device)

    def _keep(self, state: TrainState) -> None:
        last = state.iteration == self.config.marks.iterations
        if last:
            return
        if self.options.checkpoint is not None and state.iteration % self.options.checkpoint_interval == 0:
            if not all(bool(torch.isfinite(value).all()) for value in state.parameters.values()):
                raise DivergedError(state.iteration)
            save_checkpoint(state, self.config, self.options.checkpoint)
        if self.options.test_interval and state.iteration % self.options.test_interval == 0:
            self.test(state, self.options.max_test_views)
