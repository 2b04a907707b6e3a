"""Training of explicit Gaussians from posed photos."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from splatwire.arguments import checked
from splatwire.channel import parse_loss
from splatwire.data import Dataset
from splatwire.finetuning import FineTuning, Pictures, fine_tune
from splatwire.finetuning import Progress as TuningProgress
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.gaussians.checkpoint import save_gaussian_checkpoint
from splatwire.neural.training.gaussians.config import GaussianConfig
from splatwire.neural.training.gaussians.initial import initial_gaussians
from splatwire.neural.training.gaussians.state import GaussianState
from splatwire.neural.training.gaussians.step import GaussianStep
from splatwire.neural.training.kernels import Kernels, choose_kernels
from splatwire.neural.training.loop import RunOptions, TrainingLoop, training_device
from splatwire.neural.training.photometric_loss import Photo
from splatwire.neural.training.progress import Listener, RunningMeans
from splatwire.neural.training.quality import QualityReport
from splatwire.neural.training.step import StepReport
from splatwire.types import Cameras, SplatScene


@dataclass(frozen=True, eq=False)
class GaussianResult:
    """Result of a training of explicit Gaussians.

    Attributes:
        scene: The trained Gaussians, on the CPU. After a complete fine-tuning, the values are already rounded to
            quantisation steps, so that encoding the scene without a quality setting is lossless.
        state: State before the fine-tuning, on the training device.
        test: Quality of `scene` in the test views at the end; None without test views, or if the training was stopped.
        stopped: True if the listener ended the training early.
        seconds: Duration of the iterations and of the fine-tuning in seconds, without tests.
    """

    scene: SplatScene
    state: GaussianState
    test: QualityReport | None
    stopped: bool
    seconds: float


class _StoppedError(Exception):
    """Raised during the final fine-tuning if the caller's `listener` requests to stop the training."""


@checked
def train_gaussians(
    train: Dataset,
    test: Dataset | None,
    config: GaussianConfig,
    *,
    state: GaussianState | None = None,
    options: RunOptions | None = None,
    listener: Listener | None = None,
    device: str = "cpu",
) -> GaussianResult:
    """Trains explicit Gaussians on photos, or resumes a training.

    The training ends with a fine-tuning on the CPU.

    Args:
        train: Training views and points.
        test: Test views; None for no tests.
        config: The configuration.
        state: State to continue from, changed in place if already on the device: a new one, or that of a checkpoint.
            None for a new one.
        options: Options for checkpoints and tests; None for the defaults.
        listener: Callbacks for progress and stopping; None for no callbacks.
        device: Training device: `cpu`, or `cuda` with gsplat.

    Raises:
        BackendUnavailableError: If the device or its renderer is not available. Checked first.
        DatasetError: If the photos, poses or points are unusable. Checked before the first iteration.
        DivergedError: If the loss or a part of the state is not finite.
        InvalidValueError: If no visible Gaussian is left.
        OSError: If a checkpoint cannot be written.
    """
    # A fine-tuning that was stopped is repeated from its beginning.
    options, listener = options or RunOptions(), listener or Listener()
    torch_device = training_device(device)
    kernels = choose_kernels(torch_device)
    loop = TrainingLoop(options, listener, train, test, torch_device, kernels)
    photos = loop.read_photos()
    if state is None:
        state = initial_gaussians(train, config)
    model = _GaussianTraining(state.moved(torch_device), config, train.cameras.relative_to(state.origin), kernels)
    stopped = loop.run(model, photos)
    scene = model.scene(torch_device)
    if config.fine_tuning_iterations and not stopped:
        started = time.perf_counter()
        try:
            scene = _fine_tuned(scene, train, config, listener)
        except _StoppedError:
            stopped = True
        loop.seconds += time.perf_counter() - started
    report = None
    if test is not None and not stopped:
        report = loop.test(scene, model.state.iteration, test.num_views)
    return GaussianResult(scene, model.state, report, stopped, loop.seconds)


def _fine_tuned(scene: SplatScene, train: Dataset, config: GaussianConfig, listener: Listener) -> SplatScene:
    """Fine-tunes Gaussians on the training photos with the codec's rounding and, if configured, packet loss."""
    shown = scene.select(scene.drawable)
    options = FineTuning(
        config.quality,
        config.fine_tuning_iterations,
        packet_loss=None if config.packet_loss is None else parse_loss(config.packet_loss),
        seed=config.seed,
    )

    def progress(now: TuningProgress) -> None:
        listener.final_task(now.iteration / now.iterations)
        if now.iteration < now.iterations and listener.should_stop():
            raise _StoppedError

    return fine_tune(shown, Pictures.of_photos(train, scene.origin), options, progress)


class _GaussianTraining:
    """Training of explicit Gaussians, run by the training loop (`TrainingLoop`).

    Args:
        state: State of the training, on the training device; changed in place.
        config: The configuration.
        cameras: The training cameras.
        kernels: Implementations of the expensive operations for that device.
    """

    def __init__(self, state: GaussianState, config: GaussianConfig, cameras: Cameras, kernels: Kernels) -> None:
        self.state, self._config, self.iterations = state, config, config.iterations
        self._step: Callable[[GaussianState, int, Photo], StepReport] = GaussianStep(
            config, to_tensors(cameras, state.device), kernels
        )
        self.running_means = RunningMeans(self.iterations, kernels.report_interval, elements=SplatScene.ELEMENTS)

    def step(self, view: int, photo: Photo) -> StepReport:
        """Performs one training iteration with the photo of a view."""
        return self._step(self.state, view, photo)

    def save(self, path: Path) -> None:
        """Writes a checkpoint of the training to a file."""
        save_gaussian_checkpoint(self.state, self._config, path)

    def scene(self, device: torch.device) -> SplatScene:
        """Returns the Gaussians of the present state of the training, on the CPU; `device` is ignored."""
        return self.state.scene(self._config.degree, self._config.background)
