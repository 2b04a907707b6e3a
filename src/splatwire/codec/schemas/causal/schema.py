"""Anchors of the causal model (format 2)."""

from splatwire.codec.anchors import prepare_anchors, prepare_anchors_again, update_digest
from splatwire.codec.decoding import decode_stream
from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.schemas.causal.decoder import CausalDecoder
from splatwire.codec.schemas.causal.encoder import causal_encoder, causal_encoder_again
from splatwire.model import AnchorScene, CausalCoding, ExpectedPlaces, Prior
from splatwire.packets import CAUSAL, Packetization, SceneStream
from splatwire.scene import AnchorLayout, Anchors


def _prepare(scene: AnchorScene, options: Options) -> Prepared:
    return prepare_anchors(scene, options, causal_encoder, {})


def _again(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    scene = decode_stream(stream, threads=threads).scene
    return prepare_anchors_again(stream, scene, packetization, causal_encoder_again, {})


SCHEMA = Schema(
    CAUSAL,
    codes=lambda scene: isinstance(scene, AnchorScene) and isinstance(scene.coding, CausalCoding),
    offers=frozenset((Anchors, Prior, AnchorLayout, ExpectedPlaces)),
    prepare=_prepare,
    prepare_again=_again,
    open_decoder=CausalDecoder,
    update_digest=update_digest,
)
