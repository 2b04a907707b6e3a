"""The training loop of all models."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from splatwire.arguments import check_fields
from splatwire.data import Dataset
from splatwire.errors import DatasetError, InvalidValueError, shown, whole_number
from splatwire.neural.training.checkpoint import check_finite
from splatwire.neural.training.kernels import Kernels
from splatwire.neural.training.photometric_loss import Photo
from splatwire.neural.training.photos import PhotoStore, check_photos
from splatwire.neural.training.progress import Listener, RunningMeans
from splatwire.neural.training.quality import QualityReport, assess_scene
from splatwire.neural.training.step import StepReport
from splatwire.render.backends import create_renderer
from splatwire.types.scene import Scene


@dataclass(frozen=True)
class RunOptions:
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

    def __post_init__(self) -> None:
        check_fields(self)
        for name, least in (("checkpoint_interval", 1), ("test_interval", 0), ("max_test_views", 1)):
            whole_number(getattr(self, name), name, least)


@runtime_checkable
class ModelState(Protocol):
    """Typing protocol (structural type) for the state of a training.

    Attributes:
        iteration: Number of completed iterations.
        parameters: Trained tensors by name.
        generator: Source of all random numbers, on the CPU.
        view_queue: Indices of the training views not yet used in the current round over all views.
    """

    iteration: int
    parameters: dict[str, Tensor]
    generator: torch.Generator
    view_queue: list[int]

    @property
    def num_elements(self) -> int:
        """Number of anchors or Gaussians in training."""


@runtime_checkable
class ModelTraining(Protocol):
    """Typing protocol (structural type) for the training of a model, run by `TrainingLoop`.

    Attributes:
        state: State of the training.
        iterations: Number of iterations.
        running_means: Running means for progress reports.
    """

    state: Any
    iterations: int
    running_means: RunningMeans

    def step(self, view: int, photo: Photo) -> StepReport:
        """Performs one iteration with the photo of a view."""

    def save(self, path: Path) -> None:
        """Writes a checkpoint of the training to a file."""

    def scene(self, device: torch.device) -> Scene:
        """Returns the scene in its current state, in CPU memory.

        Args:
            device: Device for the computation.
        """


def training_device(name: str) -> torch.device:
    """Returns the torch device of a name such as `cpu`, `cuda` or `cuda:1`.

    Raises:
        InvalidValueError: If torch has no such device.
    """
    try:
        return torch.device(name)
    except (RuntimeError, ValueError) as error:
        raise InvalidValueError(f"device: torch has no device {shown(name)}; use cpu or cuda") from error


@dataclass
class TrainingLoop:
    """Runs the iterations of a training, with tests, checkpoints and progress reports.

    Attributes:
        options: Options for checkpoints and tests.
        listener: Callbacks.
        train_data: Training views.
        test_data: Test views; None for no tests.
        device: The training device.
        kernels: Implementations of the expensive operations for that device.
        seconds: Duration of the iterations so far, and after them also of the final task (refinement of the context
            model; for explicit Gaussians, fine-tuning with rounding), seconds, without tests.
    """

    options: RunOptions
    listener: Listener
    train_data: Dataset
    test_data: Dataset | None
    device: torch.device
    kernels: Kernels
    seconds: float = 0.0

    def read_photos(self) -> PhotoStore:
        """Reads all photos.

        Raises:
            DatasetError: If a photo or mask is missing or damaged.
        """
        photos = PhotoStore(self.train_data, self.device, self.kernels.prepare_photo)
        if self.test_data is not None:
            check_photos(self.test_data)
        return photos

    def run(self, training: ModelTraining, photos: PhotoStore) -> bool:
        """Trains until the last iteration; then writes a checkpoint if the options name a checkpoint file.

        Returns:
            True if `Listener.should_stop` ended the training before its last iteration; False if the training is
            complete.

        Raises:
            DatasetError: If a resumed training had more views than `photos`.
            DivergedError: If the loss is not finite, or a part of the state is not finite at the end or when a
                checkpoint is due. The last checkpoint is then kept.
            OSError: If a checkpoint cannot be written.
        """
        if max(training.state.view_queue, default=0) >= self.train_data.num_views:
            raise DatasetError("the checkpoint is of a run with more training views than there are here")
        stopped = self._iterate(training, photos)
        self._write_checkpoint(training)
        return stopped

    def _iterate(self, training: ModelTraining, photos: PhotoStore) -> bool:
        state = training.state
        while state.iteration < training.iterations:
            started = time.perf_counter()
            if not state.view_queue:
                state.view_queue = torch.randperm(self.train_data.num_views, generator=state.generator).tolist()
            view = state.view_queue.pop()
            report = training.step(view, photos.photo(view))
            elapsed = time.perf_counter() - started
            self.seconds += elapsed
            self.listener.progress(training.running_means.update(state, report, elapsed, self.seconds))
            self.listener.iterated(lambda: training.scene(self.device))
            if self.listener.should_stop():
                return bool(state.iteration < training.iterations)
            self._checkpoint_and_test(training)
        return False

    def test(self, scene: Scene, iteration: int, num_views: int) -> QualityReport | None:
        """Measures the quality of test views and reports it to the listener.

        Args:
            scene: The scene to render.
            iteration: Number of the iteration, for the report.
            num_views: Maximum number of views.

        Returns:
            The quality; None if there are no test views.
        """
        if self.test_data is None:
            return None
        renderer = create_renderer("cpu" if self.device.type == "cpu" else "gsplat")
        report = assess_scene(scene, self.test_data, num_views, iteration, renderer)
        self.listener.tested(report)
        return report

    def _checkpoint_and_test(self, training: ModelTraining) -> None:
        """Writes a checkpoint and tests the scene, at the intervals of the options."""
        state, options = training.state, self.options
        if state.iteration == training.iterations:
            return
        if state.iteration % options.checkpoint_interval == 0:
            self._write_checkpoint(training)
        if options.test_interval and state.iteration % options.test_interval == 0 and self.test_data is not None:
            self.test(training.scene(self.device), state.iteration, options.max_test_views)

    def _write_checkpoint(self, training: ModelTraining) -> None:
        """Writes a checkpoint if the options name a checkpoint file.

        Raises:
            DivergedError: If a parameter is not finite, also without a checkpoint file, or another value of the
                checkpoint is not finite.
        """
        check_finite(training.state.parameters, training.state.iteration)
        if self.options.checkpoint is not None:
            training.save(self.options.checkpoint)
