"""Codec: scenes to streams of independently decodable packets, and back.

The names of `__all__` are imported on first use, so that reading side information imports no encoder.
"""

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
