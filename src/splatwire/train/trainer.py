"""The loop around the step: views in random order, test pictures, checkpoints, news for whoever listens."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.data import Dataset
from splatwire.entropy.rate import binary_entropy_bits
from splatwire.errors import DatasetError, DivergedError
from splatwire.metrics import psnr, ssim
from splatwire.model import AnchorScene
from splatwire.render.base import Renderer, create_renderer
from splatwire.render.render import iterate_views
from splatwire.scene import Cameras
from splatwire.train.checkpoint import save_checkpoint
from splatwire.train.config import TrainConfig
from splatwire.train.context import AnchorCache
from splatwire.train.export import export_scene
from splatwire.train.grid import sign_bits
from splatwire.train.initial import initial_state
from splatwire.train.kernels import Kernels, choose_kernels
from splatwire.train.photos import PhotoStore, check_photos
from splatwire.train.refine import refine_context
from splatwire.train.state import TrainState, move_state
from splatwire.train.step import StepReport, train_step

_MEMORY = 0.98
"""Share of the past in the running means that are shown."""
_POSITION_BITS = 11
_WEIGHT_BITS = 6
"""About what the codec needs for an anchor's position and for a weight; only for the estimate on the way."""


@dataclass(frozen=True)
class Progress:
    """How a run is doing.

    Attributes:
        iteration: Iterations done.
        iterations: Iterations in all.
        loss: Running mean of the loss.
        l1: Running mean of the pictures' absolute error.
        num_anchors: Anchors.
        estimated_bytes: Estimated size of the encoded scene; None before the context phase.
        seconds: Since this part of the run began.
        iterations_per_second: Over the last iterations.
    """

    iteration: int
    iterations: int
    loss: float
    l1: float
    num_anchors: int
    estimated_bytes: int | None
    seconds: float
    iterations_per_second: float


@dataclass(frozen=True, eq=False)
class QualityReport:
    """Pictures of test views, not quantised.

    Attributes:
        iteration: When.
        psnr: Mean over the views, decibels.
        ssim: Mean over the views.
        num_views: Views drawn.
        preview: The first view's photo and picture side by side.
    """

    iteration: int
    psnr: float
    ssim: float
    num_views: int
    preview: Float[Tensor, "H W2 3"]


@dataclass(frozen=True)
class Listener:
    """What to call during a run.

    Attributes:
        progress: After every iteration.
        tested: After test views were drawn.
        should_stop: Asked after every iteration; True ends the run with a checkpoint.
        refining: While the context model is fitted again at the end; the share that is done.
    """

    progress: Callable[[Progress], None] = lambda progress: None
    tested: Callable[[QualityReport], None] = lambda report: None
    should_stop: Callable[[], bool] = lambda: False
    refining: Callable[[float], None] = lambda share: None


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
    run = _Run(config, options, listener, train, test, place, choose_kernels(place))
    photos = PhotoStore(train, place)
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
    """The loop and its running means."""

    config: TrainConfig
    options: RunOptions
    listener: Listener
    train: Dataset
    test_views: Dataset | None
    device: torch.device
    kernels: Kernels
    seconds: float = 0.0
    means: dict[str, float] = field(default_factory=dict)

    def loop(self, state: TrainState, photos: PhotoStore) -> bool:
        """Trains to the end; returns True if it was stopped before."""
        cache, cameras = AnchorCache(self.config.model), self._cameras()
        while state.iteration < self.config.marks.iterations:
            started = time.perf_counter()
            if not state.queue:
                state.queue = torch.randperm(cameras.num_views, generator=state.generator).tolist()
            view = state.queue.pop()
            report = train_step(state, self.config, cameras, view, photos.photo(view), cache, self.kernels)
            elapsed = time.perf_counter() - started
            self.seconds += elapsed
            self.listener.progress(self._progress(state, report, elapsed))
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
        return replace(cameras, viewmats=cameras.viewmats.to(self.device), Ks=cameras.Ks.to(self.device))

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

    def _progress(self, state: TrainState, report: StepReport, elapsed: float) -> Progress:
        bits = report.bits_per_anchor
        for name, value in (("loss", report.loss), ("l1", report.l1), ("seconds", elapsed), ("bits", bits)):
            if value is not None:
                self.means[name] = _MEMORY * self.means.get(name, value) + (1 - _MEMORY) * value
        estimate = estimate_bytes(state, self.means["bits"]) if bits is not None else None
        return Progress(
            iteration=state.iteration,
            iterations=self.config.marks.iterations,
            loss=self.means["loss"],
            l1=self.means["l1"],
            num_anchors=state.num_anchors,
            estimated_bytes=estimate,
            seconds=self.seconds,
            iterations_per_second=1 / max(self.means["seconds"], 1e-9),
        )


def assess_scene(
    scene: AnchorScene, dataset: Dataset, num_views: int, iteration: int, renderer: str | Renderer = "cpu"
) -> QualityReport:
    """Draws the first views of a dataset evenly spread over it, and compares them with the photos.

    Args:
        scene: The scene.
        dataset: Test views.
        num_views: At most so many.
        iteration: For the report.
        renderer: What draws them.
    """
    count = min(num_views, dataset.num_views)
    views = [i * dataset.num_views // count for i in range(count)]
    chosen = dataset.select(views)
    background = torch.tensor(dataset.background)
    scores: list[tuple[float, float]] = []
    preview = None
    for i, drawn in enumerate(iterate_views(scene, chosen.cameras, renderer=renderer, background=background)):
        photo, image = chosen.image(i), drawn.cpu()
        mask = chosen.mask(i)
        compared = (image[None], photo[None], None if mask is None else mask[None])
        scores.append((float(psnr(*compared)[0]), float(ssim(*compared)[0])))
        if preview is None:
            preview = torch.cat([photo, image], dim=1)
    assert preview is not None
    means = torch.tensor(scores, dtype=torch.float64).mean(dim=0)
    return QualityReport(iteration, float(means[0]), float(means[1]), count, preview)


@torch.no_grad()
def estimate_bytes(state: TrainState, bits_per_anchor: float) -> int:
    """Estimates what the codec will make of a state, from the running mean of its anchors' bits."""
    parameters = state.parameters
    mask = parameters["mask_logits"] > -4.6  # sigmoid 0.01
    alive = mask.any(dim=1)
    kept = int(alive.sum())
    weights = sum(v.numel() for name, v in parameters.items() if name.split(".")[0] in ("heads", "prior", "channel"))
    total = state.num_anchors * bits_per_anchor + kept * _POSITION_BITS + weights * _WEIGHT_BITS
    total += float(sign_bits(parameters["grid.volume"], parameters["grid.planes"]))
    total += binary_entropy_bits(float(mask[alive].sum()), mask[alive].numel())
    return round(total / 8)
