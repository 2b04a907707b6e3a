"""Every format: round trips, axes, and handmade files."""

import gzip
import json
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from close import assert_close
from splat_io.formats.handmade import glb, ksplat, legacy_spz, modern_spz, some_splats, write
from splatwire.errors import DatasetError, InvalidValueError, UnknownNameError
from splatwire.io.formats import read_rows, read_splats, splats_kind, write_splats
from splatwire.io.formats._axes import GLTF_FLIPS, SPZ_FLIPS, flip_axes
from splatwire.io.formats._codebooks import nearest_number, number_codebook, vector_palette
from splatwire.io.formats.spz_writer import write_spz
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.splats import Splats


def _turned(quats: np.ndarray) -> np.ndarray:
    return quats * np.where(quats[:, :1] < 0, -1, 1)


def _sorted(splats: Splats) -> Splats:
    return splats.select(splats.means[:, 0].argsort())


# position, log scale, quaternion, opacity, constant and other coefficients: half a step, and rounding
TOLERANCES = {
    ".ply": (1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6),
    ".compressed.ply": (6e-3, 5e-3, 2e-3, 2.1e-3, 2e-2, 1.6e-2),
    ".spz": (1.3e-4, 0.032, 2e-3, 2e-3, 1.4e-2, 4e-3),
    ".sog": (2e-4, 0.05, 7e-3, 2e-3, 2e-2, 2e-2),
    ".glb": (1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6),
}


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("end", TOLERANCES)
def test_every_format_round_trips(end: str, degree: int, tmp_path: Path) -> None:
    splats = some_splats(300, degree)
    parts = [splats.select(np.arange(100)), splats.select(np.arange(100, 300))]
    assert write_splats(parts, tmp_path / f"a{end}") == 300
    back, there = _sorted(read_splats(tmp_path / f"a{end}")), _sorted(splats)
    assert (back.num_gaussians, back.degree) == (300, degree)
    pairs = [
        (back.means, there.means),
        (np.log(back.scales), np.log(there.scales)),
        (_turned(back.quats), _turned(there.quats)),
    ]
    pairs += [(back.opacities, there.opacities), (back.sh[:, 0], there.sh[:, 0]), (back.sh[:, 1:], there.sh[:, 1:])]
    for (found, expected), tolerance in zip(pairs, TOLERANCES[end], strict=True):
        assert_close(found, expected, atol=tolerance, rtol=1e-5)


def test_spz_values_with_fewer_bits_are_multiples_of_the_step(tmp_path: Path) -> None:
    splats = some_splats(2, 3)
    splats.sh[:, 1:] = np.array([0.1, -0.1, 1.5], np.float32)  # 140.8, 115.2 and 320 of 0 to 255
    write_spz([splats], tmp_path / "a.spz", (5, 4))
    back = np.abs(read_splats(tmp_path / "a.spz").sh[:, 1:]) * 128
    assert np.unique(back[:, :3, 0]).tolist() == [16]  # 141 to 144, of 128
    assert np.unique(back[:, :3, 1]).tolist() == [16]  # 115 to 112; the axes may change its sign
    assert np.unique(back[:, 3:, 0]).tolist() == [16]
    assert set(np.unique(back[..., 2]).tolist()) <= {127, 128}  # the ends
    for bits in ((0, 8), (8, 9)):
        with pytest.raises(InvalidValueError, match="1 to 8 bits"):
            write_spz([splats], tmp_path / "a.spz", bits)


@pytest.mark.parametrize("end", [".spz", ".compressed.ply", ".sog"])
def test_rewriting_a_read_file_gives_equal_bytes(end: str, tmp_path: Path) -> None:
    """Reading and rewriting loses no value of a format."""
    write_splats([some_splats(50, 1)], tmp_path / f"a{end}")
    once = _sorted(read_splats(tmp_path / f"a{end}"))
    write_splats([once], tmp_path / f"b{end}")
    twice = _sorted(read_splats(tmp_path / f"b{end}"))
    for name, value in vars(once).items():
        assert_close(getattr(twice, name), value, atol=1e-3, rtol=1e-3, err_msg=name)


@pytest.mark.parametrize("flips", [SPZ_FLIPS, GLTF_FLIPS])
def test_flipped_axes_render_equally_from_a_flipped_camera(flips: tuple[float, float, float]) -> None:
    splats, signs, eye = some_splats(), np.array(flips), np.array([0.3, -2.0, 5.0], np.float32)
    flipped = flip_axes(splats, flips)
    seen, expected = flipped.seen_from(eye * signs), splats.seen_from(eye)
    assert_close(seen.colors, expected.colors, atol=1e-5, rtol=1e-5)
    covariance, original = (_covariances(part) for part in (flipped, splats))
    assert_close(covariance, original * signs[:, None] * signs, atol=1e-7, rtol=1e-4)
    again = flip_axes(flipped, flips)
    assert all(np.array_equal(getattr(again, name), value) for name, value in vars(splats).items())


def _covariances(splats: Splats) -> np.ndarray:
    from splatwire.ops.quaternions import rotation_matrices

    axes = rotation_matrices(splats.quats) * splats.scales[:, None]
    return axes @ axes.swapaxes(1, 2)


@pytest.mark.parametrize("version", [2, 3])
def test_handmade_spz_is_read(version: int, tmp_path: Path) -> None:
    """Values follow from the specification; right, up and back become right, down and forward."""
    splats, _ = read_rows(write(tmp_path / "a", legacy_spz(version)))
    assert splats.means.tolist() == [[1, -2, -3], [-1, 2, 3]]
    assert splats.opacities.tolist() == [1, 0]
    assert np.log(splats.scales).tolist()[0] == pytest.approx([-1, -1, -1])
    assert splats.quats[0, 0] > 0.9999
    assert splats.sh[0, 0].tolist() == pytest.approx([(128 / 255 - 0.5) / 0.15] * 3, rel=1e-4)
    # harmonics of degree 1 follow y, z and x: the first two change their signs
    codes = (np.arange(100, 109).reshape(3, 3) - 128) / 128
    assert np.array_equal(splats.sh[0, 1:], codes * [[-1], [-1], [1]])


@pytest.mark.parametrize("behind", [0, 1 << 17])
def test_spz_checksum_is_verified(behind: int, tmp_path: Path) -> None:
    path, data = tmp_path / "a.spz", bytearray(gzip.compress(gzip.decompress(legacy_spz()) + bytes(behind)))
    data[-8] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="the gzip data are damaged"):
        read_splats(path)


@pytest.mark.parametrize("level", range(3))
def test_ksplat_cut_anywhere_is_refused(level: int, tmp_path: Path) -> None:
    data = ksplat(level)
    for size in (*range(0, 5120, 97), *range(5120, len(data))):
        with pytest.raises(DatasetError):
            read_splats(write(tmp_path / "a.ksplat", data[:size]))


@pytest.mark.parametrize("level", range(3))
def test_handmade_ksplat_is_read(level: int, tmp_path: Path) -> None:
    splats = read_splats(write(tmp_path / "a.ksplat", ksplat(level)))
    where = [[0, 2, 3], [1, 2, 3], [2, 2, 3]] if level == 0 else [[10, 18, 32], [10, 18, 32], [40, 48, 62]]
    assert_close(splats.means, np.array(where, np.float32), atol=1e-4, rtol=0)
    assert splats.scales[2].tolist() == pytest.approx([0.1, 0.2, 0.3], rel=1e-3)
    assert splats.quats.tolist() == [[1, 0, 0, 0]] * 3
    assert (0.5 + DC * splats.sh[0, 0]).tolist() == pytest.approx([1, 0, 128 / 255], abs=1e-6)
    numbers = np.arange(9.0) if level < 2 else np.arange(9.0) / 255 * 4 - 2
    assert_close(splats.sh[1, 1:], numbers.reshape(3, 3).T, atol=1e-4, rtol=0)  # red, then green, then blue


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize(("sections", "spare"), [(3, 0), (1, 2), (2, 1)])
def test_ksplat_of_several_sections_is_read(level: int, sections: int, spare: int, tmp_path: Path) -> None:
    one = read_splats(write(tmp_path / "a.ksplat", ksplat(level)))
    splats = read_splats(write(tmp_path / "b.ksplat", ksplat(level, sections=sections, spare=spare)))
    assert splats.num_gaussians == 3 * sections
    for number in range(sections):
        rows = slice(3 * number, 3 * number + 3)
        assert_close(splats.means[rows] - [100 * number, 0, 0], one.means, atol=1e-4, rtol=0)
        for name in ("quats", "scales", "opacities", "sh"):
            assert np.array_equal(getattr(splats, name)[rows], getattr(one, name))


def test_ksplat_that_states_no_sections_is_read(tmp_path: Path) -> None:
    """GaussForge states the maximum number of sections only."""
    data = ksplat(level=0)
    stated = read_splats(write(tmp_path / "a.ksplat", data))
    unstated = data[:8] + bytes(4) + data[12:]
    splats = read_splats(write(tmp_path / "b.ksplat", unstated))
    assert np.array_equal(splats.means, stated.means)
    assert np.array_equal(read_splats(write(tmp_path / "no_suffix", unstated)).means, stated.means)


def test_ksplat_whose_sections_have_another_size_is_refused(tmp_path: Path) -> None:
    """Early files state the degree of the harmonics in the header of the file instead of those of the sections."""
    data = bytearray(ksplat(level=0, degree=1))
    data[4096 + 40] = 0
    with pytest.raises(
        DatasetError, match="section has 268 bytes, but its 3 Gaussians with harmonics of degree 0 take"
    ):
        read_splats(write(tmp_path / "a.ksplat", bytes(data)))


@pytest.mark.parametrize("degree", range(4))
def test_handmade_gltf_is_read(degree: int, tmp_path: Path) -> None:
    splats = some_splats(degree=degree)
    back = read_splats(write(tmp_path / "a.glb", glb(flip_axes(splats, GLTF_FLIPS))))
    for name, value in vars(splats).items():
        assert_close(getattr(back, name), value, atol=1e-6, rtol=1e-6)


def test_sog_folder_is_read(tmp_path: Path) -> None:
    write_splats([some_splats(70, 2)], tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "a.sog") as bundle:
        bundle.extractall(tmp_path / "folder")
    bundled = read_splats(tmp_path / "a.sog")
    for path in (tmp_path / "folder", tmp_path / "folder" / "meta.json"):
        assert splats_kind(path) == "sog"
        assert all(np.array_equal(getattr(read_splats(path), name), value) for name, value in vars(bundled).items())


def _sog(path: Path, change: dict[str, object], drop: str = "") -> Path:
    write_splats([some_splats(70, 1)], path)
    with zipfile.ZipFile(path) as bundle:
        files = {name: bundle.read(name) for name in bundle.namelist() if name != drop}
    meta = json.loads(files["meta.json"])
    files["meta.json"] = json.dumps({**meta, **change}).encode()
    with zipfile.ZipFile(path, "w") as bundle:
        for name, data in files.items():
            bundle.writestr(name, data)
    return path


@pytest.mark.parametrize(
    ("change", "drop", "reason"),
    [
        ({"version": 3}, "", "version 3; versions 1 and 2 are read"),
        ({"version": True}, "", "version True"),
        ({"version": 1}, "", "means.shape is missing"),
        ({"count": 0}, "", "count of 0"),
        ({"count": 19_000_000}, "", "more than .* bytes of file can hold"),
        ({"count": 9_000}, "", "pixels, 9000 are needed"),
        ({"count": "70"}, "", "count is '70'"),
        ({"shN": {"bands": 1.0, "count": 64}}, "", "bands is 1.0"),
        ({"scales": {"codebook": [0.0] * 257, "files": ["scales.webp"]}}, "", "scales.codebook is not 256 numbers"),
        ({"means": {"mins": [0, 0, float("nan")], "maxs": [1, 1, 1], "files": []}}, "", "means.files"),
        ({"sh0": None}, "", "sh0.files is missing|sh0.codebook is missing"),
        ({"quats": {"files": ["scales.webp"]}}, "", "scales.webp twice"),
        ({}, "sh0.webp", "sh0.webp is missing"),
    ],
)
def test_sog_errors_name_the_problem(change: dict[str, object], drop: str, reason: str, tmp_path: Path) -> None:
    path = _sog(tmp_path / "a.sog", change, drop)
    with pytest.raises(DatasetError, match=reason) as caught:
        read_splats(path)
    assert "a.sog" in str(caught.value)


def test_spz_version_4_holds_the_values_of_version_3(tmp_path: Path) -> None:
    for degree in (0, 3):
        write_spz([some_splats(50, degree)], tmp_path / "a.spz", version=3)
        write(tmp_path / "b.spz", modern_spz((tmp_path / "a.spz").read_bytes()))
        one, two = (vars(read_splats(tmp_path / name)) for name in ("a.spz", "b.spz"))
        assert all(np.array_equal(one[name], two[name]) for name in one)


def test_decompression_bombs_are_refused(tmp_path: Path) -> None:
    """Small files that announce gigabytes are refused before memory is allocated."""
    head = bytearray(b"NGSP" + (3).to_bytes(4, "little") + (19_000_000).to_bytes(4, "little") + bytes([3, 12, 0, 0]))
    cases = {
        "gzip.spz": legacy_spz(raw=bytes(head) + bytes(1 << 20)),
        "zstd.spz": b"NGSP" + (4).to_bytes(4, "little") + (19_000_000).to_bytes(4, "little") + bytes(20),
        "a.ksplat": ksplat().replace((3).to_bytes(4, "little"), (19_000_000).to_bytes(4, "little")),
    }
    for name, data in cases.items():
        with pytest.raises(DatasetError, match=r"can hold|Gaussians"):
            read_splats(write(tmp_path / name, data))
    with zipfile.ZipFile(tmp_path / "a.sog", "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("meta.json", b" " * (8 << 20))
    with pytest.raises(DatasetError, match=r"meta\.json has 8388608 bytes"):
        read_splats(tmp_path / "a.sog")


def _pointing_at(accessor: object) -> list[dict[str, object]]:
    extension = {"KHR_gaussian_splatting": {}}
    return [{"primitives": [{"attributes": {"POSITION": accessor}, "extensions": extension}]}]


def _shorter() -> list[dict[str, object]]:
    """Accessors of a glTF with Gaussians of degree 3, without one row of harmonics."""
    kinds = ["VEC3", "VEC4", "VEC3", "SCALAR", *["VEC3"] * 16]
    return [
        {"bufferView": i, "componentType": 5126, "count": 20 - (i >= 4), "type": kind} for i, kind in enumerate(kinds)
    ]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"meshes": []}, "no primitive with KHR_gaussian_splatting"),
        ({"accessors": []}, "damaged"),
        ({"meshes": _pointing_at("x")}, "attribute POSITION names no accessor"),
        ({"accessors": _shorter()}, "19 Gaussians have .*SH_DEGREE_0_COEF_0, 20 a position"),
        ({"bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 1 << 33}] * 20}, "ends after its buffer"),
    ],
)
def test_gltf_errors_name_the_problem(change: dict[str, object], reason: str, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=reason):
        read_splats(write(tmp_path / "a.glb", glb(some_splats(), change)))


def test_suffixes_map_to_one_format(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"compressed\.ply"):
        write_splats([some_splats()], tmp_path / "a.docx")
    far = some_splats(3, 0)
    far.means[0] = 1e9
    with pytest.raises(InvalidValueError, match="too far"):
        write_splats([far], tmp_path / "a.spz")
    for end in (".spz", ".sog", ".compressed.ply"):
        with pytest.raises(InvalidValueError, match="no Gaussian"):
            write_splats([], tmp_path / f"a{end}")
    assert not list(tmp_path.iterdir())


def test_codebooks_are_near_optimal() -> None:
    """Panter and Dite: the error of the best 256 levels for a normal distribution is sqrt(3) pi / 2 / 256**2."""
    values = np.random.default_rng(0).normal(size=200_000)
    codebook = number_codebook(values, 256)
    error = ((codebook[nearest_number(values, codebook)] - values) ** 2).mean()
    assert 0.8 < error / (np.sqrt(3) * np.pi / 2 / 256**2) < 1.15


def test_a_palette_of_few_different_vectors_is_exact() -> None:
    """Most harmonics of a decoded stream may be 0: k-means would then compare nearly all vectors with each other."""
    rng = np.random.default_rng(1)
    vectors = rng.normal(size=(40, 9)).astype(np.float32)[rng.integers(0, 40, 20_000)]
    vectors[rng.random(len(vectors)) < 0.9] = 0
    palette, labels = vector_palette(vectors, 1000)
    assert len(palette) == 41
    np.testing.assert_array_equal(palette[labels], vectors)


def test_palette_finds_repeated_vectors() -> None:
    rng = np.random.default_rng(0)
    kinds = rng.normal(size=(64, 9)).astype(np.float32)
    vectors = kinds[rng.integers(64, size=5000)] + rng.normal(size=(5000, 9)).astype(np.float32) * 1e-3
    palette, labels = vector_palette(vectors, 512)
    assert len(palette) <= 512
    assert np.abs(palette[labels] - vectors).max() < 0.02
    few, each = vector_palette(vectors[:5], 512)
    assert np.array_equal(few[each], vectors[:5])


def test_files_of_other_programs_are_read(data_dir: Path) -> None:
    folder = data_dir / "splats"
    facts = {
        "biker.spz": ("spz", 152_746, 0),
        "biker.compressed.ply": ("ply", 152_746, 0),
        "guitar.compressed.ply": ("ply", 90_854, 0),
        "playbot_125k.sog": ("sog", 125_000, 2),
        "playbot_250k_sog": ("sog", 250_000, 2),
    }
    for name, (kind, count, degree) in facts.items():
        assert splats_kind(folder / name) == kind
        splats = read_splats(folder / name)
        assert (splats.num_gaussians, splats.degree) == (count, degree)


def test_scene_in_two_formats_reads_equal(data_dir: Path) -> None:
    """The SPZ of the shared data has the scene of the compressed PLY: bounds, sizes and colours agree."""
    one, two = (read_splats(data_dir / "splats" / f"biker.{end}") for end in ("spz", "compressed.ply"))
    for share in (0.01, 0.25, 0.5, 0.75, 0.99):
        for name in ("means", "opacities"):
            found, expected = (np.quantile(getattr(part, name), share, axis=0) for part in (one, two))
            assert_close(found, expected, atol=0.02, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("a.splat", b""),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\n"),
        ("a.spz", b"NGSP\4\0\0\0\x40\x42\x0f\0\3\x0c\0\6\x20\0\0\0"),
        ("b.spz", legacy_spz()[:40]),
        ("a.glb", b"glTF\2\0\0\0\0\0\0\x80\0\0\0\x70JSON"),
        ("a.ksplat", b"\0\1\0\0\1\0\0\0\1\0\0\0\1\0\0\0\1\0\0\0\1\0"),
        ("a.sog", b"PK\3\4"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_gigabytes_of_zeros_are_refused(name: str, head: bytes, tmp_path: Path) -> None:
    """A sparse file of 3 GiB; the process may allocate only 1 GiB more, so loading it would fail."""
    resource = pytest.importorskip("resource")
    path = write(tmp_path / name, head)
    os.truncate(path, 3 << 30)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(DatasetError, match=name):
        read_splats(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 20


def test_overflowing_bounds_are_refused_without_a_numpy_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_splats([some_splats(8, 0)], tmp_path / "a.compressed.ply")
    head, body = (tmp_path / "a.compressed.ply").read_bytes().split(b"end_header\n", 1)
    lie = np.full(1, 3e38, "<f4").tobytes()  # the most red
    write(tmp_path / "a.compressed.ply", head + b"end_header\n" + body[:60] + lie + body[64:])
    left = read_splats(tmp_path / "a.compressed.ply")
    assert left.num_gaussians == 2  # nearly as red as the least red: the other colours do not fit into float32
    assert bool(np.isfinite(left.sh).all())
    assert "6 of 8 Gaussians cannot be drawn" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ((b"min_y", b"max_y"), (b"max_y", b"min_y"), "a number of min_y is above that of max_y"),
        ((b"min_scale_x", b"max_scale_x"), (b"max_scale_x", b"min_scale_x"), "a number of min_scale_x is above"),
        ((b"min_g", b"max_g"), (b"max_g", b"min_g"), "a number of min_g is above that of max_g"),
        ((b"min_r", b"max_r"), (b"own_r", b"max_r"), "min_r"),
    ],
)
def test_bounds_of_a_compressed_ply_are_checked(
    old: tuple[bytes, bytes], new: tuple[bytes, bytes], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.compressed.ply"
    write_splats([some_splats(300, 1)], path)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    for number, name in enumerate(old):
        head = head.replace(b" " + name + b"\n", b" #%d\n" % number)
    for number, name in enumerate(new):
        head = head.replace(b" #%d\n" % number, b" " + name + b"\n")
    path.write_bytes(head + mark + data)
    with pytest.raises(DatasetError, match=reason):
        read_splats(path)


def test_unknown_elements_and_columns_of_a_compressed_ply_give_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.compressed.ply"
    write_splats([some_splats(20, 0)], path)
    data = path.read_bytes()
    read_splats(path)
    assert not caplog.messages
    path.write_bytes(
        data.replace(b"end_header\n", b"element deleted 20\nproperty uchar state\nend_header\n") + bytes(20)
    )
    read_splats(path)
    assert "element deleted not known and left out: the scene may look different" in caplog.text


def test_other_minor_versions_of_ksplat_give_a_warning(tmp_path, caplog):
    data = bytearray(ksplat())
    read_splats(write(tmp_path / "a.ksplat", bytes(data)))
    assert not caplog.messages
    data[1] = 2
    assert read_splats(write(tmp_path / "a.ksplat", bytes(data))).num_gaussians == 3
    assert ".ksplat of version 0.2 is not known: it is read as version 0.1" in caplog.text


def test_swapped_bounds_of_harmonics_in_a_ksplat_are_refused(tmp_path):
    data = bytearray(ksplat(level=2))
    struct.pack_into("<ff", data, 36, 2.0, -2.0)
    with pytest.raises(DatasetError, match="harmonics from 2 to -2: the bounds are swapped"):
        read_splats(write(tmp_path / "a.ksplat", bytes(data)))
