"""Offline calibration of the inpainting network on its own scene by packet-aligned pseudo-dropout (paper, 3.4)."""

import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.conceal import AnchorContext, context_of
from splatwire.conceal.gnn.concealer import repair
from splatwire.conceal.gnn.fusion import Branches, branches, fuse
from splatwire.conceal.gnn.graph import RepairGraph, build_graph, prior_rows, query_inputs, source_inputs
from splatwire.conceal.gnn.network import InpaintingNetwork, InputSizes
from splatwire.conceal.gnn.settings import GNN_PRESETS, GnnSettings
from splatwire.conceal.gnn.weights import GnnWeights, load_tensors, read_tensors, scene_fingerprint, write_tensors
from splatwire.errors import BitstreamError, DivergedError, InvalidValueError
from splatwire.model import AnchorScene, PartialScene
from splatwire.model.gaussian_heads import generate_gaussians
from splatwire.packets import PacketGroups, SceneStream, arrange
from splatwire.packets.plan import PacketPlan
from splatwire.render import create_renderer
from splatwire.scene import Anchors, Cameras, Erasures
from splatwire.train.gnn_losses import LOSS_PRESETS, LossWeights, channel_spread, normalized_errors, parameter_losses

CHECKPOINT_FORMAT = "splatwire-gnn-checkpoint"
CHECKPOINT_VERSION = 1
_NEVER = 1.01
"""A threshold that no confidence reaches."""
_RUN = 64
"""Queries of a batch that lie next to each other: they share neighbours, and the smoothness term needs company."""


@dataclass(frozen=True)
class CalibrationConfig:
    """A calibration run.

    Attributes:
        settings: The network.
        losses: Weights of the loss terms.
        iterations: Most steps; the paper's are 15,000 to 20,000.
        learning_rate: Of Adam at the beginning; it decays to 0 with half a cosine.
        drop_rate: Share of packets that a pseudo-loss takes.
        train_masks: Pseudo-losses that are trained on; their graphs and interpolations are computed once.
        validation_masks: Pseudo-losses that are never trained on.
        batch: Queries per step.
        validation_interval: Steps between validations.
        patience: Validations without improvement after which the run ends.
        seed: Seed of everything random.
    """

    settings: GnnSettings = field(default_factory=GnnSettings)
    losses: LossWeights = field(default_factory=LossWeights)
    iterations: int = 2000
    learning_rate: float = 1e-3
    drop_rate: float = 0.2
    train_masks: int = 12
    validation_masks: int = 3
    batch: int = 512
    validation_interval: int = 100
    patience: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        counts = ("iterations", "train_masks", "validation_masks", "batch", "validation_interval", "patience")
        bad = [name for name in counts if getattr(self, name) < 1]
        bad += [] if 0 < self.drop_rate < 1 else ["drop_rate"]
        bad += [] if 0 < self.learning_rate < math.inf else ["learning_rate"]
        bad += [] if self.seed >= 0 else ["seed"]
        if bad:
            raise InvalidValueError(f"calibration cannot run with {', '.join(f'{n}={getattr(self, n)}' for n in bad)}")


CALIBRATION_PRESETS = {
    "paper": CalibrationConfig(GNN_PRESETS["paper"], LOSS_PRESETS["feature"]),
    "full": CalibrationConfig(GNN_PRESETS["full"], LOSS_PRESETS["full"]),
    "compact": CalibrationConfig(GNN_PRESETS["compact"], LOSS_PRESETS["feature"]),
}
"""`paper`: feature-focused, as reported. `full`: every attribute. `compact`: feature-focused with few weights."""


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a sender calibrates on.

    Attributes:
        scene: The complete scene as a decoder returns it.
        context: The same for a concealer, nothing lost.
        groups: Anchors by packet.
        cameras: Views of the rendering loss; None without it.
    """

    scene: AnchorScene
    context: AnchorContext
    groups: PacketGroups
    cameras: Cameras | None = None


@dataclass(frozen=True)
class CalibrationProgress:
    """How far a run is. `errors` and `reference` are of the last validation: this network's and the interpolation's."""

    iteration: int
    iterations: int
    loss: float
    errors: dict[str, float]
    reference: dict[str, float]


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What came out.

    Attributes:
        weights: The best network of the run, with thresholds that never trust an attribute which did not get better
            on held-out losses.
        errors: Its errors on the held-out losses (`normalized_errors`), by attribute.
        reference: The interpolation's errors on the same losses.
        iterations: Steps taken.
        seconds: Time taken.
    """

    weights: GnnWeights
    errors: dict[str, float]
    reference: dict[str, float]
    iterations: int
    seconds: float


def calibration_data(stream: SceneStream, complete: PartialScene, cameras: Cameras | None = None) -> CalibrationData:
    """Prepares a decoded stream.

    Args:
        stream: The complete stream: it says which anchors share a packet.
        complete: What the decoder made of it.
        cameras: Views of the rendering loss.

    Raises:
        InvalidValueError: If something was lost, or there are fewer than two packets.
    """
    plan = PacketPlan(stream.manifest.packetization, stream.manifest.num_anchors)
    groups = arrange(plan, stream.packets).groups if plan.packetization.hashed else plan.groups()
    if complete.erasures.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    if len(groups.starts) < 3:
        raise InvalidValueError("calibration needs a stream of at least two packets")
    return CalibrationData(complete.scene, context_of(complete).to_cpu(), groups, cameras)


def pseudo_loss(groups: PacketGroups, num_anchors: int, rate: float, seed: int) -> Bool[Tensor, "N"]:
    """Draws which anchors are known after a share of the packets, at least one and not all, was dropped."""
    count = len(groups.starts) - 1
    dropped = np.random.default_rng(seed).permutation(count)[: min(max(round(rate * count), 1), count - 1)]
    known = torch.ones(num_anchors, dtype=torch.bool)
    for group in dropped:
        known[torch.from_numpy(groups.ranks[groups.starts[group] : groups.starts[group + 1]])] = False
    return known


def without(context: AnchorContext, known: Bool[Tensor, "N"]) -> AnchorContext:
    """The context that a receiver has when only `known` anchors have arrived."""
    a, keep = context.anchors, known[:, None]
    anchors = Anchors(a.positions, a.features * keep, a.scalings * keep, a.offsets * keep[:, :, None], a.mask & keep)
    return AnchorContext(anchors, Erasures.of_anchors(known), context.prior, context.layout)


class _Run:
    """A run's state: network, optimiser, generator, best weights so far."""

    def __init__(self, data: CalibrationData, config: CalibrationConfig) -> None:
        self.data, self.config = data, config
        context = data.context
        rows = config.train_masks + config.validation_masks
        graphs = [self._graph(seed) for seed in np.random.SeedSequence(config.seed).generate_state(rows).tolist()]
        self.train, self.held_out = graphs[: config.train_masks], graphs[config.train_masks :]
        self.network = InpaintingNetwork(
            InputSizes(context.layout, context.prior.context.shape[1]), config.settings, config.seed
        )
        _standardise(self.network, context, self.train[0])
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.rng = torch.Generator().manual_seed(config.seed)
        self.spread = channel_spread(context.anchors)
        self.reference = self._mean_errors([graph.interpolated for graph in self.held_out])
        self.iteration, self.stale = 0, 0
        self.best_errors = self.validate()
        self.best = {name: value.clone() for name, value in self.network.state_dict().items()}
        self._pictures: dict[int, Tensor] = {}

    def _graph(self, seed: int) -> RepairGraph:
        c = self.config
        known = pseudo_loss(self.data.groups, self.data.context.anchors.num_anchors, c.drop_rate, seed)
        return build_graph(without(self.data.context, known), c.settings)

    def score(self, errors: dict[str, float]) -> float:
        """Mean error of the trained attributes."""
        trained = [errors[name] for name in errors if getattr(self.config.losses, name) > 0]
        return sum(trained) / len(trained)

    def step(self) -> float:
        """One step of Adam on one batch of one pseudo-loss."""
        self.iteration += 1
        config, context = self.config, self.data.context
        share = (self.iteration - 1) / config.iterations
        for group in self.optimiser.param_groups:
            group["lr"] = config.learning_rate * 0.5 * (1 + math.cos(math.pi * share))
        graph = self.train[int(torch.randint(len(self.train), (), generator=self.rng))]
        part = graph.select(_batch(len(graph.queries), config.batch, self.rng))
        used, place = part.index.unique(return_inverse=True)
        sources = self.network.encode_sources(source_inputs(context, used))
        raw = self.network(query_inputs(context, part), sources, place)
        parts = branches(raw, prior_rows(context.prior, part.queries), part.interpolated, config.settings)
        truth = context.anchors.select(part.queries)
        loss = parameter_losses(parts, truth, truth.positions, config.losses).total(config.losses)
        if config.losses.render:
            loss = loss + config.losses.render * self._render_loss(parts, part)
        if not bool(torch.isfinite(loss)):
            raise DivergedError(self.iteration)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return float(loss.detach())

    def _render_loss(self, parts: Branches, part: RepairGraph) -> Float[Tensor, ""]:
        """Mean absolute difference of one view's pictures: the batch concealed, nothing lost."""
        cameras, scene = self.data.cameras, self.data.scene
        if cameras is None:
            raise InvalidValueError("a rendering loss needs cameras")
        view = int(torch.randint(cameras.num_views, (), generator=self.rng))
        draw, black = create_renderer("cpu"), torch.zeros(3)
        if view not in self._pictures:
            with torch.no_grad():
                complete = generate_gaussians(scene, cameras, view)
                self._pictures[view] = draw(complete, cameras.select([view]), background=black)[0]
        concealed, a = fuse(parts, part.interpolated, self.config.settings), scene.anchors
        rows = (part.queries,)
        anchors = Anchors(
            a.positions,
            a.features.index_put(rows, concealed.features),
            a.scalings.index_put(rows, concealed.scalings.clamp(min=float(a.scalings.min()))),
            a.offsets.index_put(rows, concealed.offsets * concealed.mask[:, :, None]),
            a.mask.index_put(rows, concealed.mask),
        )
        gaussians = generate_gaussians(replace(scene, anchors=anchors), cameras, view)
        picture = draw(gaussians, cameras.select([view]), background=black)[0]
        return (picture - self._pictures[view]).abs().mean()

    def validate(self) -> dict[str, float]:
        """Errors on the held-out losses, exactly as a receiver would conceal them."""
        return self._mean_errors([repair(self.data.context, graph, self.network) for graph in self.held_out])

    def _mean_errors(self, repaired: list[Anchors]) -> dict[str, float]:
        truth = self.data.context.anchors
        pairs = zip(repaired, self.held_out, strict=True)
        each = [normalized_errors(anchors, truth, self.spread, graph.queries) for anchors, graph in pairs]
        return {name: sum(errors[name] for errors in each) / len(each) for name in each[0]}

    def improve(self) -> dict[str, float]:
        """Validates, and keeps the network if it is the best so far."""
        errors = self.validate()
        if self.score(errors) < self.score(self.best_errors):
            self.best, self.best_errors, self.stale = (
                {name: value.clone() for name, value in self.network.state_dict().items()},
                errors,
                0,
            )
        else:
            self.stale += 1
        return errors

    def finished(self) -> bool:
        """Whether there is nothing left to do."""
        return self.iteration >= self.config.iterations or self.stale >= self.config.patience

    def result(self, seconds: float) -> CalibrationResult:
        """The best network; attributes that it does not improve are left to the interpolation."""
        self.network.load_state_dict(self.best)
        settings, kept = self.network.settings, {}
        for name in ("feature", "scaling", "offset"):
            untrained = not self.config.losses.trains(name)
            if untrained or self.best_errors[name] >= self.reference[name]:
                kept[f"{name}_threshold"] = max(_NEVER, getattr(settings, f"{name}_threshold"))
        self.network.settings = replace(settings, **kept)
        errors = self.validate()
        record = {f"{name}_error": value for name, value in errors.items()}
        record |= {f"{name}_reference": value for name, value in self.reference.items()}
        network = self.network.eval().requires_grad_(False)
        weights = GnnWeights(network, scene_fingerprint(self.data.context), record)
        return CalibrationResult(weights, errors, self.reference, self.iteration, seconds)


def calibrate(
    data: CalibrationData,
    config: CalibrationConfig,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[CalibrationProgress], None] | None = None,
) -> CalibrationResult:
    """Calibrates a network on a scene.

    Args:
        data: The complete scene and its packets.
        config: The run.
        checkpoint: File that is written at every validation; None for none.
        resume: Whether to go on from it; the configuration must be the same.
        progress: Called after every step.

    Returns:
        The network that was best on held-out losses.

    Raises:
        DivergedError: If the loss is not finite.
        InvalidValueError: If a rendering loss has no cameras, or the checkpoint is of another run.
        BitstreamError: If the checkpoint is damaged.
    """
    if config.losses.render and data.cameras is None:
        raise InvalidValueError("a rendering loss needs cameras")
    started = time.perf_counter()
    run = _Run(data, config)
    if resume and checkpoint is not None:
        _restore(run, checkpoint)
    errors = run.best_errors
    while not run.finished():
        loss = run.step()
        if run.iteration % config.validation_interval == 0 or run.iteration == config.iterations:
            errors = run.improve()
            if checkpoint is not None:
                _save(run, checkpoint)
        if progress is not None:
            progress(CalibrationProgress(run.iteration, config.iterations, loss, errors, run.reference))
    return run.result(time.perf_counter() - started)


def _standardise(network: InpaintingNetwork, context: AnchorContext, graph: RepairGraph) -> None:
    """Fixes the constants that bring inputs to mean 0 and spread 1."""
    known = graph.index.unique()
    for name, inputs in (("source", source_inputs(context, known)), ("query", query_inputs(context, graph))):
        spread = inputs.std(dim=0, correction=0)
        network.get_buffer(f"{name}_mean").copy_(inputs.mean(dim=0))
        network.get_buffer(f"{name}_spread").copy_(torch.where(spread > 1e-9, spread, 1.0))


def _batch(count: int, size: int, rng: torch.Generator) -> Int64[Tensor, "B"]:
    """Rows of a batch: runs of neighbouring queries (they are in the order of the stream)."""
    if count <= size:
        return torch.arange(count)
    run = min(_RUN, size)
    starts = torch.randint(count - run + 1, (max(1, size // run),), generator=rng)
    return (starts[:, None] + torch.arange(run)).flatten().unique()


def _save(run: _Run, path: Path) -> None:
    tensors = {f"network.{name}": value for name, value in run.network.state_dict().items()}
    tensors |= {f"best.{name}": value for name, value in run.best.items()}
    for place, state in run.optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{place}.{name}": torch.as_tensor(value) for name, value in state.items()}
    tensors["generator"] = run.rng.get_state()
    header = {
        "format": CHECKPOINT_FORMAT,
        "version": CHECKPOINT_VERSION,
        "config": dataclasses.asdict(run.config),
        "fingerprint": scene_fingerprint(run.data.context),
        "iteration": run.iteration,
        "stale": run.stale,
        "best_errors": run.best_errors,
    }
    write_tensors({name: value.detach().clone().contiguous() for name, value in tensors.items()}, header, path)


def _restore(run: _Run, path: Path) -> None:
    tensors, header = read_tensors(path, CHECKPOINT_FORMAT, CHECKPOINT_VERSION)
    wanted = (dataclasses.asdict(run.config), scene_fingerprint(run.data.context))
    if (header.get("config"), header.get("fingerprint")) != wanted:
        raise InvalidValueError(f"{path}: the checkpoint is of another scene or of other settings")

    def part(prefix: str) -> dict[str, Tensor]:
        return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}

    load_tensors(run.network, part("best."), f"{path}: ")
    run.best = {name: value.clone() for name, value in run.network.state_dict().items()}
    load_tensors(run.network, part("network."), f"{path}: ")
    try:
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in part("adam.").items():
            place, key = name.split(".", 1)
            state.setdefault(int(place), {})[key] = value
        run.optimiser.load_state_dict({**run.optimiser.state_dict(), "state": state})
        run.rng.set_state(tensors["generator"])
        run.iteration, run.stale = int(header["iteration"]), int(header["stale"])
        run.best_errors = {str(name): float(value) for name, value in header["best_errors"].items()}
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise BitstreamError(f"{path}: the checkpoint is damaged: {error}") from error
