"""Registry of scene file formats, open to installed packages (`splatwire.plugins`, docs/your-own-format.md).

`splatwire.io.formats` implements and registers the built-in formats.
"""

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
        what: Description of such a file with its article, such as `an SPZ file`, for messages.
        recognises: Called with the first bytes of a file (up to 65,536) and the suffix of its name in lower case
            (`.spz`); returns True for a file of this format. Only called for files of no other known format. None for
            built-in formats, which `splatwire.files.kinds` detects.
        read: Function that reads all Gaussians of a file into `splatwire.io.formats.FileContent` or
            `splatwire.types.splats.Splats`; with `scene_type`, into a scene of that type. None for write-only formats.
        write: Function that writes Gaussians, and returns their number. Called with batches of Gaussians (at least one
            `Splats`, all of one degree), the path, and those properties in `keeps` that have a value. With
            `scene_type`, called with a scene and the path. None for read-only formats.
        scene_type: Type of the scenes in such files; None for explicit Gaussians.
        ending: File name extension without the first dot; `name` if empty.
        keeps: Names of scene properties that `write` accepts as keywords: `antialiased`, `origin`, `metadata`, `note`.
            The name `outliers` means that one distant Gaussian makes all quantisation steps of the format larger.
        kinds: Keys of the detected kinds of files (`splatwire.files.kinds.Kind.key`) that have this format.
    """

    name: str
    what: str
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
