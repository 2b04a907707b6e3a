"""Anchors of HAC++ (format 1)."""

from typing import Any

from splatwire.codec.anchors import prepare_anchors, prepare_anchors_again, update_digest
from splatwire.codec.decoding import decode_stream
from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.schemas.hacpp.decoder import open_decoder
from splatwire.codec.schemas.hacpp.encoder import hacpp_encoder, hacpp_encoder_again
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.model import AnchorScene, HacppCoding, Prior
from splatwire.packets import ANCHORS, Packetization, SceneStream
from splatwire.scene import AnchorLayout, Anchors


def _stated(scene: AnchorScene) -> dict[str, Any]:
    return dict(vars(scene.coding.config.layout))


def _prepare(scene: AnchorScene, options: Options) -> Prepared:
    return prepare_anchors(scene, options, hacpp_encoder, _stated(scene))


def _again(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    scene = decode_stream(stream, threads=threads).scene
    return prepare_anchors_again(stream, scene, packetization, hacpp_encoder_again, _stated(scene), MASKS)


SCHEMA = Schema(
    ANCHORS,
    codes=lambda scene: isinstance(scene, AnchorScene) and isinstance(scene.coding, HacppCoding),
    offers=frozenset((Anchors, Prior, AnchorLayout)),
    prepare=_prepare,
    prepare_again=_again,
    open_decoder=open_decoder,
    update_digest=update_digest,
)
