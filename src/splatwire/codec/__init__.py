"""Codec: encodes scenes to streams of independently decodable packets, and decodes streams."""
# The public names are imported on first use, so that reading side information does not import an encoder.

from splatwire.lazy_names import lazy_names

_RENAMED = {"add_concealment": "with_section", "without_concealment": "without_section"}
"""Current name of each deprecated name."""
__all__, __getattr__, __dir__ = lazy_names(__name__, __file__, _RENAMED)
