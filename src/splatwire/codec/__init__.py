"""Codec: scenes to streams of independently decodable packets, and back."""

from splatwire.codec.decoder import decode_stream as decode_stream
from splatwire.codec.encoder import encode_scene as encode_scene
from splatwire.codec.side_info import side_info_parts as side_info_parts
