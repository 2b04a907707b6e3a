"""Invisible and invalid rows in files of other programs, in every format."""

import logging
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import assert_close
from splat_io.formats.handmade import glb, ksplat, legacy_spz, some_splats, write
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.io.formats import read_rows, read_splats, write_splats
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

COLUMNS = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "rot_0", "rot_1", "rot_2", "rot_3")
COLUMNS += ("scale_0", "scale_1", "scale_2")
ROW = {**dict.fromkeys(COLUMNS, 0.0), "rot_0": 1.0, "scale_0": -3.0, "scale_1": -3.0, "scale_2": -3.0}


def transform_ply(*changes: dict[str, float]) -> bytes:
    """A PLY in the layout of splat-transform 2.7 (no normals, rotation before scale), one row per change."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(changes)}"]
    lines += [*(f"property float {name}" for name in COLUMNS), "end_header\n"]
    rows = np.array([[{**ROW, "x": float(i), **change}[name] for name in COLUMNS] for i, change in enumerate(changes)])
    return "\n".join(lines).encode() + rows.astype("<f4").tobytes()


INF, NAN = float("inf"), float("nan")


def test_alphas_0_and_255_of_splat_transform_are_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """splat-transform writes the logit of a byte, which is infinite for 0 and 255."""
    path = write(tmp_path / "a.ply", transform_ply({"opacity": INF}, {"opacity": -INF}, {}, {"opacity": 200.0}))
    with caplog.at_level(logging.INFO, "splatwire"):
        splats = read_splats(path)
    assert splats.opacities.tolist() == [1, 0.5, 1]
    assert splats.means[:, 0].tolist() == [0, 2, 3]
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [
        ("INFO", f"{path}: 1 of 4 Gaussians draw nothing and are left out")
    ]
    stream = encode_scene(SplatScene(splats))
    assert decode_stream(stream).scene.splats.opacities.max() > 0.999


BROKEN = {
    "a place that is no number": {"y": NAN},
    "a place without end": {"z": -INF},
    "a colour that is no number": {"f_dc_1": NAN},
    "a colour beyond float32": {"f_dc_2": 3e38},
    "an opacity that is no number": {"opacity": NAN},
    "a rotation without direction": {"rot_0": 0.0},
    "a rotation that is no number": {"rot_3": NAN},
    "a size without end": {"scale_1": INF},
    "an absurd size": {"scale_2": 1000.0},
    "a size that is no number": {"scale_0": NAN},
}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"y": NAN}, "positions"),
        ({"f_dc_1": INF}, "harmonics"),
        ({"opacity": NAN}, "opacities"),
        ({"rot_0": 0.0}, "rotations"),
        ({"scale_1": INF}, "scales"),
    ],
)
def test_a_file_without_valid_gaussians_is_refused_with_the_invalid_attribute(
    change: dict[str, float], field: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.ply", transform_ply(change, change))
    with pytest.raises(DatasetError, match=rf"2 cannot be drawn \(invalid: {field}\)$"):
        read_splats(path)


@pytest.mark.parametrize("length", [1e-10, 1e-6, 1e3, 1e30])
def test_rotations_of_any_length_are_normalised(length: float, tmp_path: Path) -> None:
    turned = {"rot_0": 0.6 * length, "rot_2": 0.8 * length}
    splats = read_splats(write(tmp_path / "a.ply", transform_ply(turned)))
    assert_close(splats.quats, np.array([[0.6, 0, 0.8, 0]], np.float32))


@pytest.mark.parametrize("name", BROKEN)
def test_undrawable_gaussians_are_left_out_with_a_warning(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "a.ply", transform_ply({}, {}, BROKEN[name], {}, BROKEN[name]))
    splats = read_splats(path)
    assert splats.means.tolist() == [[0, 0, 0], [1, 0, 0], [3, 0, 0]]
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [
        ("WARNING", f"{path}: 2 of 5 Gaussians cannot be drawn and are left out (the first is row 2)")
    ]


def test_zero_and_negative_zero_sizes_are_kept(tmp_path: Path) -> None:
    """A flat disk and a point are valid Gaussians and are coded as very thin ones."""
    flat, point = {"scale_2": -INF}, {f"scale_{i}": -INF for i in range(3)}
    rows = ({}, flat, point, {"x": -0.0, "rot_1": -0.0, "opacity": -0.0}, {"scale_0": -500.0})
    splats = read_splats(write(tmp_path / "a.ply", transform_ply(*rows)))
    assert splats.num_gaussians == len(rows)
    assert bool((splats.scales > 0).all())
    scene = SplatScene(splats)
    decoded = decode_stream(encode_scene(scene)).scene
    cameras = surrounding_cameras(scene, 2, 32)
    for picture, other in zip(render_scene(scene, cameras), render_scene(decoded, cameras), strict=True):
        assert bool(np.isfinite(picture).all())
        assert_close(other, picture, atol=0.1, rtol=0)


def test_only_a_file_without_drawable_gaussians_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.ply", transform_ply({"x": NAN}, {"opacity": -INF}, {"opacity": -INF}))
    with pytest.raises(DatasetError, match=r"a\.ply: none of its 3 Gaussians is left: 2 draw nothing, 1 cannot be dr"):
        read_splats(path)


def test_the_file_of_an_empty_frame_is_an_empty_scene(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path / "a.ply", transform_ply({"opacity": -INF}))
    scene = SplatScene(read_splats(path))
    assert "its only Gaussian is transparent: the scene is empty" in caplog.text
    assert not np.any(render_scene(scene, surrounding_cameras(scene, 1, 32)))


def _splat(path: Path) -> Path:
    good = struct.pack("<6f8B", 1, 2, 3, 0.1, 0.2, 0.3, 255, 128, 0, 51, 255, 128, 128, 128)
    no_place, negative = struct.pack("<f", NAN) + good[4:], good[:12] + struct.pack("<f", -1) + good[16:]
    no_rotation, invisible = good[:28] + b"\x80" * 4, good[:27] + b"\0" + good[28:]
    return write(path, good + invisible + no_place + negative + no_rotation)


def _sog(path: Path) -> Path:
    """Two Gaussians have an invalid index of the largest rotation component, one more has an opacity of 0."""
    import io
    import zipfile

    from PIL import Image

    splats = some_splats(5, 0)
    splats.opacities[2] = 0
    write_splats([splats], path)
    with zipfile.ZipFile(path) as bundle:
        files = {name: bundle.read(name) for name in bundle.namelist()}
    pixels = np.array(Image.open(io.BytesIO(files["quats.webp"])).convert("RGBA"))
    alpha = np.array(Image.open(io.BytesIO(files["sh0.webp"])).convert("RGBA")).reshape(-1, 4)[:5, 3]
    pixels.reshape(-1, 4)[np.flatnonzero(alpha)[-2:], 3] = 7
    packed = io.BytesIO()
    Image.fromarray(pixels).save(packed, "WEBP", lossless=True, exact=True)
    with zipfile.ZipFile(path, "w") as bundle:
        for name, data in {**files, "quats.webp": packed.getvalue()}.items():
            bundle.writestr(name, data)
    return path


def _compressed(path: Path) -> Path:
    """The bounds of one of 256 chunks are NaN, as from a program that included NaN rows."""
    splats = some_splats(300, 0)
    splats.opacities[:3] = 0
    write_splats([splats], path)
    head, body = path.read_bytes().split(b"end_header\n", 1)
    at = 72  # bounds of the second chunk: least x
    return write(path, head + b"end_header\n" + body[:at] + struct.pack("<f", NAN) + body[at + 4 :])


def _glb(path: Path) -> Path:
    splats = some_splats(6, 1)
    splats.opacities[:3] = np.array([0.0, -0.0, 1.5], np.float32)
    splats.means[3, 0] = NAN
    splats.scales[4, 0] = -1
    splats.quats[5] = 0
    return write(path, glb(splats))


def _ksplat(path: Path) -> Path:
    data = bytearray(ksplat(0, 0))
    rows = len(data) - 3 * 44
    data[rows + 43] = 0  # the alpha of the first
    struct.pack_into("<f", data, rows + 44, NAN)
    return write(path, bytes(data))


FILES: dict[str, tuple[Callable[[Path], Path], int, int, int]] = {
    ".splat": (_splat, 1, 1, 3),
    ".spz": (lambda path: write(path, legacy_spz(3)), 1, 1, 0),
    ".sog": (_sog, 2, 1, 2),
    ".compressed.ply": (_compressed, 254, 2, 44),
    ".glb": (_glb, 1, 2, 3),
    ".ksplat": (_ksplat, 1, 1, 1),
}
"""A file, and the numbers of its kept, invisible and invalid rows."""


@pytest.mark.parametrize("end", FILES)
def test_every_format_leaves_out_the_same_gaussians(end: str, tmp_path: Path) -> None:
    make, kept, invisible, invalid = FILES[end]
    path = make(tmp_path / f"a{end}")
    every, validity = read_rows(path)
    assert (int(validity.kept.sum()), validity.num_invisible, validity.num_invalid) == (kept, invisible, invalid)
    splats = read_splats(path)
    assert splats.num_gaussians == kept
    assert all(np.array_equal(getattr(splats, name), value[validity.kept]) for name, value in vars(every).items())
    _usable(splats)


def _usable(splats: Splats) -> None:
    """Encodes and renders the remaining Gaussians without invalid numbers."""
    scene = SplatScene(splats)
    encode_scene(scene)
    assert all(bool(np.isfinite(p).all()) for p in render_scene(scene, surrounding_cameras(scene, 2, 16)))


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "splat", "spz", "sog", "glb"])
def test_invalid_gaussians_are_not_written(tmp_path: Path, suffix: str) -> None:
    """Logits as opacities would otherwise become 0 or 1 without a word."""
    path, splats = tmp_path / f"a.{suffix}", some_splats(40, degree=0)
    for name, what, value in (("opacities", "opacities", 3.0), ("quats", "rotations", 0.0), ("scales", "scales", 0.0),
                              ("sh", "harmonics", NAN), ("means", "positions", INF)):  # fmt: skip
        values = getattr(splats, name).copy()
        values[7] = value
        with pytest.raises(InvalidValueError, match=f"{what} of Gaussians are invalid \\(the first is row 27\\)"):
            write_splats([splats.slice_range(0, 20), replace(splats, **{name: values})], path)
        assert not path.exists()


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "splat", "spz", "sog", "glb"])
@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_rotations_of_any_length_are_written_as_equal_bytes(tmp_path: Path, suffix: str, factor: float) -> None:
    splats = some_splats(40, degree=0)
    unit = replace(splats, quats=splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True))
    write_splats([unit], tmp_path / f"a.{suffix}")
    write_splats([replace(unit, quats=unit.quats * np.float32(factor))], tmp_path / f"b.{suffix}")
    expected, found = (read_splats(tmp_path / f"{name}.{suffix}") for name in "ab")
    for name, values in vars(expected).items():
        assert_close(getattr(found, name), values, rtol=0, atol=1e-5)
