"""Concealment that keeps up with a transfer: only what an arrival changes is computed again."""

import dataclasses
from contextlib import nullcontext

import numpy as np
import torch

from splatwire.conceal.base import Concealer
from splatwire.conceal.conceal import conceal
from splatwire.conceal.drop import Drop
from splatwire.conceal.grow import Grow
from splatwire.conceal.registry import create_concealer
from splatwire.model import Partial, Prior, RenderHints
from splatwire.model.appearance import Scene
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.ops.threads import one_torch_thread

_CHUNK = 1 << 14
_FEW = 1 << 12
"""Arrivals up to which threads cost more to wake than they save."""


class ProgressiveConcealer:
    """A concealed scene that is brought up to date as anchors arrive.

    For `drop` and `grow` the scene at every moment is the one that `conceal` makes from
    scratch of what is there: attributes bit for bit, size gains to one part in a million. Other concealers work from
    scratch whenever the scene is asked for after an arrival, and `incremental` says so.

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
    if partial.expectation is None:
        return None  # where a lost Gaussian is, is known when it arrives: what follows from places changes all the time
    received = partial.erasures.received
    if not torch.equal(received.any(dim=1), received.all(dim=1)):
        return None  # separated packets: every attribute has gaps of its own
    match concealer:
        case Drop():
            return _State(partial, None, leave_out=True)
        case Grow():
            return _State(partial, _Growing(partial, concealer), leave_out=True)
    return None


class _State:
    """The concealed scene's tensors. Lost anchors hold the prior's mean unless a method knows better."""

    def __init__(self, partial: Partial, method: "_Growing | None", *, leave_out: bool = False) -> None:
        self.partial, self._method, self._leave_out = partial, method, leave_out
        self.restart()

    def fill(self, partial: Partial) -> None:
        """Takes over another state of the scene; what is drawn follows from `restart` on."""
        self.partial.fill(torch.arange(partial.scene.num_elements), partial)

    def scene(self) -> Scene:
        """What is drawn."""
        return self.partial.scene.with_elements(self.anchors, self.hints)

    def restart(self) -> None:
        """Nothing has arrived; tensors that were handed out stay as they are."""
        anchors, prior = self.partial.elements, self.partial[Prior]
        num = anchors.num_anchors
        self.known = torch.zeros(num, dtype=torch.bool)
        self.anchors = dataclasses.replace(
            anchors,
            positions=self.partial.places.clone(),
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
        rows, decoded, nothing_yet = torch.from_numpy(arrivals), self.partial.elements, not bool(self.known.any())
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
        """Predicted sizes are kept at least as large as the smallest received one (`plausible_scalings`)."""
        lost = ~self.known
        predicted = torch.maximum(self.partial[Prior].scaling.mean, self._floor)
        self.anchors.scalings.copy_(torch.where(lost[:, None], predicted, self.anchors.scalings))
        return int(lost.sum())


class _Growing:
    """Received anchors weigh the lost ones among their neighbours; a gain follows from their share alone."""

    def __init__(self, partial: Partial, settings: Grow) -> None:
        from splatwire.conceal import _progressive_kernels as kernels

        positions, num = partial.places, partial.scene.num_elements
        tree, parts = NeighborTree(positions), []
        for own in torch.arange(num).split(_CHUNK):
            parts.append(nearest_others(tree, positions[own], own, settings.neighbors)[0].int())
        index = torch.cat(parts) if parts else torch.empty(0, 0, dtype=torch.int32)
        self._settings, self._weights = settings, partial.sizes.numpy()
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
        gain = self._settings.gain(left, state.known, state.partial.tier_sizes)
        torch.where(state.known, gain, torch.ones_like(gain), out=state.hints.size_gain)
        return int((changed & state.known.numpy()).sum())
