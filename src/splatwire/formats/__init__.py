"""Files of explicit Gaussians: a file a format, both directions, told by first bytes."""

from splatwire.formats.content import FileContent
from splatwire.formats.gltf_writer import write_gltf_with_stream
from splatwire.formats.kinds import (
    format_of,
    is_antialiased,
    read_all_rows,
    read_content,
    read_rows,
    read_splats,
    splats_kind,
    write_splats,
    writer_for,
)
from splatwire.formats.ply_note import PlyNote, read_note
from splatwire.formats.splatv import MovingSplats, read_splatv

__all__ = [
    "FileContent",
    "MovingSplats",
    "PlyNote",
    "format_of",
    "is_antialiased",
    "read_all_rows",
    "read_content",
    "read_note",
    "read_rows",
    "read_splats",
    "read_splatv",
    "splats_kind",
    "write_gltf_with_stream",
    "write_splats",
    "writer_for",
]
