"""State of a calibration, and checkpoints of this state."""

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.calibration.pseudo_loss import CalibrationData
from splatwire.errors import MALFORMED, BitstreamError, DivergedError, InvalidValueError
from splatwire.neural.model.gaussian_heads import generate_gaussians
from splatwire.neural.model.tensors import load_tensors, to_tensors
from splatwire.neural.render.renderers import create_differentiable_renderer
from splatwire.neural.training.schedule import half_cosine
from splatwire.paper.calibration.config import CalibrationConfig
from splatwire.paper.calibration.losses import channel_spread, normalized_errors, parameter_losses, weighted_sum
from splatwire.paper.gnn.concealer import repair
from splatwire.paper.gnn.fusion import Branches, branches, fuse
from splatwire.paper.gnn.graph import RepairGraph, build_graph, prior_rows, query_inputs, source_inputs
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.quantise import rounded_constants, rounded_parameters
from splatwire.paper.gnn.section import rounded_weights
from splatwire.paper.gnn.weights import GnnWeights, scene_fingerprint
from splatwire.types import AnchorLayout, Anchors, Prior, ReceivedScene

CHECKPOINT_FORMAT = "splatwire-gnn-checkpoint"
CHECKPOINT_VERSION = 3
_NEVER = 1.01
"""Confidence threshold of a disabled attribute; no confidence reaches it."""
_RUN = 64
"""Number of consecutive lost anchors that are added to a batch together.

They are close to each other, so they share neighbours; the smoothness term of the loss needs close anchors.
"""


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """Result of a calibration.

    Attributes:
        weights: The trained network.
        errors: Errors of the network on the held-out pseudo-losses, by attribute (`normalized_errors`).
        reference: Errors of the interpolation on the same pseudo-losses, by attribute.
        iterations: Number of training steps.
        seconds: Duration in seconds.
    """

    weights: GnnWeights
    errors: dict[str, float]
    reference: dict[str, float]
    iterations: int
    seconds: float


def pseudo_graphs(data: CalibrationData, config: CalibrationConfig) -> Iterator[RepairGraph]:
    """Simulates packet losses, and yields for each of them the graph that connects lost anchors to received anchors.

    The graphs for training come first, then those for validation.

    Args:
        data: The complete scene and its packets.
        config: Number of losses, loss rate and seed.
    """
    rates = [config.drop_rate] * (config.train_masks + config.validation_masks)
    for fully_received in data.pseudo_losses(rates, config.seed):
        yield build_graph(data.complete.masked(fully_received), config.settings)


class CalibrationRun:
    """State of a calibration of the inpainting network: network, optimiser, random generator, best weights so far.

    Args:
        data: The complete scene and its packets.
        config: The configuration.
        graphs: One graph of neighbours for each simulated packet loss, from `pseudo_graphs`; None to build them.
        device: Torch device for the training steps.
    """

    def __init__(
        self, data: CalibrationData, config: CalibrationConfig, graphs: Sequence[RepairGraph] | None = None,
        device: str = "cpu",
    ) -> None:  # fmt: skip
        self.data, self.config = to_tensors(data), config
        context = self.data.complete
        graphs = list(pseudo_graphs(data, config)) if graphs is None else graphs
        self.train, self.held_out = graphs[: config.train_masks], graphs[config.train_masks :]
        self.network = InpaintingNetwork(
            InputSizes(context[AnchorLayout], context[Prior].context_features.shape[1]), config.settings, config.seed
        )
        _standardise(self.network, context, self.train[0])
        self.place_on(device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.rng = torch.Generator().manual_seed(config.seed)
        self.reference = self._mean_errors([graph.interpolated for graph in self.held_out])
        self.iteration, self.stale = 0, 0
        self.best_errors = self.validate()
        self.best = self._copy()
        self._pictures: dict[int, Tensor] = {}

    def place_on(self, device: str) -> None:
        """Moves scene, neighbour graphs and network to a torch device."""
        # The random generator stays on the CPU.
        self.context = to_tensors(self.data.complete, device)
        self.train, self.held_out = (list(to_tensors(tuple(part), device)) for part in (self.train, self.held_out))
        self.spread = channel_spread(self.context.scene.anchors)
        self.network.to(device)

    @property
    def rounding(self) -> bool:
        """True if the current training step uses quantised weights."""
        return self.config.bits > 0 and self.iteration >= self.config.rounded_from

    def _as_sent(self) -> AbstractContextManager[None]:
        return rounded_parameters(self.network, self.config.bits) if self.rounding else nullcontext()

    def score(self, errors: dict[str, float]) -> float:
        """Returns the mean error of all trained attributes, for comparing networks."""
        trained = [errors[name] for name in errors if getattr(self.config.losses, name) > 0]
        return sum(trained) / len(trained)

    def step(self) -> float:
        """Performs one step of Adam on a batch of lost anchors, for a random simulated loss; returns the training loss.

        Raises:
            DivergedError: If the loss is not finite.
        """
        self.iteration += 1
        config = self.config
        share = (self.iteration - 1) / config.iterations
        for group in self.optimiser.param_groups:
            group["lr"] = config.learning_rate * half_cosine(share)
        graph = self.train[int(torch.randint(len(self.train), (), generator=self.rng))]
        part = graph.select(_batch(len(graph.queries), config.batch, self.rng).to(graph.queries.device))
        self.optimiser.zero_grad()
        with self._as_sent():
            loss = self._loss(part)
            if not bool(torch.isfinite(loss)):
                raise DivergedError(self.iteration)
            loss.backward()
        self.optimiser.step()
        if self.iteration == config.rounded_from:
            self.best_errors = (
                self.validate()
            )  # errors of exact weights are not comparable with those of rounded weights
            self.best, self.stale = self._copy(), 0
        return float(loss.detach())

    def _loss(self, part: RepairGraph) -> Float[Tensor, ""]:
        """Returns the training loss of a batch of lost anchors (queries)."""
        # The rendering term is a mean over pixels. It is multiplied by the number of queries, because the other
        # terms are sums over the queries.
        config, context = self.config, self.context
        used, index_in_used = part.index.unique(return_inverse=True)
        sources = self.network.encode_sources(source_inputs(context, used))
        raw = self.network(query_inputs(context, part), sources, index_in_used)
        parts = branches(raw, prior_rows(context[Prior], part.queries), part.interpolated, config.settings)
        truth = context.scene.anchors.select(part.queries)
        loss = weighted_sum(parameter_losses(parts, truth, truth.positions, config.losses), config.losses)
        if config.losses.render:
            loss = loss + config.losses.render * len(part.queries) * self._render_loss(parts, part)
        return loss

    def _copy(self) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in self.network.state_dict().items()}

    def _render_loss(self, estimates: Branches, graph: RepairGraph) -> Float[Tensor, ""]:
        """Returns the mean absolute difference between pictures of concealed and complete scene in a random view.

        Args:
            estimates: Estimates of the lost anchors' attributes by the network and by the interpolation.
            graph: Graph of the lost anchors.
        """
        cameras, scene = self.data.cameras, self.data.scene
        if cameras is None:
            raise InvalidValueError("a rendering loss needs cameras")
        view = int(torch.randint(cameras.num_views, (), generator=self.rng))
        draw, behind = create_differentiable_renderer("cpu"), torch.tensor(scene.background)
        if view not in self._pictures:
            with torch.no_grad():
                complete = generate_gaussians(scene, cameras, view)
                self._pictures[view] = draw(complete, cameras.select([view]), background=behind)[0]
        concealed, a = fuse(estimates, graph.interpolated, self.config.settings), scene.anchors
        rows = (graph.queries,)
        anchors = replace(
            a,
            features=a.features.index_put(rows, concealed.features),
            scalings=a.scalings.index_put(rows, concealed.scalings.clamp(min=float(a.scalings.min()))),
            offsets=a.offsets.index_put(rows, concealed.offsets * concealed.mask[:, :, None]),
            mask=a.mask.index_put(rows, concealed.mask),
        )
        gaussians = generate_gaussians(replace(scene, anchors=anchors), cameras, view)
        picture = draw(gaussians, cameras.select([view]), background=behind)[0]
        return (picture - self._pictures[view]).abs().mean()

    def validate(self) -> dict[str, float]:
        """Conceals the held-out losses exactly as a receiver does, and returns the mean errors by attribute."""
        with self._as_sent():
            return self._mean_errors([repair(self.context, graph, self.network) for graph in self.held_out])

    def _mean_errors(self, repaired: list[Anchors]) -> dict[str, float]:
        truth = self.context.scene.anchors
        pairs = zip(repaired, self.held_out, strict=True)
        each = [normalized_errors(anchors, truth, self.spread, graph.queries) for anchors, graph in pairs]
        return {name: sum(errors[name] for errors in each) / len(each) for name in each[0]}

    def keep_if_best(self) -> None:
        """Measures the network on held-out losses, and stores the weights if the error is the lowest so far."""
        errors = self.validate()
        if self.score(errors) < self.score(self.best_errors):
            self.best, self.best_errors, self.stale = self._copy(), errors, 0
        else:
            self.stale += 1

    def finished(self) -> bool:
        """Returns True if the calibration has ended, either after the last step or by early stopping.

        With `CalibrationConfig.selected`, training stops early after `CalibrationConfig.patience` validations without
        improvement. With `CalibrationConfig.bits`, the steps with exact weights are followed by steps with quantised
        weights. If the steps with exact weights stop early, the method restores the best network, skips to the first
        step with quantised weights, and returns False.
        """
        stale = self.config.selected and self.stale >= self.config.patience
        if stale and self.config.bits and not self.rounding:
            self.network.load_state_dict(self.best)
            self.iteration, self.stale, stale = self.config.rounded_from - 1, 0, False
        return self.iteration >= self.config.iterations or stale

    def result(self, seconds: float) -> CalibrationResult:
        """Ends the calibration, and returns the final network with its errors on the validation losses.

        Args:
            seconds: Duration of the calibration, for the result.
        """
        # The network is disabled for attributes that were not trained; they are interpolated instead. With
        # `CalibrationConfig.selected`, it is also disabled for attributes that it predicts no better than the
        # interpolation.
        self.place_on("cpu")
        config, settings, kept = self.config, self.network.settings, dict[str, Any]()
        if config.selected:
            self.network.load_state_dict(self.best)
        for name in ("feature", "scaling", "offset"):
            worse = config.selected and self.best_errors[name] >= self.reference[name]
            if worse or not config.losses.trains(name):
                kept[f"{name}_threshold"] = max(_NEVER, getattr(settings, f"{name}_threshold"))
        self.network.settings = replace(settings, **kept)
        self.network = self.network.eval().requires_grad_(False)
        weights = GnnWeights(self.network, scene_fingerprint(self.data.complete), {})
        if self.config.bits and weights.is_used:
            weights = rounded_weights(weights, self.data.complete, self.config.bits)
            self.network = weights.network
        repaired = [repair(self.context, graph, self.network) for graph in self.held_out]
        errors = self._mean_errors(repaired)
        record = {f"{name}_error": value for name, value in errors.items()}
        record |= {f"{name}_reference": value for name, value in self.reference.items()}
        return CalibrationResult(replace(weights, validation=record), errors, self.reference, self.iteration, seconds)


def _standardise(network: InpaintingNetwork, context: ReceivedScene, graph: RepairGraph) -> None:
    """Sets the constants that normalise the network's inputs: mean and deviation of each input in a graph."""
    # Mean and standard deviation of each input in a graph.
    received = graph.index.unique()
    for name, inputs in (("source", source_inputs(context, received)), ("query", query_inputs(context, graph))):
        spread = inputs.std(dim=0, correction=0)
        mean, spread = rounded_constants(inputs.mean(dim=0), torch.where(spread > 1e-9, spread, 1.0))
        network.get_buffer(f"{name}_mean").copy_(mean)
        network.get_buffer(f"{name}_spread").copy_(spread)


def _batch(count: int, size: int, rng: torch.Generator) -> Int64[Tensor, "B"]:
    """Selects random lost anchors (queries) for a training step.

    The selection consists of ranges of consecutive queries, which are close to each other in space.

    Args:
        count: Number of all lost anchors.
        size: Approximate number of queries to draw.
        rng: Random generator.

    Returns:
        Indices of the queries, ascending.
    """
    # Consecutive queries are close to each other, because a stream sorts anchors by position. The smoothness term
    # of the loss needs such neighbours.
    if count <= size:
        return torch.arange(count)
    run = min(_RUN, size)
    starts = torch.randint(count - run + 1, (max(1, size // run),), generator=rng)
    return (starts[:, None] + torch.arange(run)).flatten().unique()


def save_checkpoint(run: CalibrationRun, path: Path) -> None:
    """Writes the complete state of a calibration to a file.

    Raises:
        OSError: If the file cannot be written.
    """
    tensors = {f"network.{name}": value for name, value in run.network.state_dict().items()}
    tensors |= {f"best.{name}": value for name, value in run.best.items()}
    for index, state in run.optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{index}.{name}": torch.as_tensor(value) for name, value in state.items()}
    tensors["generator"] = run.rng.get_state()
    header = {
        "format": CHECKPOINT_FORMAT,
        "version": CHECKPOINT_VERSION,
        "config": dataclasses.asdict(run.config),
        "fingerprint": scene_fingerprint(run.data.complete),
        "iteration": run.iteration,
        "stale": run.stale,
        "best_errors": run.best_errors,
    }
    write_tensors({name: value.detach().clone().contiguous() for name, value in tensors.items()}, header, path)


def restore_checkpoint(run: CalibrationRun, path: Path) -> None:
    """Restores the state of a calibration from a checkpoint.

    Raises:
        InvalidValueError: If the checkpoint was written for another scene or with other settings.
        BitstreamError: If the checkpoint is absent or damaged.
    """
    arrays, header = read_tensors(path, CHECKPOINT_FORMAT, CHECKPOINT_VERSION)
    tensors = to_tensors(arrays)
    wanted = (dataclasses.asdict(run.config), scene_fingerprint(run.data.complete))
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
            index, key = name.split(".", 1)
            state.setdefault(int(index), {})[key] = value
        run.optimiser.load_state_dict({**run.optimiser.state_dict(), "state": state})
        run.rng.set_state(tensors["generator"])
        run.iteration, run.stale = int(header["iteration"]), int(header["stale"])
        run.best_errors = {str(name): float(value) for name, value in header["best_errors"].items()}
    except MALFORMED as error:
        raise BitstreamError(f"{path}: the checkpoint is damaged: {error}") from error
