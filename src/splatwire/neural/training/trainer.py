"""Training of anchors from posed photos."""

import time
from dataclasses import dataclass
from pathlib import Path

import torch

from splatwire.arguments import checked
from splatwire.data import Dataset
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.checkpoint import save_checkpoint
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import Kernels, choose_kernels
from splatwire.neural.training.loop import RunOptions, TrainingLoop, training_device
from splatwire.neural.training.photometric_loss import Photo
from splatwire.neural.training.progress import Listener, RunningMeans, estimate_bytes
from splatwire.neural.training.quality import QualityReport
from splatwire.neural.training.refine import refine_context
from splatwire.neural.training.size import control_size
from splatwire.neural.training.state import TrainState, move_state
from splatwire.neural.training.step import StepReport, TrainingStep
from splatwire.types import AnchorScene, Cameras


@dataclass(frozen=True, eq=False)
class TrainResult:
    """Result of a training.

    Attributes:
        scene: The trained scene, on the CPU.
        state: The final state, on the training device.
        test: Quality in the last test; None without test views, or if the training was stopped.
        stopped: True if the listener ended the training early.
        seconds: Duration of the iterations and of the refinement of the context model in seconds, without tests.
    """

    # The context model is refined unless the training was stopped.

    scene: AnchorScene
    state: TrainState
    test: QualityReport | None
    stopped: bool
    seconds: float


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
        state: State to continue from, changed in place if already on the device: a new one, or that of a checkpoint or
            of a finished scene. None for `initial_state(train, config)`.
        options: Options for checkpoints and tests; None for the defaults.
        listener: Callbacks for progress and stopping; None for no callbacks.
        device: Training device: `cpu`, or `cuda` with gsplat.

    Raises:
        BackendUnavailableError: If the device or its renderer is not available. Checked first.
        DatasetError: If the photos, poses or points are unusable. Checked before the first iteration.
        DivergedError: If the loss or a part of the state is not finite, or every anchor has become transparent.
        OSError: If a checkpoint cannot be written.
    """
    options, listener = options or RunOptions(), listener or Listener()
    torch_device = training_device(device)
    kernels = choose_kernels(torch_device)
    loop = TrainingLoop(options, listener, train, test, torch_device, kernels)
    photos = loop.read_photos()
    if state is None:
        state = initial_state(train, config)
    cameras = train.cameras.relative_to(state.origin)
    training = _AnchorTraining(move_state(state, torch_device), config, cameras, kernels)
    stopped = loop.run(training, photos)
    state, report = training.state, None
    if test is not None and not stopped:
        report = loop.test(training.scene(torch_device), state.iteration, test.num_views)
    scene = export_scene(state, config)
    if not stopped:
        started = time.perf_counter()
        scene = refine_context(scene, config.refine, progress=listener.final_task)
        loop.seconds += time.perf_counter() - started
    return TrainResult(scene, state, report, stopped, loop.seconds)


class _AnchorTraining:
    """Training of anchors, run by the training loop (`TrainingLoop`).

    Args:
        state: State of the training, on the training device; changed in place.
        config: The configuration.
        cameras: The training cameras.
        kernels: Implementations of the expensive operations for that device.
    """

    def __init__(self, state: TrainState, config: TrainConfig, cameras: Cameras, kernels: Kernels) -> None:
        self.state, self._config, self.iterations = state, config, config.milestones.iterations
        self._step = TrainingStep(config, to_tensors(cameras, state.device), kernels)
        self.running_means = RunningMeans(
            self.iterations,
            kernels.report_interval,
            lambda state, bits: estimate_bytes(state, bits, config.mask_threshold),
        )

    def step(self, view: int, photo: Photo) -> StepReport:
        """Performs one training iteration with the photo of a view, and adjusts the weight of the bit rate."""
        report = self._step(self.state, view, photo)
        control_size(self.state, self._config, self._step.size_estimator)
        return report

    def save(self, path: Path) -> None:
        """Writes a checkpoint of the training to a file."""
        save_checkpoint(self.state, self._config, path)

    def scene(self, device: torch.device) -> AnchorScene:
        """Returns the scene of the present state of the training.

        Args:
            device: Device for the computation.
        """
        return export_scene(self.state, self._config, device)
