"""Defines the codec `hacpp` (format 1) for anchors of HAC++.

The definition consists of the encoder, the decoder, and the division of a stream into other packets.
"""

from typing import Any

from splatwire.bitstream import HACPP_ANCHORS, Packetization, SceneStream
from splatwire.bitstream.limits import SCHEMAS
from splatwire.codec.anchors.anchor_codec import prepare_anchor_repack, prepare_anchors, update_digest
from splatwire.codec.anchors.hacpp.decoder import open_decoder
from splatwire.codec.anchors.hacpp.encoder import hacpp_encoder, hacpp_repack_encoder
from splatwire.codec.anchors.hacpp.separated import SECTION as MASKS
from splatwire.codec.decoding import decode_stream
from splatwire.codec.schema import Options, Prepared, schema_for
from splatwire.types import AnchorLayout, Anchors, AnchorScene, HacppCoding, Prior


def _manifest_fields(scene: AnchorScene) -> dict[str, Any]:
    return dict(vars(scene.coding.config.layout))


def _prepare(scene: AnchorScene, options: Options) -> Prepared:
    return prepare_anchors(scene, options, hacpp_encoder, _manifest_fields(scene))


def _prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    scene = decode_stream(stream, threads=threads).scene
    return prepare_anchor_repack(stream, scene, packetization, hacpp_repack_encoder, _manifest_fields(scene), MASKS)


SCHEMA = schema_for(
    SCHEMAS[HACPP_ANCHORS],
    scene_type=AnchorScene,
    can_encode=lambda scene: isinstance(scene.coding, HacppCoding),
    provides=frozenset((Anchors, Prior, AnchorLayout)),
    prepare=_prepare,
    prepare_repack=_prepare_repack,
    open_decoder=open_decoder,
    update_digest=update_digest,
)
