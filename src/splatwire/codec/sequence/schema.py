"""Definition of the codec of moving Gaussians: a `Schema` with its scene type and decoder (docs/format.md)."""

from typing import Any

from splatwire.bitstream import Packetization, SceneStream
from splatwire.bitstream.limits import SCHEMAS, TRACKS
from splatwire.codec.schema import Options, Prepared, schema_for
from splatwire.codec.sequence.decoder import TracksDecoder, update_digest
from splatwire.errors import InvalidValueError
from splatwire.types.sequence_scene import SequenceScene
from splatwire.types.splats import Splats


def _prepare(scene: Any, options: Options) -> Prepared:
    raise InvalidValueError("a clip is encoded frame by frame: see `splatwire.sequence.SequenceEncoder`")


def _prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    raise InvalidValueError("the packets of a clip fit datagrams as they are: encode its frames again for others")


SCHEMA = schema_for(
    SCHEMAS[TRACKS],
    scene_type=SequenceScene,
    provides=frozenset((Splats,)),
    prepare=_prepare,
    prepare_repack=_prepare_repack,
    open_decoder=TracksDecoder,
    update_digest=update_digest,
    can_repack=lambda stream: False,
)
