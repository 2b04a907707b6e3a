"""Clips: frames of Gaussians that move, encoded group by group and decoded frame by frame."""

from splatwire.clips.decoding import ClipDecoder, ClipFrame, decode_frame, decode_frames
from splatwire.clips.encoding import ClipEncoder, encode_clip
from splatwire.clips.frames import Frame, frame_files, is_sequence, open_sequence, read_frames
from splatwire.clips.options import ClipOptions
from splatwire.clips.tracking import TrackingReport

__all__ = [
    "ClipDecoder",
    "ClipEncoder",
    "ClipFrame",
    "ClipOptions",
    "Frame",
    "TrackingReport",
    "decode_frame",
    "decode_frames",
    "encode_clip",
    "frame_files",
    "is_sequence",
    "open_sequence",
    "read_frames",
]
