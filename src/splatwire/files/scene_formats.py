"""Registry of scene file formats, open to installed packages (docs/your-own-format.md)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from splatwire.lazy_names import renamed_attributes
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
            (up to 65,536) and the suffix of the file name in lower case (`.spz`). It is called for files
            about which splatwire has no advice of its own (`Kind.use` is empty): of unknown formats, and, for example,
            text, JSON, archives, NumPy arrays and PLYs without Gaussians. None for built-in formats.
        read: Function that reads a file. Without `scene_type`, it returns `splatwire.io.formats.FileContent` or
            `splatwire.types.splats.Splats`. With `scene_type`, it returns a scene of that type. None for write-only
            formats.
        write: Function that writes a file and returns the number of Gaussians. Without `scene_type`, its arguments are
            batches of Gaussians (`Splats`, all of one degree), the path, and keyword arguments in `write_options`. With
            `scene_type`, its arguments are a scene and the path. None for read-only formats.
        scene_type: Type of the scenes in such files; None for explicit Gaussians.
        ending: File name extension without the first dot; `name` if empty.
        write_options: Names of the optional keyword arguments of `write`. `antialiased`, `origin`, `metadata` and
            `steps` (quantisation steps) are scene properties that the format can store. `outliers` (`clamp`, `prune` or
            `keep`) is the treatment of distant Gaussians, for formats in which they reduce the precision of all others.
        kinds: Results of format detection (`splatwire.files.kinds.file_kind`) for the files that are given to `read`,
            which may reject some of them with a message of its own, such as a PLY without Gaussians.
    """

    name: str
    description: str
    recognises: Callable[[bytes, str], bool] | None = None
    read: Callable[..., Any] | None = None
    write: Callable[..., Any] | None = None
    scene_type: type | None = None
    ending: str = ""
    write_options: frozenset[str] = frozenset()
    kinds: tuple["Kind", ...] = ()

    __getattr__ = renamed_attributes("FileFormat", {"keeps": "write_options"})

    @property
    def suffix(self) -> str:
        """File name extension with its first dot."""
        return f".{self.ending or self.name}"


FORMATS: Registry[FileFormat] = Registry("file format", "splatwire.file_formats")
