"""Packet by packet: what arrives is decoded into arrays that are a scene at every moment."""

import copy
import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from splatwire.codec.arrivals import Arrivals
from splatwire.codec.decoding import open_decoder, predict_all, tier_facts
from splatwire.codec.memory import allocating, check_memory, threads_within
from splatwire.codec.schema import AnchorDecoder, chunks, most_at_once, update_digest
from splatwire.codec.threads import ordered_map
from splatwire.errors import DesyncError
from splatwire.model import AnchorScene, Partial
from splatwire.ops.threads import one_blas_thread
from splatwire.packets import Manifest, Packet, PacketId, PacketIntake
from splatwire.scene import Erasures

_FILLED = ("positions", "features", "scalings", "offsets", "mask")
"""Fields of the anchors that arriving packets fill in place."""


@dataclass(frozen=True, eq=False)
class _Decoded:
    """Some packets' anchors, not yet written anywhere."""

    packets: list[Packet]
    members: list[np.ndarray]
    rows: np.ndarray


class ProgressiveDecoder(Arrivals):
    """Decodes a stream while it arrives: the same integers as `decode_stream`, in any order of packets.

    Side information is read once; from then on a packet costs what its own anchors cost. Packets may come from several
    threads, twice, damaged or from elsewhere: `report` counts them. Until somebody asks for `partial`, only what
    arrived takes memory; then the prior of every anchor is evaluated.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.
        threads: Threads for the prior of all anchors, and for packets of thousands of anchors that come at once; None
            for one for each processor. What a datagram brings is decoded by the thread that brings it.
        progress: Called, where somebody asks for `partial`, with the share of the prior that is done, 0 to 1.

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
        self._tiers = tier_facts(self._decoder, manifest)
        self._threads, self._progress = threads, progress
        self._what = f"decoding {manifest.num_anchors:,} anchors"
        self._found: dict[PacketId, tuple[np.ndarray, np.ndarray]] = {}
        self._checked = False
        self._num_known = 0
        self._room: AnchorDecoder | None = None
        self._partial: Partial[AnchorScene] | None = None

    @property
    def partial(self) -> Partial[AnchorScene]:
        """The scene as it is now and as it will be: its tensors are filled in place (see `lock`).

        Raises:
            BitstreamError: If a scene of all anchors takes too much memory (`splatwire.codec.memory`).
        """
        with self.lock:
            if self._partial is None:
                check_memory(self._decoder.scene_bytes, None, self._what)
                with allocating(self._what):
                    self._make_room()
            assert self._partial is not None
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
        return places if self._tiers.order is None else self._tiers.order[places]

    def snapshot(self) -> Partial[AnchorScene]:
        """The scene as it is now, in tensors of its own that never change."""
        with self.lock:
            live = self.partial
            erasures = Erasures(live.erasures.received.clone())
            filled = {name: getattr(live.scene.anchors, name).clone() for name in _FILLED}
        scene = replace(live.scene, anchors=replace(live.scene.anchors, **filled))
        return replace(live, scene=scene, erasures=erasures)

    def show(self, shown: Partial, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Brings another state of the scene to the one in which exactly some of what arrived is there.

        Args:
            shown: The other state, in tensors of its own (`Partial.without`).
            wanted: Which anchors are to be there, bool (N).

        Returns:
            Anchors that were taken back and those that are new, int64.
        """
        known = shown.erasures.known.numpy()
        old, new = np.flatnonzero(known & ~wanted), np.flatnonzero(wanted & ~known)
        shown.fill(torch.from_numpy(new), self.partial)
        shown.fill(torch.from_numpy(old), None)
        return old, new

    def add(self, packets: Iterable[Packet]) -> np.ndarray:
        """Decodes packets; several at once cost less than one by one.

        Args:
            packets: What arrived, in any order. What the plan has no place for, or is there already, is counted.

        Returns:
            Ranks of the anchors that are new, int64, in the order of the packets.

        Raises:
            BitstreamError: If so many anchors in so few bytes take too much memory (`splatwire.codec.memory`).
            DesyncError: If now everything is there and yet the decoded integers are not those that were encoded.
        """
        taken, new = self.take(packets), [np.empty(0, dtype=np.int64)]
        held = self.num_taken * (4 * self._decoder.num_symbols + 8)
        working = most_at_once(taken) * self._decoder.row_bytes
        what = f"decoding {self.num_taken:,} anchors that arrived"
        threads = threads_within(held, working, self.num_bytes, what, self._threads)
        with allocating(self._what):
            for decoded in self._decode_all(taken, threads):
                with self.lock:
                    self._keep(decoded)
                new += decoded.members
        if taken and self.complete:
            self._check()
        return np.concatenate(new)

    def _make_room(self) -> None:
        """Makes a scene of all anchors, and writes into it what has arrived."""
        room = copy.copy(self._decoder)  # which stays as it is: others may be decoding with it
        predict_all(room, self.manifest.num_anchors, self._threads, self._progress)
        for ranks, rows in self._found.values():
            room.store(ranks, rows)
        self._room, self._partial = room, room.scene().saying(*self._tiers.said)

    def _decode_all(self, packets: list[Packet], threads: int) -> Iterator[_Decoded]:
        runs = [packets[run] for run in chunks(np.array([packet.num_anchors for packet in packets]))]
        if len(runs) > 1:
            yield from ordered_map(self._decode, runs, threads)
        elif runs:
            with one_blas_thread():
                decoded = self._decode(runs[0])
            yield decoded

    def _decode(self, packets: list[Packet]) -> _Decoded:
        members = [self.members(packet) for packet in packets]
        counts, payloads = np.array([len(m) for m in members]), [packet.payload for packet in packets]
        return _Decoded(packets, members, self._decoder.decode(np.concatenate(members), counts, payloads))

    def _keep(self, decoded: _Decoded) -> None:
        ends = np.cumsum([len(own) for own in decoded.members])[:-1]
        for packet, own, rows in zip(decoded.packets, decoded.members, np.split(decoded.rows, ends), strict=True):
            self._found[packet.id] = own, rows
            self._num_known += len(own)
            if self._room is not None:
                self._room.store(own, rows)

    def _check(self) -> None:
        """Compares all decoded integers with the manifest's digest, once."""
        with self.lock:
            if self._checked or not self.has_every_packet:
                return
            self._checked = True
            digest = hashlib.sha256()
            for packet_id in sorted(self._found):
                update_digest(digest, self._found[packet_id][1])
            if self._room is not None:  # nobody asks for them any more
                self._found.clear()
        if digest.hexdigest() != self.manifest.symbols_digest:
            raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
