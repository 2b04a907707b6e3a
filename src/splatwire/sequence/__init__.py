"""Sequences of moving Gaussians: encoding by group of pictures, and decoding by frame."""

from splatwire.lazy_names import lazy_names

_RENAMED = {
    "ClipDecoder": "SequenceDecoder",
    "ClipEncoder": "SequenceEncoder",
    "ClipFrame": "SequenceFrame",
    "ClipOptions": "SequenceOptions",
    "encode_clip": "encode_sequence",
}
"""Current name of each deprecated name."""
__all__, __getattr__, __dir__ = lazy_names(__name__, __file__, _RENAMED)
