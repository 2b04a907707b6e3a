"""Clips: frames of Gaussians that move, encoded group by group and decoded frame by frame.

The names of `__all__` are loaded on first use: a verb that only asks whether a folder holds frames loads no more.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatwire.clips.decoding import ClipDecoder as ClipDecoder
    from splatwire.clips.decoding import ClipFrame as ClipFrame
    from splatwire.clips.decoding import decode_frame as decode_frame
    from splatwire.clips.decoding import decode_frames as decode_frames
    from splatwire.clips.encoding import ClipEncoder as ClipEncoder
    from splatwire.clips.encoding import encode_clip as encode_clip
    from splatwire.clips.frames import Frame as Frame
    from splatwire.clips.frames import frame_files as frame_files
    from splatwire.clips.frames import is_sequence as is_sequence
    from splatwire.clips.frames import open_sequence as open_sequence
    from splatwire.clips.frames import read_frames as read_frames
    from splatwire.clips.options import ClipOptions as ClipOptions
    from splatwire.clips.tracking import TrackingReport as TrackingReport

_HOME = {
    "ClipDecoder": "decoding",
    "ClipEncoder": "encoding",
    "ClipFrame": "decoding",
    "ClipOptions": "options",
    "Frame": "frames",
    "TrackingReport": "tracking",
    "decode_frame": "decoding",
    "decode_frames": "decoding",
    "encode_clip": "encoding",
    "frame_files": "frames",
    "is_sequence": "frames",
    "open_sequence": "frames",
    "read_frames": "frames",
}

__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'splatwire.clips' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"splatwire.clips.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
