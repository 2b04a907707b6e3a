"""What the network will lose, in training: anchors leave an iteration packet by packet, and what stays is concealed.

Packets are those of the stream that the anchors would be encoded into at that moment, their fate is drawn by the
channel's own models, and received anchors grow over the gaps as at a receiver (`grow`).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.channel import LossModel, parse_loss
from splatwire.channel.transmit import draw_in_order
from splatwire.codec.geometry import anchor_order
from splatwire.codec.tier_sizes import relative_sizes
from splatwire.conceal import Grow
from splatwire.conceal.grow import lost_share_among
from splatwire.ops.arrays import to_numpy
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.packets import CAUSAL, HEADER_BYTES, Packetization, PacketPlan, packetization_named
from splatwire.scene import Cameras
from splatwire.scene.anchors import mean_log_size
from splatwire.train.config import TrainConfig
from splatwire.train.context import AnchorCache, SampleRate, Seen
from splatwire.train.importance import importance_of, order_anchors
from splatwire.train.models import TrainedModel
from splatwire.train.state import TrainState, keep_anchors

_GROW = Grow()
_TIDY_INTERVAL = 100
"""Iterations between removals of anchors that draw nothing: a stream does not have them, nor has its plan."""
_SORT_INTERVAL = 3 * _TIDY_INTERVAL
"""Iterations between sortings by importance, which learns where it is in the order: sorted once, lego is 0.6 dB worse
where half of the bytes came and 0.5 where a quarter did. Each takes a picture of every training view."""
_MASK_BYTES = 0.8
"""About what the mask of an anchor takes; the rate estimate leaves masks out."""


@dataclass(frozen=True, eq=False)
class Loss:
    """What an iteration loses, concealed by `grow`: lost anchors are left out, received ones grow.

    Attributes:
        known: True for anchors that arrived.
        size_gain: How much larger each of them is drawn, 1 for lost anchors.
    """

    known: Bool[Tensor, "N"]
    size_gain: Float[Tensor, "N"]

    def drawn(self, visible: Int64[Tensor, "M"], seen: Seen) -> tuple[Int64[Tensor, "m"], Seen, Float[Tensor, "m"]]:
        """Returns those of the visible anchors that are drawn, how they are seen, and gains on their sizes."""
        kept = self.known[visible]
        (features, scalings, offsets), masks = seen
        left = features[kept], scalings[kept], offsets[kept]
        return visible[kept], (left, masks[kept]), self.size_gain[visible[kept]]


class PacketLosses:
    """Draws the losses of a run's iterations.

    Args:
        config: The recipe.
        model: What says how large anchors are expected to be.
        cache: Where the anchors are.
    """

    def __init__(self, config: TrainConfig, model: TrainedModel, cache: AnchorCache) -> None:
        self._config, self._model, self._cache = config, model, cache
        self._models = tuple(parse_loss(text) for text in config.losses.models)
        self._voxels: Tensor | None = None
        self._neighbors = np.empty((0, 0), np.int64)
        self._order = torch.empty(0, dtype=torch.int64)

    def active(self, state: TrainState) -> bool:
        """Whether this iteration may lose packets."""
        return bool(self._choices) and state.iteration > self._start

    @property
    def _start(self) -> int:
        """The iteration before the first lossy one: a finished scene's last, or once the number of anchors stays.

        Losses before leave short runs with a worse picture, complete and lossy (lego, 600 iterations). What arrives
        first has to be learnt all the same: which anchors matter is sorted while that still changes much.
        """
        marks = self._config.marks
        return marks.settled if marks.tuning and not self._config.losses.first else marks.growth_end

    @property
    def _choices(self) -> tuple[LossModel | float, ...]:
        return (*self._models, *self._config.losses.first)

    def begin(self, state: TrainState, cameras: Cameras) -> None:
        """Gets anchors ready before the first lossy iteration, and removes those that draw nothing now and then.

        Args:
            state: Changed in place.
            cameras: The training cameras, which say what is important.
        """
        since = state.iteration - self._start
        if not self.active(state) or since % _TIDY_INTERVAL != 1:
            return
        alive = state.masks(self._config.mask_threshold).any(dim=1)
        if bool(alive.any()) and not bool(alive.all()):
            keep_anchors(state, alive)
        if since % _SORT_INTERVAL == 1 and self._config.losses.first:
            order_anchors(state, importance_of(state, self._config, cameras))

    @torch.no_grad()
    def draw(self, state: TrainState, rate: SampleRate | None) -> Loss | None:
        """Draws what an iteration loses; None where it loses nothing.

        Args:
            state: The state; its generator decides.
            rate: What anchors cost, which says how many of them a datagram holds.
        """
        if not self.active(state) or float(torch.rand((), generator=state.generator)) >= self._config.losses.share:
            return None
        choice = self._choices[int(torch.randint(len(self._choices), (), generator=state.generator))]
        names = self._config.losses.packets
        name = names[int(torch.randint(len(names), (), generator=state.generator))]
        packetization = packetization_named(name, CAUSAL, state.num_anchors)
        seed = int(torch.randint(1 << 62, (), generator=state.generator))
        if isinstance(choice, float):
            return self.keep_first(state, choice)
        return self.lose(state, packetization, choice, seed, _anchors_of(packetization, rate))

    @torch.no_grad()
    def keep_first(self, state: TrainState, share: float) -> Loss | None:
        """Lets the first rows of the state arrive, the most important share of the anchors, and conceals the rest."""
        self._arrange(state)
        return self._concealed(state, self._order < round(share * state.num_anchors), cut_off=True)

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
        return self._concealed(state, torch.from_numpy(received[packet]).to(state.device))

    def _concealed(self, state: TrainState, known: Bool[Tensor, "N"], *, cut_off: bool = False) -> Loss | None:
        """What arrived, by rank, with what the concealer makes of it, by row."""
        if bool(known.all()) or not bool(known.any()):
            return None
        arrived = torch.empty_like(known)
        arrived[self._order] = known
        gain = torch.ones(state.num_anchors, device=state.device)
        if self._neighbors.shape[1]:
            received = to_numpy(known)
            tier_sizes = self._tier_sizes(state, known) if cut_off else None
            size = tier_sizes
            if size is None:
                size = np.exp(mean_log_size(self._model.expected_scalings(state, self._order)).astype(np.float64))
            share = lost_share_among(self._neighbors[received], size * ~received, size).astype(np.float32)
            gain[known] = torch.from_numpy(_GROW.gain(1 - share, received, tier_sizes)).to(gain)
        gain_of = torch.empty_like(gain)
        gain_of[self._order] = gain
        return Loss(arrived, gain_of)

    def _tier_sizes(self, state: TrainState, known: Bool[Tensor, "N"]) -> Float[np.ndarray, "N"]:
        """Sizes by rank of two tiers, what arrived and what did not, as a stream that is cut off between them says."""
        tiers = (~known).long().cpu().numpy()
        sizes = state.scalings()[self._order, 3:6].cpu().numpy()
        gaussians = state.masks(self._config.mask_threshold)[self._order].sum(dim=1).cpu().numpy()
        return relative_sizes(sizes, gaussians, tiers, 2)[tiers]

    def _arrange(self, state: TrainState) -> None:
        """The anchors by rank, and the neighbours of each rank; computed again only when the anchors change."""
        if self._voxels is state.voxels:
            return
        order = anchor_order(state.voxels.cpu().numpy(), "morton")
        self._order = torch.from_numpy(order).to(state.device)
        positions = self._cache.positions(state)[self._order]
        own = np.arange(state.num_anchors)
        self._neighbors, _ = nearest_others(NeighborTree(positions), positions, own, _GROW.neighbors)
        self._voxels = state.voxels


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
