"""Trains the networks of the scene-free concealer on the pictures of some scenes, for use on all others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.anchors.appearance import spawned_gaussians
from splatwire.bitstream import Packet, PacketMembers, SceneStream
from splatwire.calibration.checks import check_settings
from splatwire.calibration.pseudo_loss import CalibrationData, pseudo_loss
from splatwire.codec import decode_stream
from splatwire.codec.tiers import assign_stream_packets
from splatwire.concealment.scene_free import AnchorNetwork
from splatwire.concealment.scene_free.elements import (
    BASE,
    OPACITIES,
    POWERS,
    SIZES,
    GaussianInputs,
    GaussianNetwork,
    gaussian_inputs,
)
from splatwire.concealment.scene_free.network import HIDDEN, MAX_CHANGE, MAX_STANDARDISED, AnchorInputs, anchor_inputs
from splatwire.concealment.scene_free.surroundings import surroundings_of
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.neural.model.gaussian_heads import SpawnedGaussians
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.render.differentiable import render_differentiable
from splatwire.neural.training.schedule import half_cosine
from splatwire.ops.arrays import to_arrays
from splatwire.types import Cameras, Gaussians, ReceivedScene, SplatScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

Network = TypeVar("Network", AnchorNetwork, GaussianNetwork)


@dataclass(frozen=True)
class SceneFreeConfig:
    """A training run.

    Attributes:
        steps: Steps of Adam; one picture of one loss of one scene each, the scenes in turn.
        learning_rate: At the start; falls to 0 along a cosine.
        drop_rates: Share of the packets that each pseudo-loss drops; as many losses per scene.
        hidden: Width of the networks.
        floor: Added to the squared error of a picture before the logarithm: about the error of a lossless render
            against a photo, below which an error does not show.
        seed: Seed of everything random.
    """

    steps: int = 240
    learning_rate: float = 3e-3
    drop_rates: tuple[float, ...] = (0.2, 0.2, 0.2, 0.1, 0.4)
    hidden: int = HIDDEN
    floor: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        rates = bool(self.drop_rates) and all(0 < rate < 1 for rate in self.drop_rates)
        check_settings(self, "a training", ("hidden",), steps=self.steps >= 0, drop_rates=rates)


def train_scene_free(
    scenes: Sequence[CalibrationData],
    config: SceneFreeConfig,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> AnchorNetwork:
    """Trains a network by the error of lossy, concealed pictures against lossless ones.

    The loss of a picture is `log(mean squared error + floor)`: each decibel weighs the same in every scene and view.

    Args:
        scenes: Training scenes, with the cameras at the size of the compared pictures.
        config: The run.
        progress: Called after each step with its number and its loss.

    Returns:
        The network after the last step.

    Raises:
        InvalidValueError: If there is no scene, or one has no cameras.
        DivergedError: If the loss is not finite.
    """
    seeds = np.random.SeedSequence(config.seed).spawn(len(scenes))
    examples = [_lessons(scene, config, seed) for scene, seed in zip(scenes, seeds, strict=True)]
    return train_on(examples, AnchorNetwork.untrained(config.hidden, seed=config.seed), config, progress)


def _lessons(data: CalibrationData, config: SceneFreeConfig, seeds: np.random.SeedSequence) -> "TrainingExamples":
    if data.cameras is None:
        raise InvalidValueError("a concealer cannot be trained on a scene without cameras")
    around = surroundings_of(data.complete, np.arange(data.scene.anchors.num_anchors))
    inputs = [
        anchor_inputs(data.complete.masked(known), around.select(known))
        for known in data.pseudo_losses(config.drop_rates, seeds)
    ]
    return TrainingExamples(data.scene, data.cameras, inputs)


def train_on(
    examples: Sequence["TrainingExamples"],
    network: Network,
    config: SceneFreeConfig,
    progress: Callable[[int, float], None] | None = None,
) -> Network:
    """Trains a network on the simulated losses of some scenes; see `train_scene_free`.

    Raises:
        InvalidValueError: If there is no scene.
        DivergedError: If the loss is not finite.
    """
    if not examples:
        raise InvalidValueError("a concealer cannot be trained on no scene")
    signature = np.concatenate([inputs.signature for lesson in examples for inputs in lesson.inputs])
    spread = np.maximum(signature.std(axis=0), 1e-3)
    network = to_tensors(replace(network, mean=signature.mean(axis=0), spread=spread))
    weights = [part.requires_grad_() for layer in (network.hidden, network.output) for part in vars(layer).values()]
    optimiser = torch.optim.Adam(weights, lr=config.learning_rate, betas=(0.95, 0.99))
    rng = torch.Generator().manual_seed(config.seed)
    for step in range(config.steps):
        lesson = examples[step % len(examples)]
        error = lesson.error(network, rng)
        loss = (error + config.floor).log()
        if not bool(loss.isfinite()):
            raise DivergedError(step + 1)
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * half_cosine(step / config.steps)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 1.0)
        optimiser.step()
        if progress is not None:
            progress(step + 1, float(loss.detach()))
    return to_arrays(network)


def tensor_gains(
    network: AnchorNetwork | GaussianNetwork, inputs: AnchorInputs | GaussianInputs
) -> tuple[Float[Tensor, "M"], Float[Tensor, "M"]]:
    """Gains of size and opacity that a network of tensors computes, differentiable in its weights.

    The networks of the package compute the same in numpy.
    """
    signature = torch.from_numpy(inputs.signature)
    x = ((signature - network.mean) / network.spread).clamp(-MAX_STANDARDISED, MAX_STANDARDISED)
    hidden = torch.nn.functional.silu(torch.nn.functional.linear(x, network.hidden.weight, network.hidden.bias))
    change = torch.nn.functional.linear(hidden, network.output.weight, network.output.bias)
    if isinstance(inputs, AnchorInputs):
        change = change.clamp(-MAX_CHANGE, MAX_CHANGE)
        return torch.from_numpy(inputs.grown) * change[:, 0].exp(), change[:, 1].exp()
    lost = torch.from_numpy(inputs.lost)
    power = torch.exp(lost * (BASE[1] + change[:, 1]).clamp(*POWERS))
    opacity = torch.from_numpy(inputs.opacity).clamp(*OPACITIES)
    return torch.exp(lost * (BASE[0] + change[:, 0]).clamp(*SIZES)), -torch.expm1(
        power * torch.log1p(-opacity)
    ) / opacity


class TrainingExamples:
    """Simulated losses and views of one scene, with everything that is constant during the training.

    Args:
        scene: The complete scene.
        cameras: Cameras of the compared pictures.
        inputs: Inputs of the network for each loss.
    """

    def __init__(
        self, scene: Scene, cameras: Cameras, inputs: Sequence[AnchorInputs] | Sequence[GaussianInputs]
    ) -> None:
        self._scene, self._cameras, self.inputs = scene, cameras, inputs
        self._views: dict[int, tuple[SpawnedGaussians, Tensor]] = {}
        self._order: list[tuple[int, int]] = []

    def error(self, network: AnchorNetwork | GaussianNetwork, rng: torch.Generator) -> Float[Tensor, ""]:
        """Mean squared error of the next picture; every loss is combined with every view before any repeats."""
        if not self._order:
            pairs = [(loss, view) for loss in range(len(self.inputs)) for view in range(self._cameras.num_views)]
            self._order = [pairs[index] for index in torch.randperm(len(pairs), generator=rng).tolist()]
        loss, view = self._order.pop()
        inputs = self.inputs[loss]
        spawned, reference = self._lossless(view)
        place = torch.full((self._scene.num_elements,), -1)
        place[torch.from_numpy(inputs.rows)] = torch.arange(len(inputs.rows))
        place = place[spawned.anchor_index]
        arrived = place >= 0
        size, opacity = (gain.index_select(0, place[arrived]) for gain in tensor_gains(network, inputs))
        drawn = _with_gains(_rows(spawned.gaussians, arrived), size, opacity)
        return ((self._draw(drawn, view) - reference) ** 2).mean()

    @torch.no_grad()
    def _lossless(self, view: int) -> tuple[SpawnedGaussians, Tensor]:
        if view not in self._views:
            spawned = to_tensors(spawned_gaussians(self._scene, self._cameras, view))
            self._views[view] = spawned, self._draw(spawned.gaussians, view)
        return self._views[view]

    def _draw(self, gaussians: Gaussians, view: int) -> Float[Tensor, "H W 3"]:
        behind = torch.tensor(self._scene.background)
        return render_differentiable(gaussians, self._cameras.select([view]), background=behind)[0]


def _rows(g: Gaussians, rows: Tensor) -> Gaussians:
    return Gaussians(g.means[rows], g.quats[rows], g.scales[rows], g.opacities[rows], g.colors[rows])


def _with_gains(g: Gaussians, size: Float[Tensor, "G"], opacity: Float[Tensor, "G"]) -> Gaussians:
    return replace(g, scales=g.scales * size[:, None], opacities=(g.opacities * opacity).clamp(max=1))


@dataclass(frozen=True, eq=False)
class LossyStream:
    """A stream and cameras for training examples."""

    stream: SceneStream
    cameras: Cameras


def train_for_gaussians(
    streams: Sequence[LossyStream],
    config: SceneFreeConfig,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> GaussianNetwork:
    """Trains a network by the error of lossy, concealed pictures against those of the complete streams.

    Complete packets are removed from the streams, and the rest is decoded, so lost Gaussians are where a receiver
    expects them.

    Args:
        streams: Training streams.
        config: The run.
        progress: Called after each step with its number and its loss.

    Raises:
        InvalidValueError: If there is no stream, or one has no explicit Gaussians.
        DivergedError: If the loss is not finite.
    """
    seeds = np.random.SeedSequence(config.seed).spawn(len(streams))
    examples = [_lossy_lessons(lossy, config, seed) for lossy, seed in zip(streams, seeds, strict=True)]
    return train_on(examples, GaussianNetwork.untrained(config.hidden, seed=config.seed), config, progress)


def _lossy_lessons(lossy: LossyStream, config: SceneFreeConfig, seeds: np.random.SeedSequence) -> TrainingExamples:
    complete = _decoded(lossy.stream)
    members, packets = _members(lossy.stream)
    inputs = []
    for rate, seed in zip(config.drop_rates, seeds.generate_state(len(config.drop_rates)).tolist(), strict=True):
        known = pseudo_loss(members, complete.scene.num_elements, rate, seed)
        there = tuple(p for p, start in zip(packets, members.starts[:-1], strict=True) if known[members.indices[start]])
        received = _decoded(SceneStream(lossy.stream.manifest, lossy.stream.side_info, there))
        inputs.append(gaussian_inputs(received))
    return TrainingExamples(complete.scene, lossy.cameras, inputs)


def _decoded(stream: SceneStream) -> ReceivedScene[SplatScene]:
    received = decode_stream(stream)
    if Splats not in received.provides:
        raise InvalidValueError(f"this network is for explicit Gaussians, not for {received.scene.ELEMENTS}")
    return received


def _members(stream: SceneStream) -> tuple[PacketMembers, list[Packet]]:
    assignment = assign_stream_packets(stream)
    packets = [packet for packet in assignment.packets if packet is not None]
    if len(packets) != stream.manifest.num_packets:
        raise InvalidValueError("a network is trained on complete streams")
    return assignment.members, packets
