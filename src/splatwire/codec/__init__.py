"""Codec: scenes to streams of independently decodable packets, and back."""

from splatwire.codec.schemas.hacpp.decoder import decode_stream
from splatwire.codec.schemas.hacpp.encoder import encode_scene, scene_in_order
from splatwire.codec.schemas.hacpp.progressive import ProgressiveDecoder
from splatwire.packets.sections import add_concealment, side_info_parts, without_concealment

__all__ = [
    "ProgressiveDecoder",
    "add_concealment",
    "decode_stream",
    "encode_scene",
    "scene_in_order",
    "side_info_parts",
    "without_concealment",
]
