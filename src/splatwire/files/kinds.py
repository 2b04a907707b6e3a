"""What a file or folder is, told by its first bytes, and what can be done with it: the one place that knows."""

import json
import lzma
import re
import stat
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_HEAD_BYTES = 1 << 16
_MAX_DIGITS = 20
_MAX_SAFETENSORS_HEADER = 1 << 22
_SPLAT_BYTES = 32
_SOG_SUFFIXES = (".sog", ".zip")


@dataclass(frozen=True)
class Kind:
    """A kind of file or folder.

    Attributes:
        key: Its short name, for programs.
        what: What it is, as a noun with its article.
        use: What can be done with it, as the rest of a sentence; empty where there is nothing to say.
    """

    key: str
    what: str
    use: str = ""

    def __str__(self) -> str:
        return f"{self.what}: {self.use}" if self.use else self.what


_VERBS = "`inspect`, `encode`, `render`, `export` and `evaluate`"
_EXPLICIT = f"`open_scene` reads it in Python, {_VERBS}, `import splats` and `train --init` in a shell"
NOTHING = Kind("nothing", "no such file or folder")
EMPTY = Kind("empty", "an empty file")
DEVICE = Kind("device", "a device, pipe or socket")
UNREADABLE = Kind("unreadable", "a file that cannot be read")
STREAM = Kind(
    "stream",
    "a stream of splatwire",
    "`read_stream` reads it in Python, `inspect`, `decode`, `transmit`, `serve` and `view` in a shell",
)
STREAM_GLB = Kind("stream glb", "a glTF file with a stream of splatwire", STREAM.use)
STREAM_FOLDER = Kind("stream folder", "a stream of splatwire as a folder", STREAM.use)
SCENE = Kind("scene", "a scene file of splatwire", f"`open_scene` reads it in Python, {_VERBS} in a shell")
PARTIAL = Kind(
    "partial scene",
    "a decoded scene with gaps",
    "`open_scene` with a concealer reads it in Python, `render`, `export` and `evaluate` in a shell",
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
SPZ = Kind("spz", "an SPZ file", _EXPLICIT)
SOG = Kind("sog", "a SOG file", _EXPLICIT)
SOG_FOLDER = Kind("sog folder", "a folder of SOG", _EXPLICIT)
SOG_META = Kind("sog meta", "the meta.json of a folder of SOG", _EXPLICIT)
SOG_LEVELS = Kind("streamed sog", "a streamed SOG with levels", _EXPLICIT)
GLB = Kind("glb", "a glTF file", "`import splats` reads it if it holds Gaussians")
GLTF = Kind("gltf", "a glTF document", GLB.use)
CAMERAS = Kind("cameras", "a cameras file", "it is for --cameras")
TRANSFORMS = Kind("transforms", "a list of camera poses", "--data takes the folder that it is in")
JSON = Kind("json", "a JSON file")
LFS = Kind("lfs", "a pointer of Git LFS, not the file itself", "fetch it with `git lfs pull`")
HTML = Kind("html", "an HTML page", "a download may have gone wrong")
TEXT = Kind("text", "a text file")
UNKNOWN = Kind("unknown", "of no kind that is known here")
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
HACPP = Kind("hacpp", "a model folder of HAC++ or Scaffold-GS", "`import hacpp` and `import scaffold` read it")
DATASET = Kind("dataset", "a folder of posed photos", "`train` reads it, and `--data` of other verbs")
PHOTOS = Kind(
    "photos",
    "a folder of photos without poses",
    "`ns-process-data images --data PHOTOS --output-dir SCENE` of nerfstudio finds them, or, with the photos in "
    "SCENE/images, `colmap automatic_reconstructor --image_path SCENE/images --workspace_path SCENE --dense 0`; then "
    "`splatwire train SCENE`",
)
EMPTY_FOLDER = Kind("empty folder", "an empty folder")
FOLDER = Kind("folder", "a folder without stream, model or dataset")
_GAUSSIANS = (SPLATS_PLY, COMPRESSED_PLY, SPZ, SOG, SOG_FOLDER, SPLAT, KSPLAT, GLB)
STREAMS = (STREAM, STREAM_GLB, STREAM_FOLDER)
"""What `read_stream` reads."""
SCENE_FILES = (SCENE, PARTIAL, TENSORS)
"""What may hold a scene of anchors; its reader says more of it."""
SOG_META_NAME, SOG_LEVELS_NAME = "meta.json", "lod-meta.json"
_BY_NAME = {SOG_META_NAME: SOG_META, SOG_LEVELS_NAME: SOG_LEVELS}
"""JSON files that only their names tell."""
_PICTURE_USE = "photos are read with their poses, as a dataset folder"
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
    (b"NGSP", SPZ),
    (b"\x4b\x67\0\0", SPLATV),
    (b"version https://git-lfs", LFS),
)
_OLD_TORCH = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."
"""First bytes of what `torch.save` wrote before release 1.6: a pickled number."""
_PLY = (b"ply\n", b"ply\r")
XZ_MAGIC = b"\xfd7zXZ\0"
_XZ_MEMORY_LIMIT = 80 << 20
_OF_SCENES = {
    ("splatwire-scene", "scene"): SCENE,
    ("splatwire-scene", "partial"): PARTIAL,
    ("splatwire-checkpoint", None): CHECKPOINT,
}
_CAMERAS_3DGS = (b'"position"', b'"rotation"', b'"fx"', b'"fy"')
_DATASET_NAMES = ("sparse", "colmap", "poses_enu.json", "transforms.json", "transforms_train.json")
_PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
_CONTROL = bytes(set(range(32)) - set(b"\t\n\r\f\x1b"))


def file_kind(path: Path) -> Kind:
    """Tells what lies at a path; whatever it is, this raises nothing, reads little and does not block."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            return _folder_kind(path)
        if not stat.S_ISREG(status.st_mode):
            return DEVICE
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
            (length,) = struct.unpack("<Q", head[:8]) if len(head) > 8 else (0,)
            if head[8:9] == b"{" and len(head) - 8 < length <= _MAX_SAFETENSORS_HEADER:
                head += file.read(length + 8 - len(head))
            if head.startswith(GLB_MAGIC):
                head += file.read(max(0, _glb_json_end(head) - len(head)))
    except (FileNotFoundError, NotADirectoryError):
        return NOTHING
    except (OSError, ValueError):
        return UNREADABLE
    kind = kind_of_bytes(head, status.st_size, path.suffix.lower())
    return _BY_NAME.get(path.name, kind) if kind == JSON else kind


def holds_frames(path: Path) -> bool:
    """Returns True for a `.splatv` file, and for a folder that is no scene itself and holds files of Gaussians."""
    kind = file_kind(path)
    if kind not in (FOLDER, PHOTOS, DATASET):
        return kind == SPLATV
    try:
        return any(file_kind(child) in _GAUSSIANS for child in path.iterdir())
    except OSError:
        return False


def trained_ply(folder: Path) -> Path | None:
    """Returns `point_cloud/iteration_N/point_cloud.ply` of a model folder, of the highest N; None without one."""
    found = {}
    for ply in folder.glob("point_cloud/iteration_*/point_cloud.ply"):
        number = ply.parent.name.removeprefix("iteration_")
        if number.isascii() and number.isdigit() and len(number) < _MAX_DIGITS and ply.is_file():
            found[int(number)] = ply
    return found[max(found)] if found else None


def is_not(path: Path, wanted: str, why: str = "") -> str:
    """The message of an error: what a path is not, and what it is instead.

    Args:
        path: The file or folder.
        wanted: What it should be, with its article.
        why: What told so, if there is something to say.
    """
    kind = file_kind(path)
    if kind == NOTHING:
        return f"{path}: {NOTHING}"
    return f"{path}: not {wanted}{f' ({why})' if why else ''}; it looks like {kind}"


def kind_of_bytes(head: bytes, size: int, suffix: str = "") -> Kind:
    """Tells what a file is.

    Args:
        head: Its first bytes.
        size: Its whole size, bytes.
        suffix: Suffix of its name; it decides for `.splat`, `.ksplat` and SOG, which have no mark of their own.
    """
    if not head:
        return EMPTY
    if head.startswith(XZ_MAGIC):
        inner = _unpacked_xz(head)
        return _ply_kind(inner) if inner.startswith(_PLY) else Kind("xz", "an xz archive")
    if head.startswith(_PLY):
        return _ply_kind(head)
    if head.startswith(GLB_MAGIC):
        return STREAM_GLB if f'"{EXT_SPLATWIRE}"'.encode() in head[20 : _glb_json_end(head)] else GLB
    for magic, kind in _MAGICS:
        if head.startswith(magic):
            return kind
    if head.startswith(b"PK\x03\x04"):
        if (torch := _torch_kind(head)) is not None:
            return torch
        return SOG if suffix in _SOG_SUFFIXES else Kind("zip", "a ZIP archive, as NumPy and SOG files are")
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return Kind("picture", "a WebP picture", _PICTURE_USE)
    if head[8:9] == b"{" and struct.unpack("<Q", head[:8])[0] < size:
        return _tensors_kind(head)
    if suffix == ".splat" and size % _SPLAT_BYTES == 0:
        return SPLAT
    if suffix == ".ksplat" and head[0] == 0:
        return KSPLAT
    kind = _weak_kind(head)
    return GLTF if suffix == ".gltf" and kind in (JSON, CAMERAS, TRANSFORMS) else kind


def _glb_json_end(head: bytes) -> int:
    """Where the document of a binary glTF ends, which tells whether a stream is in the file; 0 if it is absurd."""
    (size,) = struct.unpack("<I", head[12:16]) if len(head) >= 20 else (0,)
    return 20 + size if 0 < size <= MAX_GLB_JSON_BYTES else 0


def _torch_kind(head: bytes) -> Kind | None:
    """Kind of an archive of PyTorch, by its first entry's name and texts of its pickle; None for another archive."""
    (length,) = struct.unpack("<H", head[26:28]) if len(head) >= 28 else (0,)
    if not re.fullmatch(
        rb"[^/]+/(data\.pkl|data/\d+|constants\.pkl|version|byteorder|code/.*)", head[30 : 30 + length]
    ):
        return None
    if b"gauss_params" in head or b"_model." in head:
        return NERFSTUDIO_CHECKPOINT
    return GSPLAT_CHECKPOINT if b"splats" in head and b"means" in head else TORCH


def _weak_kind(head: bytes) -> Kind:
    """Kinds of which a file of numbers can have the first bytes by chance."""
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
    return UNKNOWN if head.translate(None, _CONTROL) != head or _not_text(head) else TEXT


def _not_text(head: bytes) -> bool:
    try:
        head[: _HEAD_BYTES // 2].decode("utf-8")
    except UnicodeDecodeError as error:
        return error.end < min(len(head), _HEAD_BYTES // 2) - 4  # else only the cut goes through a character
    return False


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
    names = {words[-1] for line in lines if (words := line.split()) and words[0] == b"property"}
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
    return GLTF if re.search(rb'"(accessors|bufferViews|extensionsUsed)"\s*:', plain) else JSON


def _folder_kind(folder: Path) -> Kind:
    try:
        names = {entry.name for entry in folder.iterdir()}
    except OSError:
        return UNREADABLE
    if not names:
        return EMPTY_FOLDER
    if SOG_META_NAME in names:
        return SOG_FOLDER
    if SOG_LEVELS_NAME in names:
        return SOG_LEVELS
    if "point_cloud" in names and (folder / "point_cloud").is_dir():
        ply = trained_ply(folder)
        return MODEL_3DGS if ply is not None and file_kind(ply) in (SPLATS_PLY, COMPRESSED_PLY) else HACPP
    if any(name in names for name in _DATASET_NAMES):
        return DATASET
    if names & {"manifest.json", "side_info.bin"} or any(name.endswith(".pak") for name in names):
        return STREAM_FOLDER
    inside = {entry.name for entry in (folder / "images").iterdir()} if (folder / "images").is_dir() else set()
    return PHOTOS if any(Path(name).suffix.lower() in _PHOTO_SUFFIXES for name in names | inside) else FOLDER
