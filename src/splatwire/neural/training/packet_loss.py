"""Simulated packet loss in training: an iteration drops the anchors of lost packets and conceals the loss.

As in an encoder, anchors are divided into packets. As in a receiver, received anchors are enlarged to cover the gaps.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.bitstream import CAUSAL, HEADER_BYTES, Packetization, PacketPlan, packetization_named
from splatwire.channel import LossModel, parse_loss
from splatwire.channel.transmit import draw_in_order
from splatwire.codec.geometry import anchor_order
from splatwire.codec.tier_sizes import relative_sizes
from splatwire.concealment import Grow
from splatwire.concealment.grow import lost_share_among
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import AnchorCache, MaskedAttributes, SampleBits
from splatwire.neural.training.importance import importance_of, sort_by_importance
from splatwire.neural.training.models import TrainableContextModel
from splatwire.neural.training.state import TrainState, keep_anchors
from splatwire.ops.arrays import to_numpy
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.types import Cameras, HacppConfig
from splatwire.types.anchors import mean_log_size

_GROW = Grow()
_REMOVAL_INTERVAL = 100
"""Number of iterations between removals of anchors without offsets, which packets do not contain."""
_SORT_INTERVAL = 3 * _REMOVAL_INTERVAL
"""Number of iterations between two sortings of the anchors by importance; a sorting renders every training view.

With a single sorting, lego is 0.6 dB worse with half of the bytes received, and 0.5 dB worse with a quarter."""
_MASK_BYTES = 0.8
"""Approximate bytes of an anchor's offset mask, which the rate estimate of the HAC++ model does not include."""


@dataclass(frozen=True, eq=False)
class ReceivedAnchors:
    """Received anchors of one training iteration with simulated packet loss, and their enlargement by the concealer.

    Attributes:
        received: True for received anchors.
        size_gain: Factor on the sizes of each anchor's Gaussians, computed by the concealer `grow`.
    """

    received: Bool[Tensor, "N"]
    size_gain: Float[Tensor, "N"]

    def select_visible(
        self, visible: Int64[Tensor, "M"], visible_attributes: MaskedAttributes
    ) -> tuple[Int64[Tensor, "m"], MaskedAttributes, Float[Tensor, "m"]]:
        """Selects the visible anchors that were received, for rendering.

        Args:
            visible: Indices of the visible anchors.
            visible_attributes: Attributes and offset masks of the visible anchors.

        Returns:
            Indices, attributes and masks of the selected anchors, and the factor by which their Gaussians are enlarged.
        """
        kept = self.received[visible]
        (features, scalings, offsets), masks = visible_attributes
        attributes = features[kept], scalings[kept], offsets[kept]
        return visible[kept], (attributes, masks[kept]), self.size_gain[visible[kept]]


class PacketLossSimulator:
    """Simulates random packet losses during training, and conceals them as a receiver would.

    Args:
        config: The configuration.
        context_model: Predicts the sizes of lost anchors as a receiver does.
        cache: Cache of the anchors' positions.
    """

    def __init__(self, config: TrainConfig, context_model: TrainableContextModel, cache: AnchorCache) -> None:
        self._config, self._context_model, self._cache = config, context_model, cache
        self._loss_models = tuple(parse_loss(text) for text in config.packet_loss.models)
        self._voxels: Tensor | None = None
        self._neighbors = np.empty((0, 0), np.int64)
        self._index_of_rank = torch.empty(0, dtype=torch.int64)  # rank in coding order

    def active(self, state: TrainState) -> bool:
        """True if the current training iteration (`state.iteration`, counted from 1) may simulate packet losses."""
        return bool(self._choices) and state.iteration > self._last_iteration_without_loss

    @property
    def _last_iteration_without_loss(self) -> int:
        """Last iteration before packet losses are simulated."""
        # They are simulated in the fine-tuning only or, without fine-tuning, after the growth. With
        # `PacketLossConfig.received_shares`, they always start after the growth: the order of anchors by
        # importance still changes then. Earlier packet loss reduces the quality of short trainings, measured with and
        # without packet loss (lego, 600 iterations).
        milestones = self._config.milestones
        return (
            milestones.main_iterations
            if milestones.fine_tuning_iterations and not self._config.packet_loss.received_shares
            else milestones.growth_end
        )

    @property
    def _choices(self) -> tuple[LossModel | float, ...]:
        return (*self._loss_models, *self._config.packet_loss.received_shares)

    def before_iteration(self, state: TrainState, cameras: Cameras) -> None:
        """Removes anchors without offsets, as an encoder does; may also sort the anchors by importance.

        The method is called before each iteration, but changes the state only at fixed intervals, to save time. Anchors
        are sorted if only the most important ones are received in some iterations (`PacketLossConfig.received_shares`).

        Args:
            state: State of the training, whose `iteration` is the one that begins; changed in place.
            cameras: The training cameras, in which the importance of anchors is measured.
        """
        num_iterations = state.iteration - self._last_iteration_without_loss
        if not self.active(state) or num_iterations % _REMOVAL_INTERVAL != 1:
            return
        has_offsets = state.masks(self._config.mask_threshold).any(dim=1)
        if bool(has_offsets.any()) and not bool(has_offsets.all()):
            keep_anchors(state, has_offsets)
        if num_iterations % _SORT_INTERVAL == 1 and self._config.packet_loss.received_shares:
            sort_by_importance(state, importance_of(state, self._config, cameras))

    @torch.no_grad()
    def simulate(self, state: TrainState, estimated_bits: SampleBits | None) -> ReceivedAnchors | None:
        """Draws a random packet loss for an iteration.

        Args:
            state: State of the training; its random generator is used.
            estimated_bits: Estimated bits of the anchors, which determine the number of anchors per packet.

        Returns:
            The loss; None if the iteration simulates no packet loss, or if all or no anchors are received.
        """
        if (
            not self.active(state)
            or float(torch.rand((), generator=state.generator)) >= self._config.packet_loss.lossy_share
        ):
            return None
        choice = self._choices[int(torch.randint(len(self._choices), (), generator=state.generator))]
        names = self._config.packet_loss.packetizations
        name = names[int(torch.randint(len(names), (), generator=state.generator))]
        # the schema matters only for the name None, which is not among these names
        packetization = packetization_named(name, CAUSAL, state.num_anchors)
        seed = int(torch.randint(1 << 62, (), generator=state.generator))
        if isinstance(choice, float):
            return self.receive_first(state, choice)
        mask_bytes = _MASK_BYTES if isinstance(self._config.model, HacppConfig) else 0.0
        packet_anchors = _anchors_per_packet(packetization, estimated_bits, mask_bytes)
        return self.lose_packets(state, packetization, choice, seed, packet_anchors)

    @torch.no_grad()
    def receive_first(self, state: TrainState, share: float) -> ReceivedAnchors | None:
        """Simulates that only the most important anchors are received.

        Args:
            state: State of the training, with anchors sorted by importance.
            share: Share of the anchors that are received, 0 to 1.

        Returns:
            Received anchors, and factors by which their Gaussians are enlarged; None if all or no anchors are received.
        """
        self._update_ranks(state)
        # the index of an anchor is its rank by importance
        return self._concealed(state, self._index_of_rank < round(share * state.num_anchors), cut_off=True)

    @torch.no_grad()
    def lose_packets(
        self, state: TrainState, packetization: Packetization, loss_model: LossModel, seed: int, packet_anchors: int
    ) -> ReceivedAnchors | None:
        """Simulates the loss of packets according to a loss model, and conceals it as a receiver would.

        Args:
            state: State of the training.
            packetization: Rule that splits anchors into packets.
            loss_model: The loss model.
            seed: Seed of the loss. With the same seed, `splatwire.channel.draw_mask` loses the same packets, except
                with hashed grouping, whose packets are only estimated here.
            packet_anchors: Estimated number of anchors per packet. Only used with hashed grouping, which fills packets
                up to a size in bytes.

        Returns:
            Received anchors, and factors by which their Gaussians are enlarged; None if all or no anchors are received.
        """
        self._update_ranks(state)
        packet = packet_of_rank(packetization, state.num_anchors, packet_anchors)
        is_packet_received, _ = draw_in_order(np.ones(int(packet.max()) + 1, np.int64), loss_model, seed)
        return self._concealed(state, torch.from_numpy(is_packet_received[packet]).to(state.device))

    def _concealed(
        self, state: TrainState, received_by_rank: Bool[Tensor, "N"], *, cut_off: bool = False
    ) -> ReceivedAnchors | None:
        """Computes by how much the concealer `grow` enlarges the Gaussians of each received anchor.

        Args:
            state: State of the training.
            received_by_rank: True for received anchors, in coding order.
            cut_off: True if reception ended after the first importance tier (most important anchors).

        Returns:
            The received anchors and the factors on their sizes; None if all or no anchors are received.
        """
        if bool(received_by_rank.all()) or not bool(received_by_rank.any()):
            return None
        received = torch.empty_like(received_by_rank)
        received[self._index_of_rank] = received_by_rank
        gain_by_rank = torch.ones(state.num_anchors, device=state.device)
        if self._neighbors.shape[1]:
            is_received = to_numpy(received_by_rank)
            tier_sizes = self._tier_sizes(state, received_by_rank) if cut_off else None
            size = tier_sizes
            if size is None:
                size = np.exp(
                    mean_log_size(self._context_model.expected_scalings(state, self._index_of_rank)).astype(np.float64)
                )
            lost_share = lost_share_among(self._neighbors[is_received], size * ~is_received, size).astype(np.float32)
            gain = torch.from_numpy(_GROW.gain(1 - lost_share, is_received, tier_sizes))
            gain_by_rank[received_by_rank] = gain.to(gain_by_rank)
        size_gain = torch.empty_like(gain_by_rank)
        size_gain[self._index_of_rank] = gain_by_rank
        return ReceivedAnchors(received, size_gain)

    def _tier_sizes(self, state: TrainState, received_by_rank: Bool[Tensor, "N"]) -> Float[np.ndarray, "N"]:
        """Returns a size for each anchor: one typical size for all received anchors, and another for all lost anchors.

        A receiver does not know the size of a single lost anchor, only the typical size of each importance tier. Here,
        the received anchors are one tier, and the lost anchors the other.

        Args:
            state: State of the training.
            received_by_rank: True for received anchors, in coding order.

        Returns:
            One size for each anchor in coding order, relative to the larger of the two typical sizes, above 0 and at
            most 1.
        """
        tiers = (~received_by_rank).long().cpu().numpy()
        base_sizes = state.scalings()[self._index_of_rank, 3:6].cpu().numpy()
        gaussians = state.masks(self._config.mask_threshold)[self._index_of_rank].sum(dim=1).cpu().numpy()
        return relative_sizes(base_sizes, gaussians, tiers, 2)[tiers]

    def _update_ranks(self, state: TrainState) -> None:
        """Recomputes the coding order and nearest neighbours after anchors were added, removed or sorted."""
        if self._voxels is state.voxels:
            return
        order = anchor_order(state.voxels.cpu().numpy(), "morton")
        self._index_of_rank = torch.from_numpy(order).to(state.device)
        positions = self._cache.positions(state)[self._index_of_rank]
        all_rows = np.arange(state.num_anchors)
        self._neighbors, _ = nearest_others(NeighborTree(positions), positions, all_rows, _GROW.neighbors)
        self._voxels = state.voxels


def packet_of_rank(packetization: Packetization, num_anchors: int, packet_anchors: int) -> np.ndarray:
    """Returns the index of the packet that contains each anchor.

    Args:
        packetization: Rule that splits anchors into packets.
        num_anchors: Number of anchors, N.
        packet_anchors: Estimated number of anchors per packet. Only used with hashed grouping, which fills packets up
            to a size in bytes.

    Returns:
        Entry i is the index, in sending order, of the packet with the i-th anchor in coding order, int64 (N).
    """
    # Consecutive packets contain different parts of the scene.
    plan = PacketPlan(packetization, num_anchors)
    if packetization.hashed:
        indices, starts = plan.all_members()
        sizes = np.diff(starts)
        position = np.arange(num_anchors) - np.repeat(starts[:-1], sizes)
        key = np.empty(num_anchors, np.int64)
        key[indices] = position // packet_anchors * plan.num_blocks + np.repeat(np.arange(len(sizes)), sizes)
    else:
        block, index_in_block = np.divmod(plan.packet_index_of().astype(np.int64), packetization.lanes)
        key = index_in_block * plan.num_blocks + block
    return np.unique(key, return_inverse=True)[1]


def _anchors_per_packet(packetization: Packetization, estimated_bits: SampleBits | None, mask_bytes: float) -> int:
    """Estimates how many anchors a packet contains, from the estimated bits per anchor.

    The result is 1 if there is no estimate of the bits. It is also 1 without hashed grouping. Only hashed grouping
    fills packets up to a size in bytes, and needs the number.

    Args:
        packetization: Rule that splits anchors into packets.
        estimated_bits: Estimated bits of a sample of anchors.
        mask_bytes: Bytes of an anchor's offset mask, if `estimated_bits` excludes the masks; otherwise 0.
    """
    if estimated_bits is None or not packetization.hashed:
        return 1
    anchor_bytes = float(estimated_bits.bits.detach()) / 8 / max(estimated_bits.num_anchors, 1) + mask_bytes
    return max(1, round((packetization.packet_bytes - HEADER_BYTES) / anchor_bytes))
