"""Description of a stream or scene file for the tasks of an evaluation: path, digest and sizes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from splatwire.types import AnchorScene


@dataclass(frozen=True)
class PreparedStream:
    """Path, digest and sizes of an encoded stream, or of a scene file that is evaluated without transmission.

    Attributes:
        path: Path of the file within the store, or the user's path.
        digest: Digest of the file's content.
        parts: Bytes of each part of the file (attributes, headers, sections of side information).
        num_packets: Number of packets of the complete stream; 0 for a scene file.
        num_anchors: Number of elements of the scene, anchors or Gaussians.
        num_gaussians: Number of Gaussians; None if not counted.
        seconds_encode: Encoding time in seconds; None for a file that was not encoded here.
        elements: Name of the scene's elements, such as `anchors`.
    """

    path: str
    digest: str
    parts: Mapping[str, int]
    num_packets: int
    num_anchors: int
    num_gaussians: int | None = None
    seconds_encode: float | None = None
    elements: str = AnchorScene.ELEMENTS


def file_bytes(path: Path) -> int:
    """Returns the size of a file, or of all files of a folder, in bytes."""
    return sum(file.stat().st_size for file in ([path] if path.is_file() else path.rglob("*")) if file.is_file())
