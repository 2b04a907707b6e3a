"""Concealment that keeps up with a transfer: only what an arrival changes is computed again."""

import dataclasses
from contextlib import nullcontext

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from splatwire.conceal.base import Concealer, create_concealer
from splatwire.conceal.conceal import conceal
from splatwire.conceal.context import AnchorContext, context_of
from splatwire.conceal.drop import Drop
from splatwire.conceal.fill import MaskVote
from splatwire.conceal.grow import Grow
from splatwire.conceal.idw import Idw, PriorMean, fill_from_neighbors, inverse_distance_weights
from splatwire.model import AnchorScene, PartialScene, RenderHints
from splatwire.model.appearance import Partial, Scene
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.ops.threads import one_torch_thread
from splatwire.scene import Attribute

_CHUNK = 1 << 14
_FEW = 1 << 12
"""Arrivals up to which threads cost more to wake than they save."""


class ProgressiveConcealer:
    """A concealed scene that is brought up to date as anchors arrive.

    For `drop`, `grow`, `idw` (Euclidean) and `prior` the scene at every moment is the one that `conceal` makes from
    scratch of what is there: attributes bit for bit, size gains to one part in a million. (Where more than four
    received anchors are at exactly the distance of the last neighbour, either search may prefer others of them.) Other
    concealers look further than at neighbourhoods; they work from scratch whenever the scene is asked for after an
    arrival, and `incremental` says so.

    Not safe for several threads by itself: whoever fills the partial scene in place holds them back.

    Args:
        partial: A scene in main memory whose tensors are filled in place, such as `ProgressiveDecoder.partial`.
        concealer: A concealer or its name.

    Attributes:
        recomputed: Rows of the scene that were computed so far, arrivals not counted.

    Raises:
        UnknownNameError: No concealer has that name.
    """

    def __init__(self, partial: Partial, concealer: Concealer | str) -> None:
        self.concealer = create_concealer(concealer) if isinstance(concealer, str) else concealer
        self.recomputed = 0
        self._partial = partial
        self._pending: list[np.ndarray] = []
        self._scene: Scene | None = None
        self._state = _state(partial, self.concealer)
        self.restart()

    @property
    def incremental(self) -> bool:
        """Whether the cost of an arrival is proportional to what it changes."""
        return self._state is not None

    def restart(self) -> None:
        """Starts over, because what had arrived was taken back; what follows from positions alone is kept."""
        self._pending.clear()
        self._scene = None
        if self._state is not None:
            self._state.restart()
            self._scene = self._state.scene()
            self._pending.append(self._partial.erasures.known.nonzero()[:, 0].numpy())

    def of(self, partial: Partial) -> Scene:
        """The concealed scene of another state of the same scene; only good until the next call."""
        if self._state is None:
            return conceal(partial, self.concealer)
        self._state.fill(partial)
        self.restart()
        return self.scene()

    def arrived(self, ranks: np.ndarray) -> None:
        """Notes anchors that are in the partial scene now; costs nothing yet.

        Args:
            ranks: int64; what was noted before is noted only once.
        """
        if len(ranks):
            self._pending.append(ranks)

    def scene(self) -> Scene:
        """The concealed scene as of now.

        Returns:
            With an incremental concealer the same tensors every time, filled in place.
        """
        arrivals = np.unique(np.concatenate([np.empty(0, np.int64), *self._pending]))
        if self._state is not None and self._scene is not None:
            arrivals = arrivals[~self._state.known.numpy()[arrivals]]
            with one_torch_thread() if len(arrivals) <= _FEW else nullcontext():
                self.recomputed += self._state.take(arrivals) if len(arrivals) else 0
        elif len(arrivals) or self._scene is None:
            self._scene = conceal(self._partial, self.concealer)
            self.recomputed += self._partial.erasures.num_lost
        self._pending.clear()
        assert self._scene is not None
        return self._scene


def _state(partial: Partial, concealer: Concealer) -> "_State | None":
    if not isinstance(partial, PartialScene):
        return None  # where a lost Gaussian is, is known when it arrives: what follows from places changes all the time
    context, received = context_of(partial), partial.erasures.received
    if not torch.equal(received.any(dim=1), received.all(dim=1)):
        return None  # separated packets: every attribute has gaps of its own
    match concealer:
        case Drop():
            return _State(partial, None, leave_out=True)
        case Grow():
            return _State(partial, _Growing(context, concealer), leave_out=True)
        case PriorMean():
            votes = (Attribute.MASK,)
            return _State(partial, _Neighborly(context, concealer.neighbors, 1.0, votes, concealer.vote))
        case Idw(metric="euclidean"):
            k, power = concealer.neighbors, concealer.power
            return _State(partial, _Neighborly(context, k, power, tuple(Attribute), concealer.vote))
    return None


class _State:
    """The concealed scene's tensors. Lost anchors hold the prior's mean unless a method knows better."""

    def __init__(self, partial: PartialScene, method: "_Method | None", *, leave_out: bool = False) -> None:
        self._partial, self.context, self._method, self._leave_out = partial, context_of(partial), method, leave_out
        self.restart()

    def fill(self, partial: Partial) -> None:
        """Takes over another state of the scene; what is drawn follows from `restart` on."""
        assert isinstance(partial, PartialScene)
        self._partial.fill(slice(None), partial)

    def scene(self) -> AnchorScene:
        """What is drawn."""
        return dataclasses.replace(self._partial.scene, anchors=self.anchors, hints=self.hints)

    def restart(self) -> None:
        """Nothing has arrived; tensors that were handed out stay as they are."""
        anchors, prior = self.context.anchors, self.context.prior
        num = anchors.num_anchors
        self.known = torch.zeros(num, dtype=torch.bool)
        self.anchors = dataclasses.replace(
            anchors,
            positions=self.context.places.clone(),
            features=prior.feature.mean.clone(),
            scalings=prior.scaling.mean.clone(),
            offsets=prior.offset.mean.view(anchors.offsets.shape).clone(),
            mask=torch.ones_like(anchors.mask),
        )
        self.hints = RenderHints(torch.ones(num), torch.full((num,), self._leave_out))
        self._floor = torch.zeros(6)
        if self._method is not None:
            self._method.restart()
        self._raise_sizes()

    def take(self, arrivals: np.ndarray) -> int:
        """Takes over what was received, then lets the method work; returns how many other rows were computed."""
        rows, decoded, nothing_yet = torch.from_numpy(arrivals), self.context.anchors, not bool(self.known.any())
        for name in ("positions", "features", "scalings", "offsets", "mask"):
            getattr(self.anchors, name)[rows] = getattr(decoded, name)[rows]
        self.known[rows] = True
        self.hints.left_out[rows] = False
        least = decoded.scalings[rows].amin(dim=0)
        floor = least if nothing_yet else torch.minimum(self._floor, least)
        computed = 0
        if not torch.equal(floor, self._floor):
            self._floor = floor
            computed = self._raise_sizes()
        return computed + (self._method.take(arrivals, self) if self._method is not None else 0)

    def _raise_sizes(self) -> int:
        """Predicted sizes are kept at least as large as the smallest received one (`fill.plausible_scalings`)."""
        if isinstance(self._method, _Neighborly) and self._method.fills_sizes and bool(self.known.any()):
            return 0
        lost = ~self.known
        predicted = torch.maximum(self.context.prior.scaling.mean, self._floor)
        self.anchors.scalings.copy_(torch.where(lost[:, None], predicted, self.anchors.scalings))
        return int(lost.sum())


class _Growing:
    """Received anchors weigh the lost ones among their neighbours; a gain follows from their share alone."""

    def __init__(self, context: AnchorContext, settings: Grow) -> None:
        from splatwire.conceal import _progressive_kernels as kernels

        positions, num = context.places, context.anchors.num_anchors
        tree, parts = NeighborTree(positions), []
        for own in torch.arange(num).split(_CHUNK):
            parts.append(nearest_others(tree, positions[own], own, settings.neighbors)[0].int())
        index = torch.cat(parts) if parts else torch.empty(0, 0, dtype=torch.int32)
        self._settings, self._weights = settings, context.elements.sizes.numpy()
        self._bounds, self._owners = kernels.reverse_lists(index.numpy())
        self._all = self._weights[index.numpy()].sum(axis=1)
        self._lost = np.empty(num)

    def restart(self) -> None:
        self._lost[:] = self._all

    def take(self, arrivals: np.ndarray, state: _State) -> int:
        from splatwire.conceal import _progressive_kernels as kernels

        changed = np.zeros(len(self._lost), dtype=np.bool_)
        kernels.count_arrivals(arrivals, self._bounds, self._owners, self._weights, self._lost, changed)
        share = np.divide(self._lost, self._all, out=np.zeros_like(self._lost), where=self._all > 0)
        left = 1 - torch.from_numpy(share).to(state.hints.size_gain.dtype)
        gain = self._settings.gain(left, state.known, state.context.tier_sizes)
        torch.where(state.known, gain, torch.ones_like(gain), out=state.hints.size_gain)
        return int((changed & state.known.numpy()).sum())


class _Neighborly:
    """Lost anchors take means of their nearest received anchors; the list of those is kept up to date."""

    def __init__(
        self,
        context: AnchorContext,
        neighbors: int,
        power: float | int,
        attributes: tuple[Attribute, ...],
        vote: MaskVote,
    ) -> None:
        from splatwire.conceal import _progressive_kernels as kernels

        num = context.anchors.num_anchors
        self.fills_sizes = Attribute.SCALING in attributes
        self._attributes, self._power, self._vote = attributes, power, vote
        self._positions = context.places.double().numpy()
        self._known = np.empty(num, dtype=np.bool_)
        self._distances, self._reach = np.empty((num, neighbors)), np.empty(num)
        self._indices = np.zeros((num, neighbors), dtype=np.int64)
        self._run_boxes = kernels.boxes_of(self._positions, kernels.RUN)
        self._group_boxes = kernels.boxes_of(self._positions, kernels.RUN * kernels.GROUP)
        self._run_reach, self._group_reach = np.empty(len(self._run_boxes)), np.empty(len(self._group_boxes))

    def restart(self) -> None:
        self._known[:] = False
        self._distances[:] = np.inf
        self._reach[:] = np.inf

    def take(self, arrivals: np.ndarray, state: _State) -> int:
        before = int(self._known.sum())
        self._known[arrivals] = True
        self._reach[arrivals] = -np.inf
        nearly_all_change = len(arrivals) >= before
        changed = self._search() if nearly_all_change else self._insert(arrivals)
        for rows in torch.from_numpy(changed).split(_CHUNK) if len(changed) else ():
            self._fill(rows, before + len(arrivals), state)
        return len(changed)

    def _search(self) -> np.ndarray:
        """Finds all neighbours from scratch; returns the lost anchors."""
        from splatwire.conceal import _progressive_kernels as kernels

        lost, support = np.flatnonzero(~self._known), np.flatnonzero(self._known)
        points = torch.from_numpy(self._positions)
        index, distance = NeighborTree(points[support]).query(points[lost], self._distances.shape[1])
        columns = index.shape[1]
        self._distances[lost, :columns], self._indices[lost, :columns] = distance.numpy(), support[index.numpy()]
        self._reach[lost] = self._distances[lost, -1]
        kernels.largest(self._reach, kernels.RUN, self._run_reach)
        kernels.largest(self._run_reach, kernels.GROUP, self._group_reach)
        return lost

    def _insert(self, arrivals: np.ndarray) -> np.ndarray:
        """Offers arrivals to the lost anchors around them; returns those that took one."""
        from splatwire.conceal import _progressive_kernels as kernels

        changed = np.zeros(len(self._known), dtype=np.bool_)
        kernels.insert_arrivals(
            arrivals, self._positions, self._known, self._distances, self._indices, self._reach,
            self._run_boxes, self._run_reach, self._group_boxes, self._group_reach, changed,
        )  # fmt: skip
        return np.flatnonzero(changed)

    def _fill(self, rows: Int64[Tensor, "Q"], num_known: int, state: _State) -> None:
        filled, context = state.anchors, state.context
        columns = min(self._distances.shape[1], num_known)
        index = torch.from_numpy(self._indices[rows.numpy(), :columns])
        distance = torch.from_numpy(self._distances[rows.numpy(), :columns]).to(filled.positions.dtype)
        weight = inverse_distance_weights(distance, self._power)
        filled.offsets[rows] = context.prior.offset.mean[rows].view(-1, *filled.offsets.shape[1:])
        used, place = index.unique(return_inverse=True)  # what the means touch, not the whole scene
        fill_from_neighbors(context.anchors.select(used), filled, self._attributes, rows, place, weight, self._vote)
        filled.offsets[rows] *= filled.mask[rows, :, None]


_Method = _Growing | _Neighborly
