"""Definition of the codec `causal` of neural anchors (stream format 2): its encoder, decoder and repacketization.

The causal model predicts each attribute of an anchor from attributes of the same anchor that are already decoded.
"""

from splatwire.bitstream import CAUSAL, Packetization, SceneStream
from splatwire.bitstream.limits import SCHEMAS
from splatwire.codec.anchors.anchor_codec import prepare_anchor_repack, prepare_anchors, update_digest
from splatwire.codec.anchors.causal.decoder import CausalDecoder
from splatwire.codec.anchors.causal.encoder import causal_encoder, causal_repack_encoder
from splatwire.codec.decoding import decode_stream
from splatwire.codec.schema import Options, Prepared, schema_for
from splatwire.types import AnchorLayout, Anchors, AnchorScene, CausalCoding, PredictedPositions, Prior


def _prepare(scene: AnchorScene, options: Options) -> Prepared:
    return prepare_anchors(scene, options, causal_encoder, {})


def _prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    scene = decode_stream(stream, threads=threads).scene
    return prepare_anchor_repack(stream, scene, packetization, causal_repack_encoder, {})


SCHEMA = schema_for(
    SCHEMAS[CAUSAL],
    scene_type=AnchorScene,
    can_encode=lambda scene: isinstance(scene.coding, CausalCoding),
    provides=frozenset((Anchors, Prior, AnchorLayout, PredictedPositions)),
    prepare=_prepare,
    prepare_repack=_prepare_repack,
    open_decoder=CausalDecoder,
    update_digest=update_digest,
)
