"""Exchange of files with PlayCanvas's splat-transform, where node and that package are installed.

Run `npm install @playcanvas/splat-transform` in any folder and set SPLATWIRE_NODE_MODULES to its `node_modules`.
"""

import json
import os
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from close import assert_close
from splat_io.formats.handmade import some_splats
from splat_io.formats.test_sog import first_version
from splatwire.io.formats import read_splats, write_splats
from splatwire.io.formats._axes import SPZ_FLIPS, flip_axes
from splatwire.io.formats.spz_writer import FEWER_BITS, write_spz
from splatwire.ops.quaternions import rotation_matrices
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow


def _convert(source: Path, target: Path, *options: str) -> None:
    modules = os.environ.get("SPLATWIRE_NODE_MODULES")
    program = Path(modules or "") / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
    if shutil.which("node") is None or modules is None or not program.is_file():
        pytest.skip("needs node, and SPLATWIRE_NODE_MODULES with @playcanvas/splat-transform")
    command = ["node", str(program), "-q", "-w", "-g", "cpu", *options, str(source), str(target)]
    subprocess.run(command, check=True, capture_output=True, timeout=600)


def _in_their_axes(splats: Splats, end: str) -> Splats:
    """Gaussians as they are after an exchange of a file: from release 3 on, SPZ has the axes of a PLY there."""
    package = Path(os.environ["SPLATWIRE_NODE_MODULES"]) / "@playcanvas" / "splat-transform" / "package.json"
    release = int(json.loads(package.read_text())["version"].partition(".")[0])
    return flip_axes(splats, SPZ_FLIPS) if end == ".spz" and release >= 3 else splats


def _directions(splats: Splats) -> np.ndarray:
    """Rotations up to the signs of the axes, which have no visible effect."""
    axes = rotation_matrices(splats.quats)
    return axes * np.array([0.0, 0.5, 1.0], np.float32) @ axes.swapaxes(1, 2)


def _compare(one: Splats, two: Splats, size: float, color: float) -> None:
    one, two = (splats.select(splats.means[:, 0].argsort()) for splats in (one, two))
    assert one.degree == two.degree
    assert_close(one.means, two.means, atol=6e-3, rtol=1e-4)
    assert_close(np.log(one.scales), np.log(two.scales), atol=size, rtol=0)
    assert_close(one.opacities, two.opacities, atol=5e-3, rtol=0)
    assert_close(one.sh, two.sh, atol=color, rtol=0)
    assert_close(_directions(one), _directions(two), atol=0.02, rtol=0)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize(
    ("end", "options", "size", "color"),
    [
        (".spz", ("--spz-version", "3"), 0.04, 0.08),  # harmonics have 5 bits, then 4
        (".spz", ("--spz-version", "4"), 0.04, 0.08),
        (".compressed.ply", (), 4e-3, 0.02),
        (".sog", (), 0.1, 0.1),
        (".glb", (), 1e-5, 1e-5),
    ],
)
def test_files_of_splat_transform_are_read(
    end: str, options: tuple[str, ...], size: float, color: float, degree: int, tmp_path: Path
) -> None:
    splats = some_splats(300, degree)
    splats.sh[:, 1:] = splats.sh[np.arange(300) % 20, 1:]  # SOG searches for repeated vectors
    write_splats([splats], tmp_path / "a.ply")
    _convert(tmp_path / "a.ply", tmp_path / f"b{end}", *options)
    _compare(read_splats(tmp_path / f"b{end}"), _in_their_axes(splats, end), size, color)


@pytest.mark.parametrize("degree", [0, 3])
def test_gltf_equals_that_of_splat_transform(degree: int, tmp_path: Path) -> None:
    """splat-transform writes such files and does not read them."""
    write_splats([some_splats(300, degree)], tmp_path / "a.ply")
    write_splats([some_splats(300, degree)], tmp_path / "a.glb")
    _convert(tmp_path / "a.ply", tmp_path / "b.glb")
    _compare(read_splats(tmp_path / "a.glb"), read_splats(tmp_path / "b.glb"), 1e-5, 1e-5)
    ours, theirs = (_document(tmp_path / name) for name in ("a.glb", "b.glb"))
    assert ours["meshes"] == theirs["meshes"]
    assert ours["extensionsUsed"] == theirs["extensionsUsed"]


@pytest.mark.parametrize("degree", [0, 3])
def test_spz_with_fewer_bits_equals_splat_transform(degree: int, tmp_path: Path) -> None:
    write_splats([some_splats(300, degree)], tmp_path / "a.ply")
    _convert(tmp_path / "a.ply", tmp_path / "b.spz", "--spz-version", "3")
    write_spz([_in_their_axes(some_splats(300, degree), ".spz")], tmp_path / "a.spz", FEWER_BITS)
    ours, theirs = (read_splats(tmp_path / name) for name in ("a.spz", "b.spz"))
    ours, theirs = (splats.select(splats.means[:, 0].argsort()) for splats in (ours, theirs))
    # ties may round either way, and clipped ranges end at 255 or at the last multiple
    assert (
        float((ours.sh[:, 1:] != theirs.sh[:, 1:]).astype(np.float64).mean()) < 0.02
        if degree
        else ours.sh.shape[1] == 1
    )


@pytest.mark.parametrize(("degree", "palette"), [(0, 0), (2, 20)])
def test_sog_version_1_equals_splat_transform(degree: int, palette: int, tmp_path: Path) -> None:
    splats = some_splats(300, degree)
    for name, data in first_version(splats, palette).items():
        (tmp_path / name).write_bytes(data)
    _convert(tmp_path / "meta.json", tmp_path / "b.ply")
    _compare(read_splats(tmp_path / "b.ply"), read_splats(tmp_path / "meta.json"), 1e-4, 1e-3)


def _document(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    content = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    assert isinstance(content, dict)
    return content


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("end", [".spz", ".compressed.ply", ".sog", ".ply"])
def test_splat_transform_reads_written_files(end: str, degree: int, tmp_path: Path) -> None:
    """splat-transform and splatwire read the same values from a written file."""
    write_splats([some_splats(300, degree)], tmp_path / f"a{end}")
    _convert(tmp_path / f"a{end}", tmp_path / "b.ply")
    _compare(read_splats(tmp_path / "b.ply"), _in_their_axes(read_splats(tmp_path / f"a{end}"), end), 1e-4, 1e-3)
