"""Packet by packet: what arrives is decoded into Gaussians that are a scene at every moment."""

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby

import numpy as np
import torch

from splatwire.codec.arrivals import Arrivals
from splatwire.codec.background import read_background
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schemas.gaussians.attributes import empty_rows
from splatwire.codec.schemas.gaussians.blocks import block_sizes
from splatwire.codec.schemas.gaussians.copies import read_copies
from splatwire.codec.schemas.gaussians.decoder import blank_splats, decode_block, open_side_info, store_block
from splatwire.codec.schemas.gaussians.digest import update_digest
from splatwire.errors import DesyncError
from splatwire.model import PartialSplats, SplatScene
from splatwire.model.appearance import Partial
from splatwire.packets import Manifest, Packet, PacketIntake, arrange
from splatwire.scene import Erasures


class ProgressiveSplats(Arrivals):
    """Decodes a stream of Gaussians while it arrives: at every moment what a decoder makes of the same packets.

    A packet costs what its own Gaussians cost, and what is expected of the lost ones of its block.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.

    Attributes:
        lock: Held while rows are written. Hold it to read several of them as of one moment.
        partial: The scene as it is now and as it will be: its tensors are filled in place.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it contradicts the manifest.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, *, intake: PacketIntake | None = None) -> None:
        super().__init__(manifest, side_info, intake)
        self._info = info = open_side_info(manifest, side_info)
        self._order = arrange(manifest.plan, ())[0].ranks
        self._edges = np.concatenate([[0], np.cumsum(block_sizes(manifest.plan))])
        self._rows, self._harmonics = empty_rows(manifest.num_anchors, info.num_harmonics)
        sections = concealer_sections(info.sections)
        scene = SplatScene(blank_splats(manifest.num_anchors, info.degree), background=read_background(info.sections))
        nothing = torch.zeros(manifest.num_anchors, dtype=torch.bool)
        copies = read_copies(info, manifest.num_anchors)
        self.partial = PartialSplats(scene, Erasures.of_anchors(nothing), sections, copies)
        self._store(self.partial, nothing.numpy(), range(manifest.plan.num_blocks))

    @property
    def num_known(self) -> int:
        """Gaussians that have arrived."""
        return int(self.partial.erasures.known.sum())

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

    def snapshot(self) -> PartialSplats:
        """The scene as it is now, in tensors of its own that never change."""
        with self.lock:
            splats = replace(
                self.partial.scene.splats, **{n: t.clone() for n, t in vars(self.partial.scene.splats).items()}
            )
            erasures = Erasures(self.partial.erasures.received.clone())
        return replace(self.partial, scene=replace(self.partial.scene, splats=splats), erasures=erasures)

    def add(self, packets: Iterable[Packet]) -> np.ndarray:
        """Decodes packets; several of a block at once cost less than one by one.

        Returns:
            Places of the Gaussians that are new, int64.

        Raises:
            DesyncError: If now everything is there and yet the decoded integers are not those that were encoded.
        """
        taken = sorted(self.take(packets), key=lambda packet: packet.id)
        new = [np.empty(0, dtype=np.int64)]
        for block, some in groupby(taken, key=lambda packet: packet.id.block):
            own = tuple(some)
            places = np.concatenate([self.members(packet) for packet in own])
            rows, harmonics, _ = decode_block(self._info, block, np.array([p.num_anchors for p in own]), own)
            with self.lock:
                self._rows[places], self._harmonics[places] = rows, harmonics
                known = self.partial.erasures.known.numpy()
                known[places] = True
                self._store(self.partial, known, [block])
            new.append(places)
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
        assert isinstance(shown, PartialSplats)
        known = shown.erasures.known.numpy()
        changed = np.flatnonzero(known != wanted)
        self._store(shown, wanted, np.unique(np.searchsorted(self._edges, changed, side="right") - 1).tolist())
        return changed[known[changed]], changed[wanted[changed]]

    def _store(self, shown: PartialSplats, wanted: np.ndarray, blocks: Iterable[int]) -> None:
        """Writes blocks as if exactly the wanted ones of what arrived had."""
        for block in blocks:
            places = self._order[self._edges[block] : self._edges[block + 1]]
            received = wanted[places]
            harmonics = np.where(received[:, None], self._harmonics[places], 0)
            store_block(shown.scene.splats, places, self._rows[places], harmonics, received, self._info, block)
            shown.erasures.received[torch.from_numpy(places)] = torch.from_numpy(received)[:, None]

    def _check(self) -> None:
        """Compares all decoded integers with the manifest's digest."""
        digest = hashlib.sha256()
        for block in range(self.manifest.plan.num_blocks):
            places = self._order[self._edges[block] : self._edges[block + 1]]
            update_digest(digest, self._rows[places], self._harmonics[places])
        if digest.hexdigest() != self.manifest.symbols_digest:
            raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
