"""Writer of glTF files that contain a stream, and a few Gaussians for programs that cannot read the stream."""

from pathlib import Path

from splatwire.anchors.appearance import explicit_gaussians
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.sections import sections_of
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.metadata import read_metadata
from splatwire.errors import InvalidValueError
from splatwire.io import open_scene
from splatwire.io.formats.gltf_writer import write_gltf
from splatwire.lod.merging import reduce_gaussians
from splatwire.types.splats import Splats

FALLBACK = 4096
"""Number of Gaussians (without harmonics) for programs that cannot read the embedded stream; they take 246 kB."""


def write_packed_gltf(stream: SceneStream, fallback: Splats, path: Path) -> None:
    """Writes a glTF file with a stream, and with a few Gaussians for programs that cannot read the stream.

    Args:
        stream: The stream.
        fallback: Gaussians for programs that cannot read the stream, see `fallback_of`.
        path: Path of the output file.
    """
    sections = sections_of(stream)
    write_gltf(
        [fallback], path, antialiased=ANTIALIASED in sections, origin=ORIGIN_SECTION.of_stream(stream),
        metadata=read_metadata(sections), stream=stream_to_bytes(stream),
    )  # fmt: skip


def fallback_of(path: Path) -> Splats:
    """Returns a coarse version of a stream's scene, for programs that cannot read the stream.

    Args:
        path: Path of the stream.

    Raises:
        InvalidValueError: If the stream does not contain explicit Gaussians.
    """
    splats = explicit_gaussians(open_scene(path, "grow"))
    if splats is None:
        raise InvalidValueError(f"{path}: its Gaussians depend on the view, and those of a glTF file do not")
    plain = splats.at_most_degree(0)
    return plain if plain.num_gaussians <= FALLBACK else reduce_gaussians(plain, FALLBACK)[0]
