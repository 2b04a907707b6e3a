"""Explicit Gaussians (docs/format.md)."""

import numpy as np

from splatwire.codec.decoding import decode_stream
from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.schemas.gaussians.attributes import update_digest
from splatwire.codec.schemas.gaussians.copies import SECTION as SKETCH
from splatwire.codec.schemas.gaussians.copies import moved_copies
from splatwire.codec.schemas.gaussians.decoder import GaussianDecoder, open_side_info
from splatwire.codec.schemas.gaussians.encoder import prepare_splats
from splatwire.errors import InvalidValueError
from splatwire.model import SplatScene
from splatwire.packets import GAUSSIANS, Packetization, SceneStream
from splatwire.packets.sections import add_concealment, sections_of
from splatwire.scene.splats import Splats


def _again(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    if not _repackable(stream):
        raise InvalidValueError(
            "an older release encoded these Gaussians, and their integers are bound to their packets: "
            "encode the scene again"
        )
    info, shapes = open_side_info(stream.manifest, stream.side_info), stream.manifest.tiers
    tiers = np.repeat(np.arange(len(shapes), dtype=np.uint8), [shape.num_elements for shape in shapes])
    scene = decode_stream(stream, threads=threads).scene
    options = Options(packetization, tiers=tiers if shapes else None, threads=threads)
    return prepare_splats(scene, options, like=info)


def _repackable(stream: SceneStream) -> bool:
    return open_side_info(stream.manifest, stream.side_info).coarsest >= 0


def _carried(stream: SceneStream, packed: SceneStream) -> SceneStream:
    """Copies name Gaussians by their places, which other packets change."""
    sections = sections_of(stream)
    if SKETCH not in sections:
        return packed
    old, new = (_ranked(decode_stream(one).scene.splats) for one in (stream, packed))
    place_at = np.empty(len(old), dtype=np.int64)
    place_at[old] = new
    return add_concealment(packed, SKETCH, moved_copies(sections[SKETCH], place_at))


def _ranked(splats: Splats) -> np.ndarray:
    """Gaussians in an order that depends on nothing but themselves, int64 (N)."""
    columns = [values.reshape(splats.num_gaussians, -1) for values in vars(splats).values()]
    return np.lexsort(np.concatenate(columns, axis=1).T)


SCHEMA = Schema(
    GAUSSIANS,
    codes=lambda scene: isinstance(scene, SplatScene),
    offers=frozenset((Splats,)),
    prepare=prepare_splats,
    prepare_again=_again,
    open_decoder=GaussianDecoder,
    update_digest=update_digest,
    repackable=_repackable,
    carried=_carried,
)
