"""Progressive decoding: packets are decoded on arrival into arrays that form a scene at any time."""

import copy
import hashlib
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream import Manifest, Packet, PacketId, PacketIntake
from splatwire.codec.arrivals import Arrivals
from splatwire.codec.decoding import batches_of, open_decoder
from splatwire.codec.memory import allocating, check_memory, threads_within
from splatwire.codec.schema import DecodedRows, Decoder, PacketBatch
from splatwire.codec.threads import ordered_map
from splatwire.errors import BitstreamError, DesyncError
from splatwire.types import LossMask
from splatwire.types.received_scene import ReceivedScene


class ProgressiveDecoder(Arrivals):
    """Decoder for use during a transfer: adds each packet to the scene at its arrival.

    Packets may arrive in any order and from several threads. Duplicate, damaged and foreign packets are only counted,
    in `report`.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: Packet filter of the receiver. A packet that this filter has accepted already is not validated again.
            None to create a filter, which validates all packets.
        threads: Number of threads; None for one per processor.
        progress: Called while the scene is allocated, at the first read of `received_scene`, with the completed
            fraction, 0 to 1.

    Attributes:
        lock: Held while decoded elements are written. Hold it to read several elements consistently.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If side information and manifest contradict each other, or packets cannot be decoded
            individually.
    """

    # The decoded integers are the same as with `decode_stream`. The cost of a packet does not depend on the size of the
    # scene. The first read of `received_scene` allocates the scene with predicted values of all elements; until then,
    # only received elements take memory. A single datagram is decoded in the calling thread.

    @checked
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
        if not self._decoder.packets_independent:
            raise BitstreamError("packets of separated attributes are decoded all at once, not one by one")
        self._threads, self._progress = threads, progress
        self._activity = f"decoding {manifest.num_elements:,} {manifest.elements}"
        self._decoded: dict[PacketId, tuple[Packet, DecodedRows | None]] = {}
        self._blocks: dict[int, list[Packet]] = {}
        self._checked, self._num_received = False, 0
        self._scene_decoder: Decoder | None = None
        self._received_scene: ReceivedScene | None = None

    @property
    def partial(self) -> ReceivedScene:
        """Deprecated name of `received_scene`."""
        warnings.warn("ProgressiveDecoder.partial is deprecated, use received_scene", DeprecationWarning, stacklevel=2)
        return self.received_scene

    @property
    def received_scene(self) -> ReceivedScene:
        """Scene decoded so far; later packets change its arrays in place.

        Hold `lock` while reading several elements.

        Raises:
            BitstreamError: If a scene of all elements exceeds the memory limit (`splatwire.codec.memory`).
        """
        with self.lock:
            if self._received_scene is None:
                check_memory(self.scene_bytes, None, self._activity)
                with allocating(self._activity):
                    self._allocate()
            assert self._received_scene is not None
            return self._received_scene

    @property
    def scene_bytes(self) -> int:
        """Memory of the scene that `received_scene` returns, bytes."""
        return self._decoder.scene_bytes

    @property
    def num_known(self) -> int:
        """Deprecated name of `num_received`."""
        warnings.warn("ProgressiveDecoder.num_known is deprecated, use num_received", DeprecationWarning, stacklevel=2)
        return self.num_received

    @property
    def num_received(self) -> int:
        """Number of received elements."""
        return self._num_received

    @property
    def complete(self) -> bool:
        """True if every element was received."""
        return self._num_received == self.manifest.num_elements

    def members(self, packet: Packet) -> np.ndarray:
        """Returns the indices of a packet's elements in the decoded scene, int64.

        Raises:
            InvalidValueError: If the stream has no such packet.
        """
        indices, order = self.manifest.plan.members(packet.id, packet.num_elements), self._decoder.order
        return indices if order is None else order[indices]

    def snapshot(self) -> ReceivedScene:
        """Returns a copy of the scene decoded so far, independent of later packets."""
        with self.lock:
            current = self.received_scene
            all_elements = np.arange(current.scene.num_elements)
            return replace(
                current, scene=current.scene.select(all_elements), loss_mask=LossMask(current.loss_mask.received.copy())
            )

    def add(self, packets: Iterable[Packet]) -> np.ndarray:
        """Decodes packets and adds their elements to the scene.

        Args:
            packets: Received packets, in any order. Duplicates, and packets that the stream does not contain, are only
                counted.

        Returns:
            Indices of the new elements in the decoded scene, int64.

        Raises:
            BitstreamError: If the decoded elements exceed the memory limit (`splatwire.codec.memory`).
            DesyncError: If the stream is now complete, but the decoded integers differ from the encoded ones.
        """
        # One call with several packets is cheaper than several calls.
        taken, new_indices = self.take(packets), [np.empty(0, dtype=np.int64)]
        stored_bytes = 0 if self._decoder.redecode_on_demand else self.num_accepted * (self._decoder.row_bytes + 8)
        working = self._decoder.working_bytes(taken)
        activity = f"decoding {self.num_accepted:,} {self.manifest.elements} that arrived"
        threads = threads_within(stored_bytes, working, self.num_bytes, activity, self._threads)
        batches = list(batches_of(self._decoder, self.manifest, taken))
        with allocating(self._activity):
            # Starting a thread costs more than decoding one datagram.
            for batch, rows in ordered_map(self._decode, batches, threads if len(batches) > 1 else 1):
                with self.lock:
                    self._store_new(batch, rows)
                new_indices.append(batch.indices)
        if taken and self.complete:
            self._check()
        return np.concatenate(new_indices)

    def _decode(self, batch: PacketBatch) -> tuple[PacketBatch, DecodedRows | None]:
        return batch, None if self._decoder.redecode_on_demand else self._decoder.decode(batch)

    def _store_new(self, batch: PacketBatch, rows: DecodedRows | None) -> None:
        """Keeps the decoded integers of new packets, and writes the elements of the packets to the scene.

        Args:
            batch: The new packets.
            rows: Decoded integers of the packets. None if the integers are not kept: the packets are then decoded again
                when the integers are needed.
        """
        # Some decoders estimate lost elements from the received ones of their block. For these, the whole block is
        # updated.
        ends = np.cumsum(batch.counts)[:-1]
        rows_by_packet = (
            [None] * len(batch.packets) if rows is None else zip(*(np.split(part, ends) for part in rows), strict=True)
        )
        for packet, packet_rows in zip(batch.packets, rows_by_packet, strict=True):
            self._decoded[packet.id] = packet, packet_rows
            self._blocks.setdefault(packet.id.block, []).append(packet)
        self._num_received += len(batch.indices)
        if self._scene_decoder is not None:
            self._store(
                self._scene_decoder,
                self._blocks[batch.block] if self._scene_decoder.batches_are_blocks else batch.packets,
            )

    def _allocate(self) -> None:
        """Allocates a scene for all elements, and writes the received elements into the scene."""
        scene_decoder = copy.copy(
            self._decoder
        )  # the original stays unchanged, because other threads may be decoding with it
        scene_decoder.allocate(self._threads, self._progress)
        for batch in batches_of(scene_decoder, self.manifest, self._packets(), gaps=True):
            scene_decoder.store(batch, self._decoded_integers(batch))
        self._scene_decoder, self._received_scene = scene_decoder, scene_decoder.scene()

    def _store(self, scene_decoder: Decoder, packets: Iterable[Packet]) -> None:
        for batch in batches_of(scene_decoder, self.manifest, packets):
            scene_decoder.store(batch, self._decoded_integers(batch))

    def _packets(self) -> list[Packet]:
        return [packet for packet, _ in self._decoded.values()]

    def _decoded_integers(self, batch: PacketBatch) -> DecodedRows:
        """Returns the decoded integers of packets that were added before.

        Args:
            batch: The packets, which the decoder decodes in one call.
        """
        # If only compressed packets are kept in memory, they are decoded again.
        kept_rows = [rows for packet in batch.packets if (rows := self._decoded[packet.id][1]) is not None]
        if not kept_rows:
            return self._decoder.decode(batch)
        return tuple(np.concatenate(parts) for parts in zip(*kept_rows, strict=True))

    def _check(self) -> None:
        """Checks the hash of all decoded integers against the manifest; does nothing until all packets have arrived.

        Raises:
            DesyncError: If the hashes differ.
        """
        with self.lock:
            if self._checked or not self.has_every_packet:
                return
            self._checked, digest = True, hashlib.sha256()
            for batch in batches_of(self._decoder, self.manifest, self._packets()):
                self._decoder.update_digest(digest, self._decoded_integers(batch))
            if self._scene_decoder is not None:  # no longer needed
                self._decoded.clear()
                self._blocks.clear()
        if digest.hexdigest() != self.manifest.symbols_digest:
            raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
