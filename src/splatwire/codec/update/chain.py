"""Current state of a served scene, and the updates that lead to it from earlier states."""

from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.bitstream.sections import sections_of
from splatwire.codec.decoding import decode_stream
from splatwire.codec.encoding import into_datagrams
from splatwire.codec.update.apply import apply_update
from splatwire.codec.update.encoder import encode_change
from splatwire.codec.update.section import SECTION, manifest_digest, read_update, update_name
from splatwire.types.splat_scene import SplatScene

MAX_UPDATES = 256
"""Maximum number of updates that a chain keeps."""


@dataclass(frozen=True, eq=False)
class UpdateChain:
    """State of a live scene on a server, with the updates that bring receivers of earlier states up to date.

    Attributes:
        source: Current state of the scene, as the stream to which the next update applies.
        scene: Current state of the scene, as the stream that is sent: its packets fit into datagrams. It is the same
            object as `source` if the packets of `source` fit.
        updates: Updates between successive states of `scene`, the newest last.
    """

    source: SceneStream
    scene: SceneStream
    updates: tuple[SceneStream, ...] = ()

    @property
    def source_digest(self) -> str:
        """Digest of the stream to which the next update applies, hexadecimal."""
        return manifest_digest(self.source.manifest)

    def offers(self) -> dict[str, SceneStream | None]:
        """Returns the updates that receivers can request, by name (`update_name`).

        The last entry is the update that will change the current state. Its value is None, because this update does not
        exist yet.
        """
        offers: dict[str, SceneStream | None] = {
            update_name(read_update(sections_of(update)[SECTION]).base_digest): update for update in self.updates
        }
        return offers | {update_name(manifest_digest(self.scene.manifest)): None}

    def extended(self, update: SceneStream) -> "UpdateChain":
        """Applies an update to the scene; returns the chain with the new state.

        Raises:
            InvalidValueError: If packets are missing, or the update is for another stream.
            BitstreamError: If a stream is damaged.
            DesyncError: If the result differs from the stream that the encoder made.
        """
        source = apply_update(self.source, update)
        if self.scene is self.source:
            packetization, most = update.manifest.packetization, self.scene.manifest.packetization.packet_bytes
            fits = packetization.hashed and packetization.packet_bytes <= most
            return self._with(source, source, update if fits else into_datagrams(update))
        scene = decode_stream(source).scene
        # Each Gaussian keeps its class, also one that `self.scene` does not contain.
        finest = int(scene.coding.precision_classes.max())
        class_offsets = (scene.coding.precision_classes.astype(int) - finest).astype("int8")
        change = encode_change(self.scene, scene, class_offsets, finest=finest)
        return self._with(source, change.result, change.update)

    def edited(self, scene: SplatScene, finest: int, class_offsets: np.ndarray | None = None) -> "UpdateChain":
        """Encodes a changed scene as an update; returns the chain with the new state.

        The chain itself is returned if nothing changes.

        Args:
            scene: The changed scene.
            finest: Finest precision class (set of quantisation steps), as numbered in streams: 0 is the coarsest.
            class_offsets: Class offset of each Gaussian relative to `finest`, integers (M): 0, or negative for coarser
                classes. None to use `finest` for all. An unchanged Gaussian is encoded again if its class in the stream
                is coarser than requested here.

        Raises:
            InvalidValueError: If an update cannot express the change, see `encode_update`.
        """
        change = encode_change(self.scene, scene, class_offsets, finest=finest)
        if manifest_digest(change.result.manifest) == manifest_digest(self.scene.manifest):
            return self
        return self._with(change.result, change.result, change.update)

    def _with(self, source: SceneStream, scene: SceneStream, update: SceneStream) -> "UpdateChain":
        """Returns the chain, extended by a new state of the scene.

        Args:
            source: The new state of the scene, as the stream to which the next update applies.
            scene: The same state as the stream to send, with packets that fit into datagrams.
            update: The update from the preceding state to the new one.
        """
        updates = (*self.updates, update)[-MAX_UPDATES:]
        sizes = accumulate(each.num_bytes for each in reversed(updates))
        useful = sum(size <= scene.num_bytes for size in sizes)
        return replace(self, source=source, scene=scene, updates=updates[len(updates) - max(useful, 1) :])
