"""Packet by packet: what arrives is decoded into arrays that are a scene at every moment."""

import copy
import hashlib
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from splatwire.codec.arrivals import Arrivals
from splatwire.codec.decoding import open_decoder, runs_of
from splatwire.codec.memory import allocating, check_memory, threads_within
from splatwire.codec.schema import Decoder, Rows, Run
from splatwire.codec.threads import ordered_map
from splatwire.errors import BitstreamError, DesyncError
from splatwire.model.partial import Partial
from splatwire.packets import Manifest, Packet, PacketId, PacketIntake
from splatwire.scene import Erasures


class ProgressiveDecoder(Arrivals):
    """Decodes a stream while it arrives: the same integers as `decode_stream`, in any order of packets.

    Side information is read once; from then on a packet costs what its own elements cost. Packets may come from several
    threads, twice, damaged or from elsewhere: `report` counts them. Until somebody asks for `partial`, only what
    arrived takes memory; then what is expected of every element is evaluated.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.
        threads: Threads for what is expected of all elements, and for packets of thousands of elements that come at
            once; None for one for each processor. What a datagram brings is decoded by the thread that brings it.
        progress: Called, where somebody asks for `partial`, with the share of the preparation that is done, 0 to 1.

    Attributes:
        lock: Held while rows are written. Hold it to read several of them as of one moment.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it contradicts the manifest, or packets cannot be decoded one by one.
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
        if not self._decoder.alone:
            raise BitstreamError("packets of separated attributes are decoded all at once, not one by one")
        self._threads, self._progress = threads, progress
        self._what = f"decoding {manifest.num_elements:,} {manifest.elements}"
        self._found: dict[PacketId, tuple[Packet, Rows | None]] = {}
        self._blocks: dict[int, list[Packet]] = {}
        self._checked, self._num_known = False, 0
        self._room: Decoder | None = None
        self._partial: Partial | None = None

    @property
    def partial(self) -> Partial:
        """The scene as it is now and as it will be: its tensors are filled in place (see `lock`).

        Raises:
            BitstreamError: If a scene of all elements takes too much memory (`splatwire.codec.memory`).
        """
        with self.lock:
            if self._partial is None:
                check_memory(self.scene_bytes, None, self._what)
                with allocating(self._what):
                    self._make_room()
            assert self._partial is not None
            return self._partial

    @property
    def scene_bytes(self) -> int:
        """Memory that `partial` takes."""
        return self._decoder.scene_bytes

    @property
    def num_known(self) -> int:
        """Elements that have arrived."""
        return self._num_known

    @property
    def complete(self) -> bool:
        """Whether every element has arrived."""
        return self._num_known == self.manifest.num_elements

    def members(self, packet: Packet) -> np.ndarray:
        """Ranks of a packet's elements, int64, in the order in which it holds them.

        Raises:
            InvalidValueError: If the stream has no such packet.
        """
        places, order = self.manifest.plan.members(packet.id, packet.num_elements), self._decoder.order
        return places if order is None else order[places]

    def snapshot(self) -> Partial:
        """The scene as it is now, in arrays of its own that never change."""
        with self.lock:
            live = self.partial
            everyone = np.arange(live.scene.num_elements)
            return replace(live, scene=live.scene.select(everyone), erasures=Erasures(live.erasures.received.copy()))

    def add(self, packets: Iterable[Packet]) -> np.ndarray:
        """Decodes packets; several at once cost less than one by one.

        Args:
            packets: What arrived, in any order. What the plan has no place for, or is there already, is counted.

        Returns:
            Ranks of the elements that are new, int64, in the order of the plan.

        Raises:
            BitstreamError: If so many elements in so few bytes take too much memory (`splatwire.codec.memory`).
            DesyncError: If now everything is there and yet the decoded integers are not those that were encoded.
        """
        taken, new = self.take(packets), [np.empty(0, dtype=np.int64)]
        held = 0 if self._decoder.again else self.num_taken * (self._decoder.row_bytes + 8)
        working = self._decoder.working_bytes(taken)
        what = f"decoding {self.num_taken:,} {self.manifest.elements} that arrived"
        threads = threads_within(held, working, self.num_bytes, what, self._threads)
        runs = list(runs_of(self._decoder, self.manifest, taken))
        with allocating(self._what):
            # What a datagram brings is not worth a thread of its own.
            for run, rows in ordered_map(self._decode, runs, threads if len(runs) > 1 else 1):
                with self.lock:
                    self._keep(run, rows)
                new.append(run.ranks)
        if taken and self.complete:
            self._check()
        return np.concatenate(new)

    def _decode(self, run: Run) -> tuple[Run, Rows | None]:
        return run, None if self._decoder.again else self._decoder.decode(run)

    def _keep(self, run: Run, rows: Rows | None) -> None:
        """Keeps the integers of packets that are new, and writes them, or their block anew."""
        ends = np.cumsum(run.counts)[:-1]
        each = [None] * len(run.packets) if rows is None else zip(*(np.split(part, ends) for part in rows), strict=True)
        for packet, own in zip(run.packets, each, strict=True):
            self._found[packet.id] = packet, own
            self._blocks.setdefault(packet.id.block, []).append(packet)
        self._num_known += len(run.ranks)
        if self._room is not None:
            self._store(self._room, self._blocks[run.block] if self._room.whole_blocks else run.packets)

    def _make_room(self) -> None:
        """Makes a scene of all elements, and writes into it what has arrived."""
        room = copy.copy(self._decoder)  # which stays as it is: others may be decoding with it
        room.expect(self._threads, self._progress)
        for run in runs_of(room, self.manifest, self._packets(), gaps=True):
            room.store(run, self._rows(run))
        self._room, self._partial = room, room.scene()

    def _store(self, room: Decoder, packets: Iterable[Packet]) -> None:
        for run in runs_of(room, self.manifest, packets):
            room.store(run, self._rows(run))

    def _packets(self) -> list[Packet]:
        return [packet for packet, _ in self._found.values()]

    def _rows(self, run: Run) -> Rows:
        """The integers of packets that came before."""
        found = [rows for packet in run.packets if (rows := self._found[packet.id][1]) is not None]
        if not found:
            return self._decoder.decode(run)
        return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))

    def _check(self) -> None:
        """Compares all decoded integers with the manifest's digest, once."""
        with self.lock:
            if self._checked or not self.has_every_packet:
                return
            self._checked, digest = True, hashlib.sha256()
            for run in runs_of(self._decoder, self.manifest, self._packets()):
                self._decoder.update_digest(digest, self._rows(run))
            if self._room is not None:  # nobody asks for them any more
                self._found.clear()
                self._blocks.clear()
        if digest.hexdigest() != self.manifest.symbols_digest:
            raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
