"""Definition of the codec of explicit Gaussians: its encoder, decoder and repacketization (docs/format.md)."""

import math

import numpy as np

from splatwire.bitstream import GAUSSIANS, Packetization, SceneStream
from splatwire.bitstream.limits import SCHEMAS
from splatwire.bitstream.sections import sections_of, with_section
from splatwire.codec.decoding import decode_stream
from splatwire.codec.gaussians.attributes import update_digest
from splatwire.codec.gaussians.copies import SECTION as SKETCH
from splatwire.codec.gaussians.copies import remap_copies
from splatwire.codec.gaussians.decoder import GaussianDecoder, open_side_info
from splatwire.codec.gaussians.encoder import prepare_splats
from splatwire.codec.schema import Options, Prepared, schema_for
from splatwire.errors import InvalidValueError
from splatwire.types import SplatScene
from splatwire.types.splats import Splats


def _prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    if not _can_repack(stream):
        raise InvalidValueError(
            "an older release encoded these Gaussians, and their integers are bound to their packets: "
            "encode the scene again"
        )
    info, tier_counts = open_side_info(stream.manifest, stream.side_info), stream.manifest.tiers
    tiers = np.repeat(np.arange(len(tier_counts), dtype=np.uint8), [counts.num_elements for counts in tier_counts])
    scene = decode_stream(stream, threads=threads).scene
    options = Options(packetization, tiers=tiers if tier_counts else None, threads=threads)
    return prepare_splats(scene, options, template=info)


def _can_repack(stream: SceneStream) -> bool:
    return not open_side_info(stream.manifest, stream.side_info).packet_dependent


def _remap_sections(stream: SceneStream, packed: SceneStream) -> SceneStream:
    """Updates the redundant copies of Gaussians after a stream was divided into other packets.

    Args:
        stream: The stream before the packets changed.
        packed: The same scene in other packets.

    Returns:
        `packed` with copies that refer to the new order of Gaussians.
    """
    # A copy refers to its Gaussian by index, and the rearrangement changes the order of the Gaussians.
    sections = sections_of(stream)
    if SKETCH not in sections:
        return packed
    old, new = (ranked_by_attributes(decode_stream(one).scene.splats) for one in (stream, packed))
    new_index = np.empty(len(old), dtype=np.int64)
    new_index[old] = new
    return with_section(packed, SKETCH, remap_copies(sections[SKETCH], new_index))


def ranked_by_attributes(splats: Splats) -> np.ndarray:
    """Sorts Gaussians by the values of their attributes. The result does not depend on the order of the input.

    Returns:
        Entry i is the index in `splats` of the i-th Gaussian in sorted order, int64 (N).
    """
    columns = [values.reshape(len(values), math.prod(values.shape[1:])) for values in vars(splats).values()]
    return np.lexsort(np.concatenate(columns, axis=1).T)


SCHEMA = schema_for(
    SCHEMAS[GAUSSIANS],
    scene_type=SplatScene,
    provides=frozenset((Splats,)),
    prepare=prepare_splats,
    prepare_repack=_prepare_repack,
    open_decoder=GaussianDecoder,
    update_digest=update_digest,
    can_repack=_can_repack,
    remap_sections=_remap_sections,
)
