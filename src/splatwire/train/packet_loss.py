"""What the network will lose, in training: anchors leave an iteration packet by packet, and what stays is concealed.

Packets are those of the stream that the anchors would be encoded into at that moment, their fate is drawn by the
channel's own models, and received anchors grow exactly as the concealer `grow` has them grow at a receiver.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.channel import LossModel, parse_loss
from splatwire.channel.transmit import draw_in_order
from splatwire.codec.geometry import anchor_order
from splatwire.conceal import Grow
from splatwire.conceal.context import mean_log_size
from splatwire.conceal.grow import lost_share_among
from splatwire.model import Linear, Mlp
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.packets import HEADER_BYTES, PRESETS, Packetization, PacketPlan
from splatwire.train.config import TrainConfig
from splatwire.train.context import AnchorCache, SampleRate, Steps, grid_features
from splatwire.train.kernels import Kernels
from splatwire.train.state import TrainState, keep_anchors

_GROW = Grow()
_TIDY_INTERVAL = 100
"""Iterations between removals of anchors that draw nothing: a stream does not have them, nor has its plan."""
_MASK_BYTES = 0.8
"""About what the mask of an anchor takes; the rate estimate leaves masks out."""


@dataclass(frozen=True, eq=False)
class Loss:
    """What an iteration lost.

    Attributes:
        known: True for anchors that arrived.
        size_gain: How much larger the concealer draws each of them, 1 for lost anchors.
    """

    known: Bool[Tensor, "N"]
    size_gain: Float[Tensor, "N"]

    def arrived(
        self, visible: Int64[Tensor, "M"], steps: Steps | None
    ) -> tuple[Int64[Tensor, "m"], Steps | None, Float[Tensor, "m"]]:
        """Returns those of the visible anchors that arrived, their quantisation steps and their gains."""
        kept = self.known[visible]
        if steps is not None:
            steps = [step[kept] if isinstance(step, Tensor) else step for step in steps]
        return visible[kept], steps, self.size_gain[visible[kept]]


class PacketLosses:
    """Draws the losses of a run's iterations.

    Args:
        config: The recipe.
        kernels: What does the heavy parts.
        cache: Where the anchors are.
    """

    def __init__(self, config: TrainConfig, kernels: Kernels, cache: AnchorCache) -> None:
        self._config, self._kernels, self._cache = config, kernels, cache
        self._models = tuple(parse_loss(text) for text in config.losses.models)
        self._voxels: Tensor | None = None
        self._neighbors = torch.empty(0, 0, dtype=torch.int64)
        self._order = torch.empty(0, dtype=torch.int64)

    def active(self, state: TrainState) -> bool:
        """Whether this iteration may lose packets: once the number of anchors stays."""
        return bool(self._models) and state.iteration > self._config.marks.growth_end

    def begin(self, state: TrainState) -> None:
        """Removes anchors that draw nothing, now and then."""
        if self.active(state) and (state.iteration - self._config.marks.growth_end) % _TIDY_INTERVAL == 1:
            alive = state.masks(self._config.mask_threshold).any(dim=1)
            if bool(alive.any()) and not bool(alive.all()):
                keep_anchors(state, alive)

    @torch.no_grad()
    def draw(self, state: TrainState, rate: SampleRate | None) -> Loss | None:
        """Draws what an iteration loses; None where it loses nothing.

        Args:
            state: The state; its generator decides.
            rate: What anchors cost, which says how many of them a datagram holds.
        """
        if not self.active(state) or float(torch.rand((), generator=state.generator)) >= self._config.losses.share:
            return None
        model = self._models[int(torch.randint(len(self._models), (), generator=state.generator))]
        names = self._config.losses.packets
        packetization = PRESETS[names[int(torch.randint(len(names), (), generator=state.generator))]]
        seed = int(torch.randint(1 << 62, (), generator=state.generator))
        return self.lose(state, packetization, model, seed, _anchors_of(packetization, rate))

    @torch.no_grad()
    def lose(
        self, state: TrainState, packetization: Packetization, model: LossModel, seed: int, packet_anchors: int
    ) -> Loss | None:
        """Draws which anchors of a stream arrive, and what the concealer makes of them; None where all or none do.

        Args:
            state: The state.
            packetization: How anchors are split.
            model: Which packets are lost.
            seed: As of `splatwire.channel.draw_mask`, which loses the same packets.
            packet_anchors: As for `packet_of_rank`.
        """
        self._arrange(state)
        packet = packet_of_rank(packetization, state.num_anchors, packet_anchors)
        received, _ = draw_in_order(np.ones(int(packet.max()) + 1, np.int64), model, seed)
        if received.all() or not received.any():
            return None
        known = torch.from_numpy(received[packet]).to(state.device)  # by rank, as neighbours and sizes are
        gain = torch.ones(state.num_anchors, device=state.device)
        if self._neighbors.shape[1]:
            size = mean_log_size(self._predicted_scalings(state)).double().exp()
            share = lost_share_among(self._neighbors[known], size * ~known, size)
            gain[known] = _GROW.gain(1 - share.float(), known)
        arrived, gain_of = torch.empty_like(known), torch.empty_like(gain)
        arrived[self._order], gain_of[self._order] = known, gain
        return Loss(arrived, gain_of)

    def _arrange(self, state: TrainState) -> None:
        """The anchors by rank, and the neighbours of each rank; computed again only when the anchors change."""
        if self._voxels is state.voxels:
            return
        order = anchor_order(state.voxels.cpu().numpy(), "morton")
        self._order = torch.from_numpy(order).to(state.device)
        positions = self._cache.positions(state)[self._order]
        own = torch.arange(state.num_anchors, device=state.device)
        self._neighbors, _ = nearest_others(NeighborTree(positions), positions, own, _GROW.neighbors)
        self._voxels = state.voxels

    def _predicted_scalings(self, state: TrainState) -> Float[Tensor, "N 6"]:
        """The scalings that the hash grid predicts, by rank: all that a receiver knows of the size of what is lost."""
        prior, start = state.networks.prior, 3 * self._config.model.layout.feature_dim
        columns = slice(start, start + 6)
        means = Mlp(
            prior.hidden, Linear(prior.output.weight[columns], prior.output.bias[columns]), prior.negative_slope
        )
        return means(grid_features(state, self._cache, self._order, self._kernels))


def packet_of_rank(packetization: Packetization, num_anchors: int, packet_anchors: int) -> np.ndarray:
    """Returns the packet of each anchor, packets numbered in the order in which they are sent (interleaved).

    Args:
        packetization: How anchors are split.
        num_anchors: Anchors, N.
        packet_anchors: With hashed grouping, where only a coder knows what fits, anchors of a packet.

    Returns:
        int64 (N), by rank.
    """
    plan = PacketPlan(packetization, num_anchors)
    if packetization.hashed:
        ranks, starts = plan.groups()
        sizes = np.diff(starts)
        position = np.arange(num_anchors) - np.repeat(starts[:-1], sizes)
        key = np.empty(num_anchors, np.int64)
        key[ranks] = position // packet_anchors * plan.num_blocks + np.repeat(np.arange(len(sizes)), sizes)
    else:
        block, lane = np.divmod(plan.packet_index_of().astype(np.int64), packetization.lanes)
        key = lane * plan.num_blocks + block
    return np.unique(key, return_inverse=True)[1]


def _anchors_of(packetization: Packetization, rate: SampleRate | None) -> int:
    """About how many anchors a packet of hashed grouping holds, at the bits that they take now."""
    if rate is None or not packetization.hashed:
        return 1
    anchor_bytes = float(rate.bits.detach()) / 8 / max(rate.num_anchors, 1) + _MASK_BYTES
    return max(1, round((packetization.packet_bytes - HEADER_BYTES) / anchor_bytes))
