"""Registry of scene file formats, open to installed packages (docs/your-own-format.md)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from splatwire.plugins import Registry

if TYPE_CHECKING:
    from splatwire.files.kinds import Kind


@dataclass(frozen=True, eq=False)
class FileFormat:
    """A file format for scenes.

    Attributes:
        name: Name in messages and in `splatwire export`, such as `spz`.
        description: Description of such a file with its article, such as `an SPZ file`, for messages.
        recognises: Function that returns True for a file of this format. Its arguments are the first bytes of the file
            (up to 65,536) and the suffix of the file name in lower case (`.spz`). It is called only for files of which
            no built-in format is known. None for built-in formats.
        read: Function that reads a file into `splatwire.io.formats.FileContent` or `splatwire.types.splats.Splats`;
            with `scene_type`, into a scene of that type. None for write-only formats.
        write: Function that writes a file and returns the number of Gaussians. Its arguments are batches of Gaussians
            (`Splats`, all of one degree), the path, and the properties in `keeps`; with `scene_type`, a scene and the
            path. None for read-only formats.
        scene_type: Type of the scenes in such files; None for explicit Gaussians.
        ending: File name extension without the first dot; `name` if empty.
        keeps: Names of scene properties that `write` accepts as keywords: `antialiased`, `origin`, `metadata`, `note`;
            `outliers` if distant Gaussians reduce the precision of all others in this format.
        kinds: Keys of the detected kinds of files (`splatwire.files.kinds.Kind.key`) that have this format.
    """

    name: str
    description: str
    recognises: Callable[[bytes, str], bool] | None = None
    read: Callable[..., Any] | None = None
    write: Callable[..., Any] | None = None
    scene_type: type | None = None
    ending: str = ""
    keeps: frozenset[str] = frozenset()
    kinds: tuple["Kind", ...] = ()

    @property
    def suffix(self) -> str:
        """File name extension with its first dot."""
        return f".{self.ending or self.name}"


FORMATS: Registry[FileFormat] = Registry("file format", "splatwire.file_formats")
