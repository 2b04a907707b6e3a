"""Detection of file and folder formats by their first bytes, with the operations available for each."""

import itertools
import json
import logging
import lzma
import os
import re
import stat
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

from splatwire.errors import ACCESS_ADVICE
from splatwire.files.atomic_write import is_unfinished
from splatwire.files.colmap_folders import reconstructions
from splatwire.files.opened import OpenedFile
from splatwire.files.scene_formats import FORMATS, FileFormat

_LOG = logging.getLogger(__name__)
_HEAD_BYTES = 1 << 16
_MAX_DIGITS = 20
_MAX_PARENTS, _MAX_FOLDERS, _MAX_ENTRIES = 3, 32, 4096
"""Limits of `folder_nearby`: number of parents of a path, of folders searched in a folder, and of entries read per
folder.
"""
_MAX_SAFETENSORS_HEADER = 1 << 22
_SPLAT_BYTES = 32
_POINT_CLOUD, _TRAINED_PLY = "point_cloud", "point_cloud.ply"
"""Names of 3DGS in a model folder."""
_ANCHOR_FILES = ("checkpoint.pth", "checkpoints.pth", "point_cloud.ply.xz")
"""Names of files of HAC++ and Scaffold-GS in the folder of an iteration."""
_SOG_SUFFIXES = (".sog", ".zip")
_USDZ_SUFFIX = ".usdz"


@dataclass(frozen=True)
class Kind:
    """Detected format of a file or folder.

    Attributes:
        key: Short identifier.
        description: Description with its article, such as `a PLY file`, for messages.
        use: Advice on what to do with files of this format, for the end of error messages. Empty if there is none.
    """

    key: str
    description: str
    use: str = ""

    def __str__(self) -> str:
        return f"{self.description}: {self.use}" if self.use else self.description


_EXPLICIT = (
    "`encode` makes a stream of it; `inspect`, `render`, `export`, `evaluate`, `import splats` and `train --init` read "
    "it, in Python `open_scene`"
)
UNFINISHED = Kind(
    "unfinished",
    "an output folder that a writer is filling, or did not finish",
    "it is completed when a program of splatwire writes into it; or remove it and write it again",
)
NOTHING = Kind("nothing", "no such file or folder")
EMPTY = Kind("empty", "an empty file")
DEVICE = Kind("device", "a device, pipe or socket")
UNREADABLE = Kind("unreadable", "a file that cannot be read")
STREAM = Kind(
    "stream",
    "a stream of splatwire",
    "`inspect`, `decode`, `transmit`, `serve` and `view` read it, in Python `read_stream`",
)
STREAM_GLB = Kind("stream glb", "a glTF file with a stream of splatwire", STREAM.use)
STREAM_FOLDER = Kind("stream folder", "a stream of splatwire as a folder", STREAM.use)
SCENE = Kind(
    "scene",
    "a scene file of splatwire",
    "`encode` makes a stream of it; `inspect`, `render`, `export` and `evaluate` read it, in Python `open_scene`",
)
PARTIAL = Kind(
    "partial scene",
    "a decoded scene with gaps",
    "`render`, `export` and `evaluate` read it, in Python `open_scene` with a concealer",
)
CHECKPOINT = Kind("checkpoint", "the checkpoint of a training run", "`train --resume` goes on from it")
TENSORS = Kind("safetensors", "a safetensors file that is neither scene nor checkpoint")
SPLATS_PLY = Kind("ply", "a 3DGS PLY", _EXPLICIT)
ANCHORS_PLY = Kind(
    "anchors ply", "a PLY of anchors", "`import scaffold` and `import hacpp` read the model folder it is in"
)
COMPRESSED_PLY = Kind("compressed ply", "a compressed PLY", _EXPLICIT)
OTHER_PLY = Kind("other ply", "a PLY file without Gaussians")
SPLAT = Kind("splat", "a .splat file", _EXPLICIT)
KSPLAT = Kind("ksplat", "a .ksplat file", _EXPLICIT)
SPLATV = Kind("splatv", "a .splatv file of Gaussians that move", "`encode` makes a clip of it")
FOURDGS = Kind("4dgs", "a .4dgs file of Gaussians that move", SPLATV.use)
SPLAT4D = Kind("splat4d", "a .splat4d file of Gaussians that move", SPLATV.use)
SEQUENCE_FILES = (SPLATV, FOURDGS, SPLAT4D)
"""Files with all frames of a sequence."""
SPZ = Kind("spz", "an SPZ file", _EXPLICIT)
SOG = Kind("sog", "a SOG file", _EXPLICIT)
SOG_FOLDER = Kind("sog folder", "a folder of SOG", _EXPLICIT)
SOG_META = Kind("sog meta", "the meta.json of a folder of SOG", _EXPLICIT)
SOG_LEVELS = Kind("streamed sog", "a streamed SOG with levels", _EXPLICIT)
GLB = Kind("glb", "a glTF file", "`import splats` reads it if it holds Gaussians")
GLTF = Kind("gltf", "a glTF document", GLB.use)
USD = Kind("usd", "an OpenUSD scene", _EXPLICIT)
CAMERAS = Kind("cameras", "a cameras file", "it is for --cameras")
TRANSFORMS = Kind("transforms", "a list of camera poses", "--data takes the folder that it is in")
TILESET = Kind(
    "tileset", "a tileset of 3D Tiles", "such files are written, not read; each of its tiles (.glb) can be read"
)
JSON = Kind("json", "a JSON file")
LFS = Kind("lfs", "a pointer of Git LFS, not the file itself", "fetch it with `git lfs pull`")
HTML = Kind("html", "an HTML page", "a download may have gone wrong")
TEXT = Kind("text", "a text file")
UNKNOWN = Kind("unknown", "a file of an unknown format")
PYTORCH = "a PyTorch file, which is a pickle and never opened, because it could run any program"
GSPLAT_CHECKPOINT = Kind(
    "gsplat checkpoint",
    f"a checkpoint of gsplat ({PYTORCH})",
    "write its Gaussians as PLY with `gsplat.export_splats`, or train with `simple_trainer.py ... --save_ply`",
)
NERFSTUDIO_CHECKPOINT = Kind(
    "nerfstudio checkpoint",
    f"a checkpoint of nerfstudio ({PYTORCH})",
    "`ns-export gaussian-splat --load-config config.yml --output-dir FOLDER` writes its Gaussians as PLY",
)
TORCH = Kind(
    "pytorch",
    PYTORCH,
    "write Gaussians as PLY with the program that trained them; 3DGS has point_cloud/iteration_*/point_cloud.ply",
)
PICKLE = Kind("pickle", "a pickle, which is never opened, because it could run any program", TORCH.use)
MODEL_3DGS = Kind("3dgs", "a model folder of 3DGS", f"{_EXPLICIT} (the PLY of the last iteration)")
GSPLAT_RESULTS = Kind(
    "gsplat results",
    "a results folder of gsplat",
    f"its ply/point_cloud_*.ply is read, its checkpoints are pickles and never opened; {GSPLAT_CHECKPOINT.use}",
)
GSPLAT_COMPRESSED = Kind(
    "gsplat compressed",
    "a folder of PNG images that gsplat compressed (`PngCompression`), which is not read",
    GSPLAT_CHECKPOINT.use,
)
NERFSTUDIO_RESULTS = Kind("nerfstudio results", "a results folder of nerfstudio", NERFSTUDIO_CHECKPOINT.use)
WITHOUT_GAUSSIANS = Kind(
    "no gaussians",
    "a model folder without Gaussians",
    "the file point_cloud/iteration_NUMBER/point_cloud.ply of 3DGS is read, which is missing or has no Gaussians",
)
HACPP = Kind("hacpp", "a model folder of HAC++ or Scaffold-GS", "`import hacpp` and `import scaffold` read it")
DATASET = Kind("dataset", "a folder of posed photos", "`train` reads it, and `--data` of other verbs")
PHOTOS = Kind(
    "photos",
    "a folder of photos without poses",
    "`ns-process-data images --data PHOTOS --output-dir SCENE` of nerfstudio finds them, or, with the photos in "
    "SCENE/images, `colmap automatic_reconstructor --image_path SCENE/images --workspace_path SCENE --dense 0`; then "
    "`splatwire train SCENE`",
)
FRAMES = Kind("frames", "a folder of files of Gaussians", "name one of them, or `encode` makes a clip of them")
EMPTY_FOLDER = Kind("empty folder", "an empty folder")
FOLDER = Kind("folder", "a folder without stream, model or dataset")
_CERTAIN = (EMPTY, DEVICE, UNREADABLE, UNKNOWN, EMPTY_FOLDER, FOLDER, UNFINISHED)
"""Kinds that are certain, not inferred from the content: messages use "is" instead of "looks like"."""
_GAUSSIANS = (SPLATS_PLY, COMPRESSED_PLY, SPZ, SOG, SOG_FOLDER, SPLAT, KSPLAT, GLB, USD)
STREAMS = (STREAM, STREAM_GLB, STREAM_FOLDER)
"""Formats accepted by `read_stream`."""
SCENE_FILES = (SCENE, PARTIAL, TENSORS)
"""Formats of scene files of neural anchors; the reader of the file determines the exact format."""
SOG_META_NAME, SOG_LEVELS_NAME = "meta.json", "lod-meta.json"
_BY_NAME = {SOG_META_NAME: SOG_META, SOG_LEVELS_NAME: SOG_LEVELS}
"""JSON file formats that are identified by the file name."""
_PICTURE_USE = "photos are read with their poses, as a dataset folder"
_HEIF_BRANDS = (b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif", b"avis")
GLB_MAGIC, EXT_SPLATWIRE, MAX_GLB_JSON_BYTES = b"glTF", "EXT_splatwire", 4 << 20
_MAGICS: tuple[tuple[bytes, Kind], ...] = (
    (b"\x93SWZ", STREAM),
    (b"\x89PNG\r\n\x1a\n", Kind("picture", "a PNG picture", _PICTURE_USE)),
    (b"\xff\xd8\xff", Kind("picture", "a JPEG picture", _PICTURE_USE)),
    (b"GIF8", Kind("picture", "a GIF picture", _PICTURE_USE)),
    (b"II*\0", Kind("picture", "a TIFF picture", _PICTURE_USE)),
    (b"MM\0*", Kind("picture", "a TIFF picture", _PICTURE_USE)),
    (b"7z\xbc\xaf\x27\x1c", Kind("7z", "a 7-Zip archive")),
    (b"\x28\xb5\x2f\xfd", Kind("zstd", "a Zstandard archive")),
    (b"\x93NUMPY", Kind("npy", "a NumPy array")),
    (b"PAR1", Kind("parquet", "a Parquet table")),
    (b"%PDF", Kind("pdf", "a PDF document")),
    (b"\x894DGS1\r\n", FOURDGS),
    (b"SP4D", SPLAT4D),
    (b"PXR-USDC", USD),
    (b"#usda ", USD),
    (b"NGSP", SPZ),
    (b"\x4b\x67\0\0", SPLATV),
    (b"version https://git-lfs", LFS),
)
_OLD_TORCH = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."
"""First bytes of `torch.save` files from before release 1.6: a pickled number."""
_PLY = re.compile(rb"ply[ \t]*[\r\n]")
_KSPLAT_HEADER = struct.Struct("<BB2xIIIIH")
_KSPLAT_USED_BYTES, _KSPLAT_BYTES = 44, 4096
"""Used bytes of the header of a `.ksplat` file, and size of the header."""
_KSPLAT_LEVELS, _KSPLAT_MINORS, _KSPLAT_SECTIONS = 3, 10, 4096
"""Compression levels, minor versions and maximum number of sections."""
XZ_MAGIC = b"\xfd7zXZ\0"
_XZ_MEMORY_LIMIT = 80 << 20
_OF_SCENES = {
    ("splatwire-scene", "scene"): SCENE,
    ("splatwire-scene", "partial"): PARTIAL,
    ("splatwire-checkpoint", None): CHECKPOINT,
}
_CAMERAS_3DGS = (b'"position"', b'"rotation"', b'"fx"', b'"fy"')
_DATASET_NAMES = ("sparse", "colmap", "poses_enu.json", "transforms.json", "transforms_train.json")
GAUSSIAN_SUFFIXES = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb", ".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of files of explicit Gaussians."""
_RESULTS = {"ckpts": GSPLAT_RESULTS, "nerfstudio_models": NERFSTUDIO_RESULTS}
"""Results folders of training programs, by the name of the folder of their checkpoints."""
_PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
_CONTROL = bytes(set(range(32)) - set(b"\t\n\r\f\x1b"))


def file_kind(path: Path) -> Kind:
    """Detects the format of a file or folder; never raises and does not block."""
    if isinstance(path, OpenedFile) and path.kind is not None:
        return path.kind
    kind, file = _detect(path)
    if file is not None:
        file.close()
    return kind


@contextmanager
def opened(path: Path) -> Iterator[Path]:
    """Context manager that opens a file and detects its format, so that all later readers use the same open file.

    Never raises and does not block. A path that cannot be opened is yielded unopened.

    Args:
        path: File or folder.

    Yields:
        The path, as an `OpenedFile`.
    """
    if isinstance(path, OpenedFile) and path.kind is not None:
        yield path
        return
    source = OpenedFile(path)
    source.attach(*_detect(path))
    try:
        yield source
    finally:
        source.detach()


def _detect(path: Path) -> tuple[Kind, BufferedReader | None]:
    """Opens a file and detects the format; a folder is not opened.

    Returns:
        Two values: the format, and the open file. The file is None for a folder, a device, or a path that cannot be
        read.
    """
    file = None
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            return _folder_kind(path), None
        if not stat.S_ISREG(status.st_mode):
            return DEVICE, None
        file = path.open("rb")
        head = file.read(_HEAD_BYTES)
        (length,) = struct.unpack("<Q", head[:8]) if len(head) > 8 else (0,)
        if head[8:9] == b"{" and len(head) - 8 < length <= _MAX_SAFETENSORS_HEADER:
            head += file.read(length + 8 - len(head))
        if head.startswith(GLB_MAGIC):
            head += file.read(max(0, _glb_json_end(head) - len(head)))
    except (FileNotFoundError, NotADirectoryError):
        return NOTHING, None
    except (OSError, ValueError):
        if file is not None:
            file.close()
        return UNREADABLE, None
    suffix = path.suffix.lower()
    kind = _built_in_kind(head, status.st_size, suffix)
    kind = _BY_NAME[path.name] if kind == JSON and path.name in _BY_NAME else _plugin_kind(kind, head, suffix)
    return kind, file


def trained_ply(folder: Path) -> Path | None:
    """Returns the PLY of the last iteration in a 3DGS model folder; None if the folder contains no such file.

    The path of the file is `point_cloud/iteration_N/point_cloud.ply`. `folder` may also be `point_cloud`, or an
    `iteration_N` in it.
    """
    if _iteration(folder) is not None:
        return ply if (ply := folder / _TRAINED_PLY).is_file() else None
    for parent in (folder / _POINT_CLOUD, folder):
        iterations = {}
        for iteration in parent.glob("iteration_*"):
            if (number := _iteration(iteration)) is not None and (iteration / _TRAINED_PLY).is_file():
                iterations[number] = iteration / _TRAINED_PLY
        if iterations:
            return iterations[max(iterations)]
    return None


def last_iteration(model: Path) -> Path | None:
    """Returns the folder `point_cloud/iteration_N` of a model folder with the highest N; None without such a folder."""
    folders = {
        number: folder
        for folder in (model / _POINT_CLOUD).glob("iteration_*")
        if (number := _iteration(folder)) is not None and folder.is_dir()
    }
    return folders[max(folders)] if folders else None


def _contains_anchors(folder: Path) -> bool:
    """True if an iteration of a model folder has files of HAC++ or Scaffold-GS: networks, or a PLY of anchors."""
    for iteration in (folder / _POINT_CLOUD).glob("iteration_*"):
        if any((iteration / name).is_file() for name in _ANCHOR_FILES) or any(iteration.glob("*_mlp.pt")):
            return True
        if (ply := iteration / _TRAINED_PLY).is_file() and file_kind(ply) == ANCHORS_PLY:
            return True
    return False


def _iteration(folder: Path) -> int | None:
    """Returns N for the folder `iteration_N` of a trained model, or None for any other folder name."""
    number = folder.name.removeprefix("iteration_")
    is_number = number != folder.name and number.isascii() and number.isdigit() and len(number) < _MAX_DIGITS
    return int(number) if is_number else None


def format_error(path: Path, wanted: str, why: str = "") -> str:
    """Returns the error message for a file of a wrong format, with the expected and the detected format.

    Args:
        path: The file or folder.
        wanted: Description of the expected format, which begins with "a" or "an".
        why: Reason for the rejection, added in brackets; may be empty.
    """
    kind = file_kind(path)
    if kind == NOTHING:
        return f"{path}: {NOTHING}"
    if kind == UNREADABLE and (reason := _access_problem(path)):
        return f"{path}: cannot be read: {reason}"
    if why and kind.description == wanted:
        return f"{path}: looks like {wanted}, but {why}"
    verb = "is" if kind in _CERTAIN else "looks like"
    return f"{path}: not {wanted}{f' ({why})' if why else ''}; it {verb} {kind}"


def _access_problem(path: Path) -> str:
    """Returns the reason why a file or folder cannot be opened, with advice; empty if it can."""
    try:
        if path.is_dir():
            next(path.iterdir(), None)
        else:
            path.open("rb").close()
    except PermissionError as error:
        return f"{error.strerror}{ACCESS_ADVICE}"
    except OSError as error:
        return error.strerror or str(error)
    except ValueError:  # a path with a zero byte
        return ""
    return ""


def model_nearby(path: Path, *kinds: Kind) -> str:
    """Returns a hint for an error message: the path of a suitable model folder above or below a rejected path.

    The hint is empty if no such folder is found.

    Args:
        path: File or folder that was rejected.
        *kinds: Any number of kinds of model folders that are accepted.
    """
    nearby = folder_nearby(path, lambda folder: folder != path and file_kind(folder) in kinds)
    return "" if nearby is None else f"; {nearby} looks like {file_kind(nearby).description}"


def folder_nearby(path: Path, accepts: Callable[[Path], bool]) -> Path | None:
    """Finds the folder that a user probably meant by a path.

    Searches the parents of the path, and folders up to two levels below.

    Args:
        path: File or folder that was rejected.
        accepts: Function that returns True for a folder of the expected kind.

    Returns:
        The folder; None if none is accepted.
    """
    if file_kind(path) in (NOTHING, UNREADABLE):
        return None
    try:
        inside = _folders(path)
        parents = list(path.absolute().parents)[:_MAX_PARENTS]
        deeper = (child for folder in inside for child in _folders(folder))
        return next((folder for folder in (*parents, *inside, *deeper) if accepts(folder)), None)
    except OSError:
        return None


def _folders(path: Path) -> list[Path]:
    """Returns the folders in a folder, sorted, without links; empty for a file."""
    if not path.is_dir():
        return []
    entries = itertools.islice(os.scandir(path), _MAX_ENTRIES)
    names = sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
    return [path / name for name in names[:_MAX_FOLDERS]]


def kind_of_bytes(head: bytes, size: int, suffix: str = "") -> Kind:
    """Detects the format of a file from its first bytes.

    Args:
        head: First bytes of the file.
        size: Size of the file, bytes.
        suffix: Suffix of the file name, for formats without a magic number of their own (`.splat`, `.ksplat`, SOG,
            `.usdz`).
    """
    return _plugin_kind(_built_in_kind(head, size, suffix), head, suffix)


def kind_of_format(file_format: FileFormat) -> Kind:
    """Returns the kind of file for a scene format that another package has registered."""
    return Kind(file_format.name, file_format.description, _EXPLICIT if file_format.scene_type is None else SCENE.use)


def _plugin_kind(kind: Kind, head: bytes, suffix: str) -> Kind:
    """Detects file formats that other installed packages have registered.

    The packages are not consulted about empty files, or about kinds whose error message already names a way to use them
    (`Kind.use`).

    Args:
        kind: Result of the built-in detection.
        head: First bytes of the file.
        suffix: Suffix of the file name.

    Returns:
        The format that a package recognises; `kind` if no package recognises the file.
    """
    if kind.use or kind == EMPTY:
        return kind
    for form in FORMATS.all().values():
        if form.recognises is not None and _recognised(form, head, suffix):
            return kind_of_format(form)
    return kind


def _recognised(file_format: FileFormat, head: bytes, suffix: str) -> bool:
    assert file_format.recognises is not None
    try:
        return bool(file_format.recognises(head[:_HEAD_BYTES], suffix))
    except Exception as error:  # code of another package may raise anything
        _LOG.warning(
            "file format '%s'%s cannot look at a file: %r",
            file_format.name,
            FORMATS.provider_suffix(file_format.name),
            error,
        )
        return False


def _built_in_kind(head: bytes, size: int, suffix: str) -> Kind:
    if not head:
        return EMPTY
    if head.startswith(XZ_MAGIC):
        inner = _unpacked_xz(head)
        return _ply_kind(inner) if _PLY.match(inner) else Kind("xz", "an xz archive")
    if _PLY.match(head):
        return _ply_kind(head)
    if head.startswith(GLB_MAGIC):
        return STREAM_GLB if f'"{EXT_SPLATWIRE}"'.encode() in head[20 : _glb_json_end(head)] else GLB
    for magic, kind in _MAGICS:
        if head.startswith(magic):
            return kind
    if head.startswith(b"PK\x03\x04"):
        if (torch := _torch_kind(head)) is not None:
            return torch
        if suffix == _USDZ_SUFFIX:
            return USD
        return SOG if suffix in _SOG_SUFFIXES else Kind("zip", "a ZIP archive, as NumPy and SOG files are")
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return Kind("picture", "a WebP picture", _PICTURE_USE)
    if head[4:8] == b"ftyp" and head[8:12] in _HEIF_BRANDS:
        return Kind("picture", "a HEIC or AVIF picture", "convert it to JPEG or PNG")
    if head[8:9] == b"{" and struct.unpack("<Q", head[:8])[0] < size:
        return _tensors_kind(head)
    if (suffix == ".ksplat" and head[0] == 0) or _has_ksplat_header(head):
        return KSPLAT
    kind = _weak_kind(head)
    if suffix == ".splat" and not _is_text(head) and (kind == UNKNOWN or (kind != SPZ and size % _SPLAT_BYTES == 0)):
        return SPLAT  # its reader names the size of a file that is cut within a row
    return GLTF if suffix == ".gltf" and kind in (JSON, CAMERAS, TRANSFORMS) else kind


def _has_ksplat_header(head: bytes) -> bool:
    """True if a file begins like a `.ksplat` file; the name of the file does not matter.

    The format has no signature. Therefore the 4,052 unused bytes of the header must be 0, and the fields in its other
    bytes must have plausible values.
    """
    if len(head) <= _KSPLAT_BYTES or any(head[_KSPLAT_USED_BYTES:_KSPLAT_BYTES]):
        return False
    major, minor, max_sections, sections, _, count, level = _KSPLAT_HEADER.unpack_from(head)
    # GaussForge writes 0 as the number of sections
    plausible = sections <= max_sections and 0 < max_sections <= _KSPLAT_SECTIONS and count > 0
    return major == 0 and 0 < minor < _KSPLAT_MINORS and level < _KSPLAT_LEVELS and plausible


def _glb_json_end(head: bytes) -> int:
    """Returns the byte offset of the end of a binary glTF file's JSON chunk.

    The offset is 0 if the size in the chunk's header is implausible.
    """
    (size,) = struct.unpack("<I", head[12:16]) if len(head) >= 20 else (0,)
    return 20 + size if 0 < size <= MAX_GLB_JSON_BYTES else 0


def _torch_kind(head: bytes) -> Kind | None:
    """Detects the kind of a PyTorch archive from the first bytes of a file; returns None for any other file."""
    (length,) = struct.unpack("<H", head[26:28]) if len(head) >= 28 else (0,)
    if not re.fullmatch(
        rb"[^/]+/(data\.pkl|data/\d+|constants\.pkl|version|byteorder|code/.*)", head[30 : 30 + length]
    ):
        return None
    if b"gauss_params" in head or b"_model." in head:
        return NERFSTUDIO_CHECKPOINT
    return GSPLAT_CHECKPOINT if b"splats" in head and b"means" in head else TORCH


def _weak_kind(head: bytes) -> Kind:
    """Detects formats without a reliable signature."""
    if head.startswith(b"\x1f\x8b"):
        return SPZ if _unpacked(head).startswith(b"NGSP") else Kind("gzip", "a gzip archive")
    if re.match(rb"\x80[\x02-\x05]", head):
        return TORCH if head.startswith(_OLD_TORCH) else PICKLE
    if head.startswith(b"BM"):
        return Kind("picture", "a BMP picture", _PICTURE_USE)
    plain = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if plain[:1] in (b"{", b"["):
        return _json_kind(plain)
    if re.match(rb"<(!doctype html|html|head)", plain[:16], re.IGNORECASE):
        return HTML
    return TEXT if _is_text(head) else UNKNOWN


def _is_text(head: bytes) -> bool:
    if head.translate(None, _CONTROL) != head:
        return False
    try:
        head[: _HEAD_BYTES // 2].decode("utf-8")
    except UnicodeDecodeError as error:
        return error.end >= min(len(head), _HEAD_BYTES // 2) - 4  # the error may be a character cut at the end
    return True


def _unpacked(head: bytes) -> bytes:
    try:
        return zlib.decompressobj(31).decompress(head, 16)
    except zlib.error:
        return b""


def _unpacked_xz(head: bytes) -> bytes:
    try:
        decoder = lzma.LZMADecompressor(format=lzma.FORMAT_XZ, memlimit=_XZ_MEMORY_LIMIT)
        return decoder.decompress(head, _HEAD_BYTES)
    except (lzma.LZMAError, EOFError):
        return b""


def _ply_kind(head: bytes) -> Kind:
    lines = head.partition(b"end_header")[0].splitlines()
    properties = {words[-1] for line in lines if (words := line.split()) and words[0] == b"property"}
    names = {re.sub(rb"^(?:scalar_)?(?:scal_)?", b"", name) for name in properties}  # prefixes of CloudCompare
    if b"f_anchor_feat_0" in names:
        return ANCHORS_PLY
    if b"packed_position" in names:
        return COMPRESSED_PLY
    return SPLATS_PLY if {b"scale_0", b"rot_0", b"opacity"} <= names else OTHER_PLY


def _tensors_kind(head: bytes) -> Kind:
    (length,) = struct.unpack("<Q", head[:8])
    content = _parsed(head[8 : 8 + length])
    entry = content.get("__metadata__", {}) if isinstance(content, dict) else {}
    text = entry.get("splatwire") if isinstance(entry, dict) else None
    header = _parsed(text.encode("utf-8", "replace")) if isinstance(text, str) else None
    if not isinstance(header, dict):
        return TENSORS
    for key in ((header.get("format"), header.get("kind")), (header.get("format"), None)):
        if all(part is None or isinstance(part, str) for part in key) and key in _OF_SCENES:
            return _OF_SCENES[key]
    return TENSORS


def _parsed(data: bytes) -> Any:
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


def _json_kind(plain: bytes) -> Kind:
    if re.search(rb'"splatwire-cameras"|"w2c"\s*:', plain) or all(key in plain for key in _CAMERAS_3DGS):
        return CAMERAS
    if re.search(rb'"(frames|camera_angle_x|poses)"\s*:', plain):
        return TRANSFORMS
    if re.search(rb'"geometricError"\s*:', plain):
        return TILESET
    return GLTF if re.search(rb'"(accessors|bufferViews|extensionsUsed)"\s*:', plain) else JSON


def _folder_kind(folder: Path) -> Kind:
    try:
        names = {entry.name for entry in folder.iterdir()}
    except OSError:
        return UNREADABLE
    if not names:
        return EMPTY_FOLDER
    if is_unfinished(folder):
        return UNFINISHED
    if SOG_META_NAME in names:
        return GSPLAT_COMPRESSED if "means_l.png" in names and "means_l.webp" not in names else SOG_FOLDER
    if SOG_LEVELS_NAME in names:
        return SOG_LEVELS
    if (ply := trained_ply(folder)) is not None and file_kind(ply) in (SPLATS_PLY, COMPRESSED_PLY):
        return MODEL_3DGS
    if _POINT_CLOUD in names and (folder / _POINT_CLOUD).is_dir():
        return HACPP if _contains_anchors(folder) else WITHOUT_GAUSSIANS
    if any(name in names for name in _DATASET_NAMES):
        return DATASET
    if names & {"manifest.json", "side_info.bin"} or any(name.endswith(".pak") for name in names):
        return STREAM_FOLDER
    if contains_photos(folder):
        return DATASET if any(reconstructions(folder)) else PHOTOS
    if any(Path(name).suffix.lower() in GAUSSIAN_SUFFIXES for name in names):
        return FRAMES
    return next((kind for name, kind in _RESULTS.items() if name in names or folder.name == name), FOLDER)


def contains_photos(folder: Path) -> bool:
    """True if there are photos in a folder or in its subfolder `images`.

    Raises:
        OSError: If the folder cannot be listed.
    """
    images = folder / "images"
    entries = (entry for parent in (folder, images) if parent.is_dir() for entry in parent.iterdir())
    return any(entry.suffix.lower() in _PHOTO_SUFFIXES for entry in entries)
