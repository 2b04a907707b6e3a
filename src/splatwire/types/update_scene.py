"""Data type for a change of a scene of Gaussians: which Gaussians are removed, and which are new."""

from dataclasses import dataclass

from splatwire.reprs import summary_repr
from splatwire.types.splat_scene import SplatScene


@dataclass(frozen=True, eq=False)
class UpdateScene(SplatScene):
    """Difference between two versions of a scene.

    The elements of this object are the new Gaussians. `removed` lists the Gaussians that no longer exist.

    Attributes:
        base_digest: SHA-256 of the manifest of the stream before the update, hexadecimal.
        result_digest: SHA-256 of the manifest of the stream after the update, hexadecimal.
        writer: Name of the program that wrote the stream after the update, as in the manifest of this stream.
        removed: Encoded mask of the Gaussians of the earlier version that the update removes.
    """

    base_digest: str = ""
    result_digest: str = ""
    writer: str = ""
    removed: bytes = b""

    __repr__ = summary_repr
