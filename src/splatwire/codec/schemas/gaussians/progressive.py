"""Packet by packet: what arrives is decoded into Gaussians that are a scene at every moment."""

import hashlib
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import torch

from splatwire.codec.arrivals import Arrivals
from splatwire.codec.background import read_background
from splatwire.codec.memory import allocating, check_memory
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schemas.gaussians.attributes import empty_rows
from splatwire.codec.schemas.gaussians.blocks import block_sizes
from splatwire.codec.schemas.gaussians.copies import read_copies
from splatwire.codec.schemas.gaussians.decoder import (
    blank_splats,
    decode_packets,
    open_side_info,
    row_bytes,
    scene_bytes,
    store_block,
    working_bytes,
)
from splatwire.codec.schemas.gaussians.digest import update_digest
from splatwire.errors import DesyncError
from splatwire.model import SplatScene
from splatwire.model.appearance import Partial
from splatwire.packets import ArrivedBlock, Manifest, Packet, PacketId, PacketIntake, arrived_blocks
from splatwire.scene import Erasures


class ProgressiveSplats(Arrivals):
    """Decodes a stream of Gaussians while it arrives: at every moment what a decoder makes of the same packets.

    A packet costs what its own Gaussians cost, and what is expected of the lost ones of its block. Until somebody asks
    for `partial`, only what arrived takes memory.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.

    Attributes:
        lock: Held while rows are written. Hold it to read several of them as of one moment.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it contradicts the manifest.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, *, intake: PacketIntake | None = None) -> None:
        super().__init__(manifest, side_info, intake)
        self._what = f"decoding {manifest.num_anchors:,} Gaussians"
        self._info = open_side_info(manifest, side_info)
        self._copies = read_copies(self._info, manifest.num_anchors)
        self._found: dict[PacketId, tuple[np.ndarray, np.ndarray]] = {}
        self._packets: dict[int, list[Packet]] = {}
        self._num_known = 0
        self._partial: Partial[SplatScene] | None = None

    @property
    def partial(self) -> Partial[SplatScene]:
        """The scene as it is now and as it will be: its tensors are filled in place.

        Raises:
            BitstreamError: If a scene of all Gaussians takes too much memory (`splatwire.codec.memory`).
        """
        with self.lock:
            if self._partial is None:
                check_memory(scene_bytes(self._info, self.manifest), None, self._what)
                with allocating(self._what):
                    self._partial = self._whole()
            return self._partial

    @property
    def num_known(self) -> int:
        """Gaussians that have arrived."""
        return self._num_known

    @property
    def complete(self) -> bool:
        """Whether every Gaussian has arrived."""
        return self.has_every_packet

    def members(self, packet: Packet) -> np.ndarray:
        """Places of a packet's Gaussians, int64, in the order in which it holds them.

        Raises:
            InvalidValueError: If the stream has no such packet.
        """
        return self.manifest.plan.members(packet.id, packet.num_anchors)

    def snapshot(self) -> Partial[SplatScene]:
        """The scene as it is now, in tensors of its own that never change."""
        with self.lock:
            live = self.partial
            splats = replace(live.scene.splats, **{n: t.clone() for n, t in vars(live.scene.splats).items()})
            erasures = Erasures(live.erasures.received.clone())
        return replace(live, scene=replace(live.scene, splats=splats), erasures=erasures)

    def add(self, packets: Iterable[Packet]) -> np.ndarray:
        """Decodes packets; several of a block at once cost less than one by one.

        Returns:
            Places of the Gaussians that are new, int64.

        Raises:
            BitstreamError: If so many Gaussians in so few bytes take too much memory (`splatwire.codec.memory`).
            DesyncError: If now everything is there and yet the decoded integers are not those that were encoded.
        """
        taken, new = self.take(packets), [np.empty(0, dtype=np.int64)]
        held = self.num_taken * row_bytes(self._info) + working_bytes(self._info, self.manifest)
        check_memory(held, self.num_bytes, f"decoding {self.num_taken:,} Gaussians that arrived")
        for arrived in arrived_blocks(self.manifest.plan, taken):
            with allocating(self._what):
                rows, harmonics = decode_packets(self._info, arrived.number, arrived.counts, arrived.payloads)
            new += [arrived.ranks[run] for run in arrived.runs]
            with self.lock:
                self._keep(arrived, rows, harmonics)
        if taken and self.complete:
            self._check()
        return np.concatenate(new)

    def show(self, shown: Partial, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Brings another state of the scene to the one in which exactly some of what arrived is there.

        Args:
            shown: The other state, in tensors of its own (`snapshot`).
            wanted: Which Gaussians are to be there, bool (N).

        Returns:
            Gaussians that were taken back and those that are new, int64.
        """
        known, edges = shown.erasures.known.numpy(), np.cumsum(block_sizes(self.manifest.plan))
        changed = np.flatnonzero(known != wanted)
        for block in np.unique(np.searchsorted(edges, changed, side="right")).tolist():
            self._store(shown, wanted, self._arrived(block))
        return changed[known[changed]], changed[wanted[changed]]

    def _whole(self) -> Partial[SplatScene]:
        """A scene of all Gaussians, and in it what has arrived."""
        num, info = self.manifest.num_anchors, self._info
        scene = SplatScene(blank_splats(num, info.degree), background=read_background(info.sections))
        erasures = Erasures.of_anchors(torch.zeros(num, dtype=torch.bool))
        said = () if self._copies is None else (self._copies,)
        partial = Partial(scene, erasures, concealer_sections(info.sections), said)
        everything = np.ones(num, dtype=np.bool_)
        for arrived in self._every_block():
            self._store(partial, everything, arrived)
        return partial

    def _keep(self, arrived: ArrivedBlock, rows: np.ndarray, harmonics: np.ndarray) -> None:
        """Keeps the integers of packets that are new, and writes their block anew."""
        ends = np.cumsum(arrived.counts)[:-1]
        for packet, own, levels in zip(arrived.packets, np.split(rows, ends), np.split(harmonics, ends), strict=True):
            self._found[packet.id] = own, levels
            self._packets.setdefault(arrived.number, []).append(packet)
        self._num_known += len(rows)
        if self._partial is not None:
            known = self._partial.erasures.known.numpy()
            known[arrived.ranks[arrived.received]] = True
            self._store(self._partial, known, self._arrived(arrived.number))

    def _arrived(self, block: int) -> ArrivedBlock:
        """What has arrived of a block so far."""
        if block not in self._packets:
            return ArrivedBlock(block, self.manifest.plan.block_ranks(block), (), ())
        return next(arrived_blocks(self.manifest.plan, self._packets[block]))

    def _every_block(self) -> Iterator[ArrivedBlock]:
        packets = itertools.chain.from_iterable(self._packets.values())
        return arrived_blocks(self.manifest.plan, packets, gaps=True)

    def _integers(self, arrived: ArrivedBlock) -> tuple[np.ndarray, np.ndarray]:
        """Integers of a block, 0 where nothing arrived."""
        rows, harmonics = empty_rows(len(arrived.ranks), self._info.num_harmonics)
        for packet, run in zip(arrived.packets, arrived.runs, strict=True):
            rows[run], harmonics[run] = self._found[packet.id]
        return rows, harmonics

    def _store(self, shown: Partial[SplatScene], wanted: np.ndarray, arrived: ArrivedBlock) -> None:
        """Writes a block as if exactly the wanted ones of what arrived had."""
        rows, harmonics = self._integers(arrived)
        received = wanted[arrived.ranks] & arrived.received
        harmonics[~received] = 0
        store_block(shown.scene.splats, arrived.ranks, rows, harmonics, received, self._info, arrived.number)
        shown.erasures.received[torch.from_numpy(arrived.ranks)] = torch.from_numpy(received)[:, None]

    def _check(self) -> None:
        """Compares all decoded integers with the manifest's digest."""
        digest = hashlib.sha256()
        for arrived in self._every_block():
            update_digest(digest, *self._integers(arrived))
        if digest.hexdigest() != self.manifest.symbols_digest:
            raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
