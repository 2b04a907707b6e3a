"""Codec: scenes to streams of independently decodable packets, and back."""

import splatwire.codec.schemas  # noqa: F401
from splatwire.codec.anchors import scene_in_order
from splatwire.codec.decoding import decode_stream
from splatwire.codec.encoding import encode_scene, repack, repackable
from splatwire.codec.progressive import ProgressiveDecoder
from splatwire.codec.registry import register_schema, schema_named, schema_of
from splatwire.packets.sections import add_concealment, side_info_parts, without_concealment

__all__ = [
    "ProgressiveDecoder",
    "add_concealment",
    "decode_stream",
    "encode_scene",
    "register_schema",
    "repack",
    "repackable",
    "scene_in_order",
    "schema_named",
    "schema_of",
    "side_info_parts",
    "without_concealment",
]
