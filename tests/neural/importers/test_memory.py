"""Model files never take more memory than their bytes allow."""

import struct
import zipfile
from pathlib import Path
from typing import Any

import pytest

from splat_io.formats.test_memory import MIB, bundled, peak, refused
from splatwire.neural.importers._hacpp_files import load_torch_file, load_voxel_size
from splatwire.neural.importers._torchscript import read_torchscript_weights
from tensor_files import text


def module(members: bytes) -> bytes:
    return b"c__torch__\nM\n)\x81}(" + members + b"ub"


def tensor(count: int, key: str = "0") -> bytes:
    number = b"J" + struct.pack("<i", count)
    storage = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text(key) + text("cpu") + number + b"tQ"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + b"K\x00" + number + b"\x85K\x01\x85\x89}tR"


def torchscript(path: Path, description: bytes, method: int = zipfile.ZIP_STORED, numbers: int = 1 << 18) -> Path:
    members = {"m/data.pkl": b"\x80\x02" + description + b".", "m/constants.pkl": b"", "m/data/0": bytes(4 * numbers)}
    return bundled(path, members, method)


def test_shared_tensor_storage_is_read_once(tmp_path: Path) -> None:
    description = module(b"".join(text(f"w{i}") + tensor(1 << 18) for i in range(60)))
    path = torchscript(tmp_path / "a.pt", description)
    found: dict[str, Any] = {}
    assert peak(lambda: found.update(read_torchscript_weights(path))) < 4 * path.stat().st_size
    assert len(found) == 60
    path = torchscript(tmp_path / "b.pt", description, zipfile.ZIP_DEFLATED, 12 * MIB)
    assert refused(path, "is packed, PyTorch stores it as it is", read_torchscript_weights) < 4 * MIB


def test_circular_modules_are_refused(tmp_path: Path) -> None:
    doubled = module(text("w") + tensor(1 << 18)) + b"q\x00"
    for level in range(1, 41):  # two paths from each module to the next: 2**40 names
        doubled += module(text("a") + b"h" + bytes([level - 1]) + text("b") + b"h" + bytes([level - 1]))
        doubled += b"q" + bytes([level])
    itself = b"c__torch__\nM\n)\x81q\x00}(" + text("x" * 900) + b"h\x00ub"
    for name, description in (("doubled.pt", doubled), ("itself.pt", itself)):
        path = torchscript(tmp_path / name, description, numbers=1 << 18)
        assert refused(path, "members of modules", read_torchscript_weights) < 16 * MIB


def test_torch_files_load_tensors_only(tmp_path: Path) -> None:
    """PyTorch's reader of plain tensors allocates a byte array of any size stated in a file of 60 bytes."""
    wanted = b"\x80\x02cbuiltins\nbytearray\nJ\x00\x00\x00\x10\x85R."
    members = {"archive/data.pkl": wanted, "archive/version": b"3\n", "archive/byteorder": b"little"}
    path = bundled(tmp_path / "checkpoint.pth", members)
    assert refused(path, "asks for builtins bytearray", load_torch_file) < 4 * MIB
    path = bundled(path, {**members, "archive/data.pkl": wanted + bytes(48 * MIB)}, zipfile.ZIP_DEFLATED)
    assert refused(path, "is packed", load_torch_file) < 4 * MIB


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
def test_oversized_voxel_size_file_is_refused(method: int, tmp_path: Path) -> None:
    (tmp_path / "bitstreams").mkdir()
    path = tmp_path / "bitstreams" / "xyz_gpcc.npz"
    bundled(path, {"voxel_size.npy": bytes(48 * MIB)}, method)
    assert refused(path, "no voxel size can be read", lambda _: load_voxel_size(tmp_path)) < 4 * MIB
