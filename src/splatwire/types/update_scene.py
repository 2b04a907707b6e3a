"""Updates of a stream of Gaussians: the new Gaussians, and which of the stream's Gaussians are removed."""

from dataclasses import dataclass

from splatwire.reprs import summary_repr
from splatwire.types.splat_scene import SplatScene


@dataclass(frozen=True, eq=False)
class UpdateScene(SplatScene):
    """The new Gaussians of an update; drawing this scene shows these Gaussians only.

    Attributes:
        base_digest: SHA-256 of the manifest of the stream that the update changes, hexadecimal.
        result_digest: SHA-256 of the manifest of the changed stream, hexadecimal.
        writer: Program that wrote the changed stream, for its manifest.
        removed: Mask of removed Gaussians of the changed stream, serialised (`splatwire.codec.update.removed`).
    """

    base_digest: str = ""
    result_digest: str = ""
    writer: str = ""
    removed: bytes = b""

    __repr__ = summary_repr
