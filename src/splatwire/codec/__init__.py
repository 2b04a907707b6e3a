"""Codec: scenes to streams of independently decodable packets, and back."""

from splatwire.codec.decoder import decode_stream as decode_stream
from splatwire.codec.encoder import encode_scene as encode_scene
from splatwire.codec.sections import add_concealment as add_concealment
from splatwire.codec.sections import side_info_parts as side_info_parts
from splatwire.codec.sections import without_concealment as without_concealment
