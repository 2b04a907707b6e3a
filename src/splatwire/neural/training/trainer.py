"""The training loop: views in random order, tests, checkpoints, progress reports."""

import time
from dataclasses import dataclass
from pathlib import Path

import torch

from splatwire.arguments import CheckedFields, checked
from splatwire.data import Dataset
from splatwire.errors import DatasetError, DivergedError, InvalidValueError, shown
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.checkpoint import save_checkpoint
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import Kernels, choose_kernels
from splatwire.neural.training.photos import PhotoStore, check_photos
from splatwire.neural.training.progress import Listener, RunningMeans
from splatwire.neural.training.quality import QualityReport, assess_scene
from splatwire.neural.training.refine import refine_context
from splatwire.neural.training.size import steer
from splatwire.neural.training.state import TrainState, move_state
from splatwire.neural.training.step import TrainingStep
from splatwire.render.backends import create_renderer
from splatwire.types import AnchorScene, Cameras


@dataclass(frozen=True)
class RunOptions(CheckedFields):
    """Options for checkpoints and tests, which have no influence on the trained scene.

    Attributes:
        checkpoint: Path of the checkpoint file; None for no checkpoints.
        checkpoint_interval: Number of iterations between checkpoints.
        test_interval: Number of iterations between tests; 0 for a single test at the end.
        max_test_views: Maximum number of views per test; the test at the end renders all views.
    """

    checkpoint: Path | None = None
    checkpoint_interval: int = 1000
    test_interval: int = 1000
    max_test_views: int = 8


@dataclass(frozen=True, eq=False)
class TrainResult:
    """Result of a training.

    Attributes:
        scene: The trained scene, on the CPU. The context model is refined unless the training was stopped.
        state: The final state, on the training device.
        test: Quality in the last test; None without test views, or if the training was stopped.
        stopped: True if the listener ended the training early.
        seconds: Duration of the training loop in seconds, without tests.
    """

    scene: AnchorScene
    state: TrainState
    test: QualityReport | None
    stopped: bool
    seconds: float


def training_device(name: str) -> torch.device:
    """Returns the torch device of a name such as `cpu`, `cuda` or `cuda:1`.

    Raises:
        InvalidValueError: If torch has no such device.
    """
    try:
        return torch.device(name)
    except (RuntimeError, ValueError) as error:
        raise InvalidValueError(f"device: torch has no device {shown(name)}; use cpu or cuda") from error


@checked
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
    """Trains a scene, or resumes a training.

    Args:
        train: Training views and points.
        test: Test views; None for no tests.
        config: The configuration.
        state: State to resume from, changed in place if already on the device; None to start a new training.
        options: Options for checkpoints and tests; None for the defaults.
        listener: Callbacks for progress and stopping; None for no callbacks.
        device: Training device: `cpu`, or `cuda` with gsplat.

    Raises:
        BackendUnavailableError: If the device or its renderer is not available. Checked first.
        DatasetError: If the photos, poses or points are unusable. Checked before the first iteration.
        DivergedError: If the loss is not finite.
        OSError: If a checkpoint cannot be written.
    """
    options, listener = options or RunOptions(), listener or Listener()
    place = training_device(device)
    kernels = choose_kernels(place)
    run = _TrainingLoop(config, options, listener, train, test, place, kernels)
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
class _TrainingLoop:
    """The training loop, with everything that is constant during it: configuration, datasets, device and listener."""

    config: TrainConfig
    options: RunOptions
    listener: Listener
    train: Dataset
    test_views: Dataset | None
    device: torch.device
    kernels: Kernels
    seconds: float = 0.0

    def loop(self, state: TrainState, photos: PhotoStore) -> bool:
        """Trains until the last iteration; returns True if the listener stopped the training before."""
        step, means = (
            TrainingStep(self.config, self._cameras(), self.kernels),
            RunningMeans(self.config, self.kernels.report_interval),
        )
        while state.iteration < self.config.milestones.iterations:
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
                return state.iteration < self.config.milestones.iterations
            self._keep(state)
        return False

    def test(self, state: TrainState, num_views: int) -> QualityReport | None:
        """Measures the quality of test views and reports it to the listener; returns None without test views."""
        if self.test_views is None:
            return None
        scene = export_scene(state, self.config, self.device)
        renderer = create_renderer("cpu" if self.device.type == "cpu" else "gsplat")
        report = assess_scene(scene, self.test_views, num_views, state.iteration, renderer)
        self.listener.tested(report)
        return report

    def _cameras(self) -> Cameras:
        """Returns the training cameras on the training device, which saves copying them in every iteration."""
        cameras = self.train.cameras
        return to_tensors(cameras, self.device)

    def _keep(self, state: TrainState) -> None:
        last = state.iteration == self.config.milestones.iterations
        if last:
            return
        if self.options.checkpoint is not None and state.iteration % self.options.checkpoint_interval == 0:
            if not all(bool(torch.isfinite(value).all()) for value in state.parameters.values()):
                raise DivergedError(state.iteration)
            save_checkpoint(state, self.config, self.options.checkpoint)
        if self.options.test_interval and state.iteration % self.options.test_interval == 0:
            self.test(state, self.options.max_test_views)
