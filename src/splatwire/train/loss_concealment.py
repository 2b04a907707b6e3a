"""What is drawn where packets are lost in training: concealers as at a receiver, differentiable in what arrived."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.conceal import Idw, MaskVote
from splatwire.conceal.fill import weighted_mean, weighted_mean_of_existing
from splatwire.conceal.idw import inverse_distance_weights
from splatwire.scene import Anchors
from splatwire.train.context import Seen
from splatwire.train.state import TrainState

_IDW, _VOTE = Idw(), MaskVote()


@dataclass(frozen=True, eq=False)
class Grown:
    """Lost anchors are left out, received ones grow: the concealer `grow`.

    Attributes:
        known: True for anchors that arrived.
        size_gain: How much larger each of them is drawn, 1 for lost anchors.
    """

    known: Bool[Tensor, "N"]
    size_gain: Float[Tensor, "N"]

    def drawn(
        self, visible: Int64[Tensor, "M"], seen: Seen
    ) -> tuple[Int64[Tensor, "m"], Seen, Float[Tensor, "m"] | None]:
        """Returns those of the visible anchors that are drawn, how they are seen, and gains on their sizes."""
        kept = self.known[visible]
        (features, scalings, offsets), masks = seen
        left = features[kept], scalings[kept], offsets[kept]
        return visible[kept], (left, masks[kept]), self.size_gain[visible[kept]]

    def filled(
        self,
        state: TrainState,
        visible: Int64[Tensor, "m"],
        anchors: Anchors,
        weight: Float[Tensor, "m K"],
        threshold: float,
    ) -> tuple[Anchors, Float[Tensor, "m K"]]:
        """Returns the drawn anchors and the weights of their offsets as they are: nothing is filled."""
        return anchors, weight


@dataclass(frozen=True, eq=False)
class Filled:
    """Lost anchors are drawn with the mean of those around them: the concealer `idw`.

    Attributes:
        known: True for anchors that arrived.
        neighbors: Rows of the nearest others of each anchor, nearest first.
        positions: World coordinates.
    """

    known: Bool[Tensor, "N"]
    neighbors: Int64[Tensor, "N k"]
    positions: Float[Tensor, "N 3"]

    def drawn(
        self, visible: Int64[Tensor, "M"], seen: Seen
    ) -> tuple[Int64[Tensor, "m"], Seen, Float[Tensor, "m"] | None]:
        """Returns all visible anchors as they are seen, without gains."""
        return visible, seen, None

    def filled(
        self,
        state: TrainState,
        visible: Int64[Tensor, "m"],
        anchors: Anchors,
        weight: Float[Tensor, "m K"],
        threshold: float,
    ) -> tuple[Anchors, Float[Tensor, "m K"]]:
        """Replaces what was lost; an anchor none of whose neighbours arrived is left out.

        Args:
            state: The state.
            visible: Rows of the drawn anchors.
            anchors: The drawn anchors.
            weight: Straight-through masks of their offsets.
            threshold: `TrainConfig.mask_threshold`.

        Returns:
            Anchors and weights.
        """
        place = (~self.known[visible]).nonzero()[:, 0]
        index, share = self.received_around(visible[place])
        exists, supported = state.masks(threshold), share.sum(dim=1) > 0
        offsets = (state.parameters["offsets"] * exists[:, :, None]).flatten(1)
        offset, votes = weighted_mean_of_existing(offsets, exists, index, share)
        mask = _VOTE(votes, supported) & supported[:, None]
        shown = replace(
            anchors,
            features=anchors.features.index_copy(0, place, weighted_mean(state.parameters["features"], index, share)),
            scalings=anchors.scalings.index_copy(0, place, weighted_mean(state.scalings(), index, share)),
            offsets=anchors.offsets.index_copy(
                0, place, offset.view(-1, *anchors.offsets.shape[1:]) * mask[:, :, None]
            ),
            mask=anchors.mask.index_copy(0, place, mask),
        )
        return shown, weight.index_copy(0, place, mask.to(weight))

    def received_around(self, rows: Int64[Tensor, "m"]) -> tuple[Int64[Tensor, "m j"], Float[Tensor, "m j"]]:
        """Finds the nearest neighbours that arrived of some anchors, and their weights, which add up to 1 or are 0."""
        around = self.neighbors[rows]
        arrived = self.known[around]
        places = torch.arange(around.shape[1], device=rows.device).expand_as(around)
        nearest = torch.where(arrived, places, around.shape[1]).sort(dim=1).values[:, : _IDW.neighbors]
        there = nearest < around.shape[1]
        index = around.gather(1, nearest.clamp(max=max(around.shape[1] - 1, 0)))
        distance = torch.linalg.vector_norm(self.positions[index] - self.positions[rows][:, None], dim=2)
        far = torch.where(there, distance, torch.inf)
        return index, torch.where(there, inverse_distance_weights(far, _IDW.power), 0.0)


Loss = Grown | Filled
"""What an iteration lost, and what is drawn instead."""
