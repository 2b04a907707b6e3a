"""SPZ of every version, with extensions."""

import dataclasses
import gzip
import itertools
import logging
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import assert_close, unit
from random_numbers import Numbers
from splat_io.formats.handmade import legacy_spz, modern_spz, ply, some_splats, write
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.mmap_array import LARGE_BYTES, large_empty
from splatwire.io.formats import read_rows, read_splats, write_splats
from splatwire.io.formats._axes import flip_axes
from splatwire.io.formats._files import FileBytes
from splatwire.io.formats.spz_writer import write_spz
from splatwire.ops.quaternions import rotation_matrices
from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.types.splats import Splats

FRAMES = [
    *(x + y + z for z, y, x in itertools.product("BF", "DU", "LR")),
    *(x + y + z for y, z, x in itertools.product("FB", "DU", "LR")),
]
"""Coordinate systems in the order of the extension's codes, from 1."""
RIGHT, DOWN, FORWARD = (1, 0, 0), (0, 1, 0), (0, 0, 1)
MEANING = {"R": RIGHT, "D": DOWN, "F": FORWARD} | {
    name: tuple(-v for v in axis) for name, axis in (("L", RIGHT), ("U", DOWN), ("B", FORWARD))
}


def extended(data: bytes, *records: tuple[int, bytes]) -> bytes:
    """SPZ of version 4 with extension records."""
    block = b"".join(struct.pack("<II", kind, len(content)) + content for kind, content in records)
    head = bytearray(data[:32])
    head[14] |= 2
    struct.pack_into("<I", head, 16, 32 + len(block))
    return bytes(head) + block + data[32:]


def every_row(path: Path) -> Splats:
    """All Gaussians of a file, including those without opacity."""
    return read_rows(path)[0]


def covariances(splats: Splats) -> np.ndarray:
    axes = rotation_matrices(splats.quats.astype(np.float64)) * splats.scales.astype(np.float64)[:, None, :]
    return axes @ axes.swapaxes(1, 2)


def colours(splats: Splats, directions: np.ndarray) -> np.ndarray:
    """Colour of each Gaussian in some directions, (directions, Gaussians, 3)."""
    return np.einsum("kd,gdc->kgc", sh_basis(directions, splats.degree), splats.sh.astype(np.float64))


@pytest.mark.parametrize("frame", FRAMES)
def test_named_coordinate_system_is_converted(frame: str, tmp_path: Path) -> None:
    write_splats([some_splats(40)], tmp_path / "a.spz")
    stored = flip_axes(read_splats(tmp_path / "a.spz"), (1.0, -1.0, -1.0))  # numbers as stored in the file
    code = struct.pack("<I", FRAMES.index(frame) + 1)
    path = write(tmp_path / "b.spz", extended((tmp_path / "a.spz").read_bytes(), (0xADBE0003, code)))
    found = read_splats(path)
    matrix = np.array([MEANING[letter] for letter in frame]).astype(np.float64).T
    assert_close(found.means.astype(np.float64), stored.means.astype(np.float64) @ matrix.T)
    expected = matrix @ covariances(stored) @ matrix.T
    assert_close(covariances(found), expected, atol=1e-7, rtol=1e-5)
    directions = unit(Numbers(1).randn(9, 3))
    directions = directions.astype(np.float64)
    assert_close(colours(found, directions), colours(stored, directions @ matrix), atol=1e-5, rtol=1e-5)


def test_coordinate_systems_equal_those_of_the_extension() -> None:
    # the numbers of the reference software since May 2026
    codes = {1: "LDB", 4: "RUB", 6: "RDF", 7: "LUF", 8: "RUF", 9: "LFD", 10: "RFD", 11: "LFU", 12: "RFU", 13: "LBD"}
    codes |= {14: "RBD", 15: "LBU", 16: "RBU"}
    assert {code: FRAMES[code - 1] for code in codes} == codes


def test_unspecified_coordinate_system_is_the_default(tmp_path: Path) -> None:
    data = modern_spz(legacy_spz(3))
    plain = every_row(write(tmp_path / "a.spz", data))
    found = every_row(write(tmp_path / "b.spz", extended(data, (0xADBE0003, bytes(4)))))
    assert np.array_equal(found.means, plain.means)


@pytest.mark.parametrize("content", [struct.pack("<I", 17), b"\7", bytes(5)])
def test_unknown_coordinate_system_is_refused(content: bytes, tmp_path: Path) -> None:
    path = write(tmp_path / "a.spz", extended(modern_spz(legacy_spz(3)), (0xADBE0003, content)))
    with pytest.raises(DatasetError, match="SPZ_ADOBE_coordinate_system"):
        every_row(path)


def test_coordinate_system_after_version_3_columns_is_converted(tmp_path: Path) -> None:
    raw = bytearray(gzip.decompress(legacy_spz(3)))
    raw[14] |= 2
    raw += struct.pack("<III", 0xADBE0003, 4, 6)  # RDF
    found = every_row(write(tmp_path / "a.spz", gzip.compress(bytes(raw))))
    assert found.means.tolist() == [[1, 2, 3], [-1, -2, -3]]


def test_unknown_extensions_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path / "a.spz", extended(modern_spz(legacy_spz(3)), (0x12340001, b"abc")))
    with caplog.at_level(logging.WARNING):
        assert every_row(path).num_gaussians == 2
    assert "0x12340001 of 3 bytes" in caplog.text


def test_known_extensions_give_no_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    orbit = struct.pack("<3f", -0.5, 0.5, 1)
    path = write(tmp_path / "a.spz", extended(modern_spz(legacy_spz(3)), (0xADBE0002, orbit)))
    with caplog.at_level(logging.WARNING):
        assert every_row(path).num_gaussians == 2
    assert not caplog.records


@pytest.mark.parametrize(
    "block",
    [b"\1\2\3", struct.pack("<II", 0x12340001, 99), struct.pack("<IIB", 0, 1, 5), struct.pack("<IIII", 7, 0, 7, 0)],
)
def test_damaged_extensions_are_refused(block: bytes, tmp_path: Path) -> None:
    data = bytearray(extended(modern_spz(legacy_spz(3))))
    struct.pack_into("<I", data, 16, 32 + len(block))
    with pytest.raises(DatasetError, match="extension"):
        every_row(write(tmp_path / "a.spz", bytes(data[:32]) + block + bytes(data[32:])))


def test_version_3_extensions_that_are_there_twice_are_refused(tmp_path: Path) -> None:
    raw = bytearray(gzip.decompress(legacy_spz(3)))
    raw[14] |= 2
    raw += struct.pack("<III", 0xADBE0003, 4, 6) + struct.pack("<III", 0xADBE0003, 4, 1)
    with pytest.raises(DatasetError, match="extension 0xADBE0003 is there twice"):
        every_row(write(tmp_path / "a.spz", gzip.compress(bytes(raw))))


def test_version_3_extensions_without_sizes_are_ignored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    raw = bytearray(gzip.decompress(legacy_spz(3)))
    raw[14] |= 2
    raw += struct.pack("<I3f", 0xADBE0002, -0.5, 0.5, 1)
    with caplog.at_level(logging.WARNING):
        assert every_row(write(tmp_path / "a.spz", gzip.compress(bytes(raw)))).num_gaussians == 2
    assert "extensions are left out" in caplog.text


def test_unknown_flags_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = bytearray(modern_spz(legacy_spz(3)))
    data[14] = 0x10
    with caplog.at_level(logging.WARNING):
        every_row(write(tmp_path / "a.spz", bytes(data)))
    assert "flags 0x10" in caplog.text


def test_embedded_coarser_levels_are_refused(tmp_path: Path) -> None:
    raw = bytearray(gzip.decompress(legacy_spz(3)))
    raw[14] = 0x80
    with pytest.raises(DatasetError, match="levels"):
        every_row(write(tmp_path / "a.spz", gzip.compress(bytes(raw))))


def test_positions_of_version_1_are_in_half_precision(tmp_path: Path) -> None:
    raw = gzip.decompress(legacy_spz(2))
    positions = np.array([[1, 2, 3], [-1, -2, -3.5]], "<f2").tobytes()
    raw = raw[:4] + struct.pack("<I", 1) + raw[8:16] + positions + raw[16 + 18 :]
    found = every_row(write(tmp_path / "a.spz", gzip.compress(raw)))
    second = every_row(write(tmp_path / "b.spz", legacy_spz(2)))
    assert found.means.tolist() == [[1, -2, -3], [-1, 2, 3.5]]
    assert np.array_equal(found.sh, second.sh)
    assert np.array_equal(found.quats, second.quats)


@pytest.mark.parametrize("make", [lambda data: data, modern_spz])
def test_degree_4_is_read_up_to_degree_3(make: object, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert callable(make)
    with caplog.at_level(logging.WARNING):
        found = every_row(write(tmp_path / "a.spz", make(legacy_spz(3, degree=4))))
    three = every_row(write(tmp_path / "b.spz", legacy_spz(3, degree=3)))
    assert np.array_equal(found.sh, three.sh)
    assert "27 of 75 coefficients" in caplog.text


def test_degree_4_of_a_ply_is_read_up_to_degree_3(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(0)
    names = ["x", "y", "z", "opacity", *(f"{word}_{n}" for word, count in
             (("f_dc", 3), ("scale", 3), ("rot", 4), ("f_rest", 72)) for n in range(count))]  # fmt: skip
    rows = np.zeros(5, [(name, "f4") for name in names])
    for name in names:
        rows[name] = rng.normal(size=5)
    with caplog.at_level(logging.WARNING):
        found = read_splats(write(tmp_path / "a.ply", ply("binary_little_endian", {"vertex": rows})))
    assert found.degree == 3
    for channel, k in ((0, 0), (1, 7), (2, 14)):
        assert np.array_equal(found.sh[:, 1 + k, channel], rows[f"f_rest_{24 * channel + k}"])
    assert "27 of 75 coefficients" in caplog.text


@pytest.mark.parametrize("version", [3, 4])
def test_both_versions_hold_the_same_numbers(version: int, tmp_path: Path) -> None:
    splats = some_splats(50)
    write_spz([splats], tmp_path / "a.spz", version=version, antialiased=True)
    write_spz([splats], tmp_path / "b.spz", version=7 - version, antialiased=True)
    data = (tmp_path / "a.spz").read_bytes()
    plain = gzip.decompress(data) if version == 3 else data
    assert struct.unpack_from("<4sII", plain) == (b"NGSP", version, 50)
    assert plain[14] == 1
    one, two = (read_splats(tmp_path / name) for name in ("a.spz", "b.spz"))
    for field in dataclasses.fields(Splats):
        assert np.array_equal(getattr(one, field.name), getattr(two, field.name))


def test_damaged_columns_of_version_4_are_never_read_as_other_numbers(tmp_path: Path) -> None:
    """Each zstd stream has a checksum."""
    splats, read = some_splats(40), []
    write_spz([splats], tmp_path / "a.spz")
    data, intact = (tmp_path / "a.spz").read_bytes(), read_splats(tmp_path / "a.spz")
    columns, table = struct.unpack_from("<B", data, 15)[0], struct.unpack_from("<I", data, 16)[0]
    for at in range(table + 16 * columns, len(data), 7):
        damaged = bytearray(data)
        damaged[at] ^= 1 << at % 8
        path = write(tmp_path / "b.spz", bytes(damaged))
        try:
            read.append(read_splats(path))
        except DatasetError:
            continue
    assert len(read) < 20
    for one in read:
        for field in dataclasses.fields(Splats):
            assert np.array_equal(getattr(one, field.name), getattr(intact, field.name))


def test_other_versions_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match="version 3 or 4"):
        write_spz([some_splats(5)], tmp_path / "a.spz", version=2)


@pytest.mark.parametrize("version", [3, 4])
def test_records_that_the_flags_do_not_name_give_a_warning(
    version: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record = struct.pack("<III", 0xADBE0003, 4, 6)
    if version == 3:
        data = gzip.compress(gzip.decompress(legacy_spz(3)) + record)
    else:
        unflagged = bytearray(extended(modern_spz(legacy_spz(3)), (0xADBE0003, record[8:])))
        unflagged[14] &= ~2
        data = bytes(unflagged)
    assert every_row(write(tmp_path / "a.spz", data)).num_gaussians == 2
    assert "12 bytes may be extensions, but its flags name none" in caplog.text


def test_a_cut_file_is_named_as_cut(tmp_path: Path) -> None:
    path = write(tmp_path / "a.spz", modern_spz(legacy_spz(3))[:-1])
    with pytest.raises(DatasetError, match="is cut: stream sh has"):
        every_row(path)


@pytest.mark.parametrize("size", [1e-1, 1e-3, 1e-4])
def test_small_scenes_keep_their_positions(size: float, tmp_path: Path) -> None:
    splats = some_splats(200, 0)
    small = replace(splats, means=splats.means * np.float32(size))
    write_splats([small], tmp_path / "a.spz")
    found = read_splats(tmp_path / "a.spz")
    assert_close(found.means, small.means, atol=size / 500)


@pytest.mark.parametrize(("size", "offset", "keeps"), [(0.01, 3, True), (0.01, 1000, False), (1e-5, 0.5, False)])
def test_small_scenes_off_the_origin_keep_their_positions_or_give_a_warning(
    size: float, offset: float, keeps: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """With 12 fraction bits, positions were rounded to steps as large as the Gaussians, without a word."""
    splats = some_splats(200, 0)
    means = np.float32(size) * splats.means / np.abs(splats.means).max() + np.float32(offset)
    splats = replace(splats, means=means, scales=np.full_like(splats.scales, size / 30))
    write_splats([splats], tmp_path / "small.spz")
    error = np.abs(read_splats(tmp_path / "small.spz").means - splats.means).max()
    assert (error < size / 30 / 8) == keeps
    assert ("move the scene to the origin" in caplog.text) != keeps


def test_warning_of_gaussians_too_small_for_any_step_gives_no_advice_to_move(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(200, 0)
    write_splats([replace(splats, scales=np.full_like(splats.scales, 1e-30))], tmp_path / "a.spz")
    (warning,) = caplog.messages
    assert "scales of 200 of 200 Gaussians are outside of" in warning
    assert "give the scene another size first" in warning


@pytest.mark.parametrize("size", [1e-1, 1e-4, 1e-6, 1e-9])
def test_a_compressed_ply_keeps_the_positions_of_small_scenes(size: float, tmp_path: Path) -> None:
    splats = some_splats(200, 0)
    small = replace(splats, means=splats.means * np.float32(size), scales=splats.scales * np.float32(size))
    write_splats([small], tmp_path / "a.compressed.ply")
    found = read_splats(tmp_path / "a.compressed.ply")
    order = found.means[:, 0].argsort(), small.means[:, 0].argsort()
    assert_close(found.means[order[0], 0], small.means[order[1], 0], atol=size / 200)


@pytest.mark.parametrize("factor", [1e-10, 1e12])
def test_scales_beyond_a_compressed_ply_give_a_warning(
    factor: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(200, 0)
    write_splats([replace(splats, scales=splats.scales * np.float32([1, 1, 1e-20]))], tmp_path / "a.compressed.ply")
    assert not caplog.messages
    write_splats([replace(splats, scales=splats.scales * np.float32(factor))], tmp_path / "a.compressed.ply")
    assert "of 200 Gaussians are outside of 2.1e-09 to 4.85e+08, the range of this format" in caplog.text


def test_a_few_gaussians_that_stay_invisible_give_no_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats = some_splats(200, 0)
    tiny = np.float32(np.where(np.arange(200)[:, None] == 7, 1e-9, 1))
    write_splats([replace(splats, scales=splats.scales * tiny)], tmp_path / "a.spz")
    assert not caplog.messages


@pytest.mark.parametrize(("factor", "problem"), [(1e-4, "outside of 4.5e-05 to 379"), (1e5, "of 200 Gaussians")])
def test_scales_beyond_the_range_give_a_warning(
    factor: float, problem: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(200, 0)
    write_splats([replace(splats, scales=splats.scales * np.float32([1, 1, 1e-20]))], tmp_path / "flat.spz")
    assert not caplog.messages
    write_splats([replace(splats, scales=splats.scales * np.float32(factor))], tmp_path / "a.spz")
    assert problem in caplog.text


@pytest.mark.parametrize("size", [10_000, LARGE_BYTES + 5])
def test_a_file_that_is_truncated_while_it_is_read_does_not_end_the_process(size, tmp_path):
    """Access to the pages of a mapped file would end it."""
    path = tmp_path / "frame.spz"
    with path.open("wb") as file:
        file.truncate(size)
    code = (
        "import sys\nfrom pathlib import Path\nfrom splatwire.errors import DatasetError\n"
        "from splatwire.io.formats._files import FileBytes\n"
        "path = Path(sys.argv[1])\ndata = FileBytes(path)\nbefore = data[:]\npath.open('wb').close()\n"
        f"assert len(before) == len(data) == {size} and not any(before[-100:])\n"
        "try:\n    data[100:200]\nexcept DatasetError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"{path}: was truncated while it was read\n"), done.stderr


def test_only_accessed_parts_of_a_file_are_read(tmp_path, monkeypatch):
    path = tmp_path / "scene.bin"
    path.write_bytes(bytes(range(200)))
    sizes: list[int] = []

    def observed(shape: tuple[int, ...], dtype: type) -> np.ndarray:
        sizes.append(shape[0])
        return large_empty(shape, dtype)

    monkeypatch.setattr("splatwire.io.formats._files.large_empty", observed)
    data = FileBytes(path)
    middle = data.part(50, 150)
    del data
    last = middle.part(90, 300)
    found = len(middle), bytes(middle[10:13]), bytes(middle[97:200])
    assert found == (100, bytes((60, 61, 62)), bytes((147, 148, 149)))
    assert (bytes(middle[5:5]), len(last), bytes(last[:1])) == (b"", 10, bytes((140,)))
    assert sizes == [3, 3, 0, 1]
