"""Levels of Gaussians (docs/format.md): the Gaussian codec, with a level for a tier and a tile for a block."""

from dataclasses import replace

import numpy as np

from splatwire.codec.decoding import decode_stream
from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.schemas.gaussians.attributes import update_digest
from splatwire.codec.schemas.gaussians.decoder import GaussianDecoder, coding_of, open_side_info
from splatwire.codec.schemas.gaussians.encoder import prepare_splats
from splatwire.errors import InvalidValueError
from splatwire.model.level_scene import Levels, LevelScene
from splatwire.model.partial import Partial
from splatwire.model.splat_scene import SplatScene
from splatwire.packets import Manifest, Packetization, SceneStream
from splatwire.packets.limits import LEVELS
from splatwire.packets.sections import sections_of
from splatwire.packets.tile_index import read_tile_index, with_tile_index
from splatwire.scene.splats import Splats


class LevelsDecoder(GaussianDecoder):
    """See `GaussianDecoder`; what it decodes is drawn at its finest level.

    Raises:
        BitstreamError: Where the index of tiles is damaged or not there, too.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        super().__init__(manifest, side_info, num_bytes)
        read_tile_index(manifest, self.sections)  # what cannot be is told now, not by whoever fetches tiles
        self._sizes = tuple(tier.num_elements for tier in manifest.tiers) or (manifest.num_elements,)

    def scene(self) -> Partial[SplatScene]:
        """See `Decoder.scene`."""
        partial = super().scene()
        numbers = np.arange(len(self._sizes) - 1, -1, -1, dtype=np.uint8)
        levels = Levels(np.repeat(numbers, self._sizes), self._levels)
        scene = replace(partial.scene, hints=levels.hints, coding=None)
        return replace(partial, scene=scene).saying(levels)


def _prepare(scene: LevelScene, options: Options) -> Prepared:
    tiers = np.repeat(np.arange(len(scene.level_sizes), dtype=np.uint8), scene.level_sizes)
    return prepare_splats(scene, replace(options, tiers=tiers), sorted_already=True)


def _again(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    if packetization.block_size != stream.manifest.packetization.block_size:
        raise InvalidValueError("tiles of levels are blocks of packets: encode the scene again for other blocks")
    info, partial = open_side_info(stream.manifest, stream.side_info), decode_stream(stream, threads=threads)
    coding = coding_of(info, partial[Levels].classes)
    sizes = [tier.num_elements for tier in stream.manifest.tiers] or [stream.manifest.num_elements]
    tiers = np.repeat(np.arange(len(sizes), dtype=np.uint8), sizes)
    scene = replace(partial.scene, hints=None, coding=coding)
    return prepare_splats(scene, Options(packetization, tiers=tiers, threads=threads), like=info, sorted_already=True)


def _carried(stream: SceneStream, packed: SceneStream) -> SceneStream:
    """Other packets have other sizes."""
    return with_tile_index(packed, read_tile_index(stream.manifest, sections_of(stream)).errors)


SCHEMA = Schema(
    LEVELS,
    codes=lambda scene: isinstance(scene, LevelScene),
    offers=frozenset((Splats, Levels)),
    prepare=_prepare,
    prepare_again=_again,
    open_decoder=LevelsDecoder,
    update_digest=update_digest,
    carried=_carried,
)
