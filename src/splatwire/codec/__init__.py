"""Codec: scenes to streams of independently decodable packets, and back."""

from splatwire.codec.encoding import scene_in_order
from splatwire.codec.streams import (
    ProgressiveDecoder,
    codec_of,
    decode_anchors,
    decode_stream,
    encode_scene,
    offers_of,
    progressive_decoder,
    repack,
    repackable,
)
from splatwire.packets.sections import add_concealment, side_info_parts, without_concealment

__all__ = [
    "ProgressiveDecoder",
    "add_concealment",
    "codec_of",
    "decode_anchors",
    "decode_stream",
    "encode_scene",
    "offers_of",
    "progressive_decoder",
    "repack",
    "repackable",
    "scene_in_order",
    "side_info_parts",
    "without_concealment",
]
