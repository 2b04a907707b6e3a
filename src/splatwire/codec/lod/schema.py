"""Definition of the codec of Gaussians with levels of detail: its encoder and decoder (docs/format.md)."""

from dataclasses import replace

import numpy as np

from splatwire.bitstream import Manifest, Packetization, SceneStream
from splatwire.bitstream.limits import LEVELS, SCHEMAS
from splatwire.bitstream.sections import sections_of
from splatwire.bitstream.tile_index import read_tile_index, with_tile_index
from splatwire.codec.decoding import decode_stream
from splatwire.codec.gaussians.attributes import update_digest
from splatwire.codec.gaussians.decoder import GaussianDecoder, coding_of, open_side_info
from splatwire.codec.gaussians.encoder import prepare_splats
from splatwire.codec.schema import Options, Prepared, schema_for
from splatwire.errors import InvalidValueError
from splatwire.types.lod_scene import Levels, LevelScene
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats


class LevelsDecoder(GaussianDecoder):
    """Decoder of Gaussians with levels of detail.

    Args:
        manifest: The stream's manifest.
        side_info: The stream's side information, serialised.
        num_bytes: Number of received bytes of the stream; not used, but all decoders have this parameter.

    Raises:
        MissingSideInfoError: If the stream has no side information.
        BitstreamError: If the side information is damaged or contradicts the manifest, or the index of tiles is damaged
            or absent.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        super().__init__(manifest, side_info, num_bytes)
        read_tile_index(manifest, self.sections)  # reports damage on opening, not only when tiles are requested
        self._sizes = tuple(tier.num_elements for tier in manifest.tiers) or (manifest.num_elements,)

    def scene(self) -> ReceivedScene[SplatScene]:
        """Returns the scene decoded so far, with the mask of received Gaussians and their levels of detail."""
        received = super().scene()
        numbers = np.arange(len(self._sizes) - 1, -1, -1, dtype=np.uint8)
        levels = Levels(np.repeat(numbers, self._sizes), self._precision_classes)
        scene = replace(received.scene, hints=levels.hints, coding=None)
        return replace(received, scene=scene).with_records(levels)


def _prepare(scene: LevelScene, options: Options) -> Prepared:
    tiers = np.repeat(np.arange(len(scene.level_sizes), dtype=np.uint8), scene.level_sizes)
    return prepare_splats(scene, replace(options, tiers=tiers), sorted_already=True)


def _prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    if packetization.block_size != stream.manifest.packetization.block_size:
        raise InvalidValueError("tiles of levels are blocks of packets: encode the scene again for other blocks")
    info, received = open_side_info(stream.manifest, stream.side_info), decode_stream(stream, threads=threads)
    coding = coding_of(info, received[Levels].classes)
    sizes = [tier.num_elements for tier in stream.manifest.tiers] or [stream.manifest.num_elements]
    tiers = np.repeat(np.arange(len(sizes), dtype=np.uint8), sizes)
    scene = replace(received.scene, hints=None, coding=coding)
    return prepare_splats(
        scene, Options(packetization, tiers=tiers, threads=threads), template=info, sorted_already=True
    )


def _remap_sections(stream: SceneStream, packed: SceneStream) -> SceneStream:
    """Updates the index of tiles (spatial blocks of one level of detail) after a stream was divided into other packets.

    Args:
        stream: The stream before the packets changed.
        packed: The same scene in other packets.

    Returns:
        `packed` with an index of its tiles.
    """
    return with_tile_index(packed, read_tile_index(stream.manifest, sections_of(stream)).errors)


SCHEMA = schema_for(
    SCHEMAS[LEVELS],
    scene_type=LevelScene,
    provides=frozenset((Splats, Levels)),
    prepare=_prepare,
    prepare_repack=_prepare_repack,
    open_decoder=LevelsDecoder,
    update_digest=update_digest,
    remap_sections=_remap_sections,
)
