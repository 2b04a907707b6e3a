"""Packet by packet: what arrives is decoded into arrays that are a scene at every moment."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from splatwire.codec.arrivals import Arrivals
from splatwire.codec.decoding import open_decoder, tier_facts
from splatwire.codec.schema import CHUNK_ANCHORS, chunks, update_digest
from splatwire.codec.threads import ordered_map
from splatwire.errors import DesyncError
from splatwire.model import PartialScene
from splatwire.model.appearance import Partial
from splatwire.ops.threads import one_blas_thread
from splatwire.packets import Manifest, Packet, PacketIntake
from splatwire.scene import Erasures

_FILLED = ("positions", "features", "scalings", "offsets", "mask")
"""Fields of the anchors that arriving packets fill in place."""


@dataclass(frozen=True, eq=False)
class _Decoded:
    """Some packets' anchors, not yet written anywhere."""

    ranks: np.ndarray
    rows: np.ndarray


class ProgressiveDecoder(Arrivals):
    """Decodes a stream while it arrives: the same integers as `decode_stream`, in any order of packets.

    Side information is read once, and the prior of every anchor evaluated; from then on a packet costs what its own
    anchors cost. Packets may come from several threads, twice, damaged or from elsewhere: `report` counts them.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.
        threads: Threads for the prior of all anchors, and for packets of thousands of anchors that come at once; None
            for one for each processor. What a datagram brings is decoded by the thread that brings it.
        progress: Called with the share of the prior that is done, 0 to 1.

    Attributes:
        lock: Held while rows are written. Hold it to read several of them as of one moment.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it contradicts the manifest.
    """

    def __init__(
        self,
        manifest: Manifest,
        side_info: bytes,
        *,
        intake: PacketIntake | None = None,
        threads: int | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(manifest, side_info, intake)
        self._decoder = open_decoder(manifest, side_info)
        tiers = tier_facts(self._decoder, manifest)
        self._order = tiers.order
        self._threads = threads
        self._predict(progress)
        num = manifest.num_anchors
        self._symbols: np.ndarray | None = np.zeros((num, self._decoder.num_symbols), dtype=np.int32)
        self._received = np.zeros((num, 4), dtype=np.bool_)
        self._num_known = 0
        erasures = Erasures(torch.from_numpy(self._received))
        self._partial = replace(self._decoder.scene(), erasures=erasures, tier_sizes=tiers.sizes)

    @property
    def partial(self) -> PartialScene:
        """The scene as it is now and as it will be: its tensors are filled in place (see `lock`)."""
        return self._partial

    @property
    def num_known(self) -> int:
        """Anchors that have arrived."""
        return self._num_known

    @property
    def complete(self) -> bool:
        """Whether every anchor has arrived."""
        return self._num_known == self.manifest.num_anchors

    def members(self, packet: Packet) -> np.ndarray:
        """Ranks of a packet's anchors, int64, in the order in which it holds them.

        Raises:
            InvalidValueError: If the stream has no such packet.
        """
        places = self.manifest.plan.members(packet.id, packet.num_anchors)
        return places if self._order is None else self._order[places]

    def snapshot(self) -> PartialScene:
        """The scene as it is now, in tensors of its own that never change."""
        with self.lock:
            live = self._partial
            erasures = Erasures(live.erasures.received.clone())
            filled = {name: getattr(live.scene.anchors, name).clone() for name in _FILLED}
        scene = replace(live.scene, anchors=replace(live.scene.anchors, **filled))
        return replace(live, scene=scene, erasures=erasures)

    def show(self, shown: Partial, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Brings another state of the scene to the one in which exactly some of what arrived is there.

        Args:
            shown: The other state, in tensors of its own (`PartialScene.without`).
            wanted: Which anchors are to be there, bool (N).

        Returns:
            Anchors that were taken back and those that are new, int64.
        """
        assert isinstance(shown, PartialScene)
        known = shown.erasures.known.numpy()
        old, new = np.flatnonzero(known & ~wanted), np.flatnonzero(wanted & ~known)
        shown.fill(torch.from_numpy(new), self._partial)
        shown.fill(torch.from_numpy(old), None)
        return old, new

    def add(self, packets: Iterable[Packet]) -> np.ndarray:
        """Decodes packets; several at once cost less than one by one.

        Args:
            packets: What arrived, in any order. What the plan has no place for, or is there already, is counted.

        Returns:
            Ranks of the anchors that are new, int64, in the order of the packets.

        Raises:
            DesyncError: If now everything is there and yet the decoded integers are not those that were encoded.
        """
        taken = self.take(packets)
        new = [np.empty(0, dtype=np.int64)]
        for decoded in self._decode_all(taken):
            with self.lock:
                self._store(decoded)
            new.append(decoded.ranks)
        if taken and self.complete:
            self._check()
        return np.concatenate(new)

    def _predict(self, progress: Callable[[float], None] | None) -> None:
        """Evaluates what is expected of every anchor."""
        num = self.manifest.num_anchors

        def predict(start: int) -> int:
            ranks = np.arange(start, min(start + CHUNK_ANCHORS, num))
            self._decoder.predict(ranks)
            return int(ranks[-1]) + 1

        for done in ordered_map(predict, range(0, num, CHUNK_ANCHORS), self._threads):
            if progress:
                progress(done / num)

    def _decode_all(self, packets: list[Packet]) -> Iterator[_Decoded]:
        runs = [packets[run] for run in chunks(np.array([packet.num_anchors for packet in packets]))]
        if len(runs) > 1:
            yield from ordered_map(self._decode, runs, self._threads)
        elif runs:
            with one_blas_thread():
                decoded = self._decode(runs[0])
            yield decoded

    def _decode(self, packets: list[Packet]) -> _Decoded:
        members = [self.members(packet) for packet in packets]
        ranks, counts = np.concatenate(members), np.array([len(m) for m in members])
        payloads = [packet.payload for packet in packets]
        return _Decoded(ranks, self._decoder.decode(ranks, counts, payloads))

    def _store(self, decoded: _Decoded) -> None:
        self._decoder.store(decoded.ranks, decoded.rows)
        self._received[decoded.ranks] = True
        self._num_known += len(decoded.ranks)
        if self._symbols is not None:
            self._symbols[decoded.ranks] = decoded.rows

    def _check(self) -> None:
        """Compares all decoded integers with the manifest's digest, once; their copy is not needed after that."""
        with self.lock:
            symbols, self._symbols = self._symbols, None
            if symbols is None or not self.has_every_packet:
                return
        ranks = self.manifest.plan.groups().ranks
        ranks = ranks if self._order is None else self._order[ranks]
        digest = hashlib.sha256()
        for start in range(0, len(ranks), CHUNK_ANCHORS):
            update_digest(digest, symbols[ranks[start : start + CHUNK_ANCHORS]])
        if digest.hexdigest() != self.manifest.symbols_digest:
            raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
