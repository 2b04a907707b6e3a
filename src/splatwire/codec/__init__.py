"""Codec: scenes to streams of independently decodable packets, and back."""

from splatwire.codec.schemas.hacpp.decoder import decode_stream as decode_stream
from splatwire.codec.schemas.hacpp.encoder import encode_scene as encode_scene
from splatwire.codec.schemas.hacpp.encoder import scene_in_order as scene_in_order
from splatwire.codec.schemas.hacpp.progressive import ProgressiveDecoder as ProgressiveDecoder
from splatwire.codec.sections import add_concealment as add_concealment
from splatwire.codec.sections import side_info_parts as side_info_parts
from splatwire.codec.sections import without_concealment as without_concealment
