"""Trains the scene-free concealer's network for explicit Gaussians on the pictures of some streams, for all others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from splatwire.calibrate.pseudo_loss import pseudo_loss
from splatwire.calibrate.scene_free import Lessons, SceneFreeConfig, train_on
from splatwire.codec import decode_stream
from splatwire.codec.tiers import arrange_stream
from splatwire.conceal.scene_free import ElementNetwork
from splatwire.conceal.scene_free.elements import element_inputs
from splatwire.errors import InvalidValueError
from splatwire.model import Partial, SplatScene
from splatwire.packets import Packet, PacketGroups, SceneStream
from splatwire.scene import Cameras
from splatwire.scene.splats import Splats


@dataclass(frozen=True, eq=False)
class LossyStream:
    """What there is to learn from.

    Attributes:
        stream: A complete stream of explicit Gaussians.
        cameras: Where pictures are compared.
    """

    stream: SceneStream
    cameras: Cameras


def train_for_gaussians(
    streams: Sequence[LossyStream],
    config: SceneFreeConfig,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> ElementNetwork:
    """Trains a network by the error of lossy, concealed pictures against those of the complete streams.

    Losses take whole packets out of the streams, which are then decoded: lost Gaussians are where a receiver expects
    them.

    Args:
        streams: What to learn from.
        config: The run.
        progress: Called after each step with its number and its loss.

    Raises:
        InvalidValueError: If there is no stream, or one holds no explicit Gaussians.
        DivergedError: If the loss is not finite.
    """
    seeds = np.random.SeedSequence(config.seed).spawn(len(streams))
    lessons = [_lessons(lossy, config, seed) for lossy, seed in zip(streams, seeds, strict=True)]
    return train_on(lessons, ElementNetwork(config.hidden, seed=config.seed), config, progress)


def _lessons(lossy: LossyStream, config: SceneFreeConfig, seeds: np.random.SeedSequence) -> Lessons:
    complete = _decoded(lossy.stream)
    groups, packets = _groups(lossy.stream)
    inputs = []
    for rate, seed in zip(config.drop_rates, seeds.generate_state(len(config.drop_rates)).tolist(), strict=True):
        known = pseudo_loss(groups, complete.scene.num_elements, rate, seed).numpy()
        there = tuple(p for p, start in zip(packets, groups.starts[:-1], strict=True) if known[groups.ranks[start]])
        partial = _decoded(SceneStream(lossy.stream.manifest, lossy.stream.side_info, there))
        with torch.no_grad():
            inputs.append(element_inputs(partial))
    return Lessons(complete.scene, lossy.cameras, inputs)


def _decoded(stream: SceneStream) -> Partial[SplatScene]:
    partial = decode_stream(stream)
    if Splats not in partial.offers:
        raise InvalidValueError(f"this network is for explicit Gaussians, not for {partial.scene.ELEMENTS}")
    return partial


def _groups(stream: SceneStream) -> tuple[PacketGroups, list[Packet]]:
    arrangement = arrange_stream(stream)
    packets = [packet for packet in arrangement.packets if packet is not None]
    if len(packets) != stream.manifest.num_packets:
        raise InvalidValueError("a network is trained on complete streams")
    return arrangement.groups, packets
