"""Gaussians that move (docs/format.md)."""

from typing import Any

from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.schemas.tracks.decoder import TracksDecoder, update_digest
from splatwire.errors import InvalidValueError
from splatwire.model.clip import ClipScene
from splatwire.packets import Packetization, SceneStream
from splatwire.packets.limits import TRACKS
from splatwire.scene.splats import Splats


def _prepare(scene: Any, options: Options) -> Prepared:
    raise InvalidValueError("a clip is encoded frame by frame: see `splatwire.clips.ClipEncoder`")


def _again(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    raise InvalidValueError("the packets of a clip fit datagrams as they are: encode its frames again for others")


SCHEMA = Schema(
    TRACKS,
    codes=lambda scene: isinstance(scene, ClipScene),
    offers=frozenset((Splats,)),
    prepare=_prepare,
    prepare_again=_again,
    open_decoder=TracksDecoder,
    update_digest=update_digest,
    repackable=lambda stream: False,
)
