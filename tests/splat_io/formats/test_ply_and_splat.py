import gzip
import lzma
import struct
from pathlib import Path

import numpy as np
import pytest

from close import assert_close, unit
from random_numbers import Numbers
from splat_io.formats.handmade import ksplat, ply
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.kinds import SPLATS_PLY, file_kind
from splatwire.files.scene_formats import FORMATS
from splatwire.io.formats import read_splats, splats_kind, write_splats
from splatwire.io.formats.ply import write_ply
from splatwire.io.formats.ply_file import read_ply_elements
from splatwire.io.formats.splat import read_splat, write_splat
from splatwire.types.splats import Splats


def _splats(count: int = 20, degree: int = 3, seed: int = 0) -> Splats:
    rng = Numbers(seed)
    return Splats(
        means=rng.randn(count, 3),
        quats=unit(rng.randn(count, 4)),
        scales=rng.rand(count, 3) * 0.1 + 1e-4,
        opacities=rng.rand(count) * 0.98 + 0.01,
        sh=rng.randn(count, (degree + 1) ** 2, 3) * 0.3,
    )


@pytest.mark.parametrize("degree", range(4))
def test_ply_round_trips(degree: int, tmp_path: Path) -> None:
    splats = _splats(degree=degree)
    assert write_ply([splats], tmp_path / "a.ply") == 20
    back = read_splats(tmp_path / "a.ply")
    for name, value in vars(splats).items():
        assert_close(getattr(back, name), value, atol=2e-6, rtol=2e-6)
    assert np.array_equal(back.means, splats.means)
    assert np.array_equal(back.sh, splats.sh)


def test_ply_bytes_are_pinned(tmp_path: Path) -> None:
    """Bytes follow the description of the format."""
    sh = np.arange(12.0).reshape(1, 4, 3)  # coefficient by coefficient: red, green, blue
    one = Splats(*map(np.float32, ([[1, 2, 3]], [[1, 0, 0, 0]], [[1, np.e, 1]], [0.5])), sh)
    write_ply([one], tmp_path / "a.ply")
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\ncomment ")
    assert b"element vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\n" in head
    values = struct.unpack("<26f", body)
    assert values[:6] == (1, 2, 3, 0, 0, 0)
    assert values[6:9] == (0, 1, 2)
    assert values[9:18] == (3, 6, 9, 4, 7, 10, 5, 8, 11)  # first all of red, then green, then blue
    assert values[18:] == pytest.approx((0, 0, 1, 0, 1, 0, 0, 0))


def test_parts_are_written_into_one_file(tmp_path: Path) -> None:
    splats = _splats(12_000, degree=1)
    write_ply([splats], tmp_path / "whole.ply")
    parts = (splats.select(np.arange(i, min(i + 700, 12_000))) for i in range(0, 12_000, 700))
    assert write_ply(parts, tmp_path / "parts.ply") == 12_000
    assert (tmp_path / "parts.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_splat_files_keep_eight_bits(tmp_path: Path) -> None:
    splats = _splats(degree=0)
    np.clip(splats.sh, -1.5, 1.5, out=splats.sh)
    assert write_splat([splats], tmp_path / "a.splat") == 20
    assert (tmp_path / "a.splat").stat().st_size == 20 * 32
    back = read_splats(tmp_path / "a.splat")
    assert np.array_equal(back.means, splats.means)
    assert np.array_equal(back.scales, splats.scales)
    assert float(np.abs(back.opacities - splats.opacities).max()) <= 0.5 / 255 + 1e-6
    color, expected = (part.seen_from(np.zeros(3, np.float32)).colors for part in (back, splats))
    assert float(np.abs(color - expected.clip(None, 1)).max()) <= 0.5 / 255 + 1e-6
    assert float(np.abs(back.quats - splats.quats).max()) < 1.5 / 128


def test_splat_record_bytes_are_pinned(tmp_path: Path) -> None:
    record = struct.pack("<6f8B", 1, 2, 3, 0.1, 0.2, 0.3, 255, 128, 0, 51, 255, 128, 128, 128)
    (tmp_path / "a.splat").write_bytes(record)
    one = read_splat(tmp_path / "a.splat")
    assert one.means.tolist() == [[1, 2, 3]]
    assert one.opacities.tolist() == pytest.approx([0.2])
    assert one.quats.tolist() == [[1, 0, 0, 0]]
    assert one.seen_from(np.zeros(3, np.float32)).colors[0].tolist() == pytest.approx([1, 128 / 255, 0], abs=1e-6)
    write_splat([one], tmp_path / "b.splat")
    assert (tmp_path / "b.splat").read_bytes() == record


@pytest.mark.parametrize("level", [0, 1, 2])
def test_ksplat_files_with_another_suffix_are_read(level: int, tmp_path: Path) -> None:
    data = ksplat(level)
    for name in ("a.ksplat", "a.splat", "a"):
        (tmp_path / name).write_bytes(data + bytes(-len(data) % 32))
        assert splats_kind(tmp_path / name) == "ksplat"
    found = [read_splats(tmp_path / name).means.tolist() for name in ("a.ksplat", "a.splat")]
    assert found[0] == found[1]


def test_packed_spz_files_named_splat_are_recognised(tmp_path: Path) -> None:
    data = gzip.compress(b"NGSP" + bytes(20))
    (tmp_path / "a.splat").write_bytes(data + bytes(-len(data) % 32))
    assert splats_kind(tmp_path / "a.splat") == "spz"


@pytest.mark.parametrize(
    "content",
    [
        np.random.default_rng(0).bytes(32 * 500),
        np.arange(4000, dtype="<i4").tobytes(),
        np.random.default_rng(0).normal(size=(500, 8)).astype("<f4").tobytes(),
    ],
    ids=["noise", "integers", "negative sizes"],
)
def test_other_binary_files_named_splat_are_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(content)
    with pytest.raises(DatasetError, match="500 records of 32 bytes have impossible positions or sizes"):
        read_splats(tmp_path / "a.splat")


def test_file_kinds_are_detected_by_content(tmp_path: Path) -> None:
    from scenes import tiny_scene
    from splatwire.anchors.scene_file import save_scene

    write_ply([_splats()], tmp_path / "named.other")
    assert splats_kind(tmp_path / "named.other") == "ply"
    save_scene(tiny_scene(num_anchors=5), tmp_path / "scene.splat")
    raw = (tmp_path / "scene.splat").read_bytes()
    (tmp_path / "scene.splat").write_bytes(raw + bytes(-len(raw) % 32))
    assert splats_kind(tmp_path / "scene.splat") is None
    assert splats_kind(tmp_path) is None
    (tmp_path / "odd.splat").write_bytes(bytes(33))
    assert splats_kind(tmp_path / "odd.splat") == "splat"
    with pytest.raises(DatasetError, match=r"odd\.splat: .*33 bytes"):
        read_splats(tmp_path / "odd.splat")


@pytest.mark.parametrize("end", [".ply", ".compressed.ply"])
@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
def test_text_and_big_endian_ply_hold_the_same_gaussians(form: str, end: str, tmp_path: Path) -> None:
    write_splats([_splats(degree=2)], tmp_path / f"a{end}")
    elements = {name: element.rows for name, element in read_ply_elements(tmp_path / f"a{end}").items()}
    (tmp_path / "b.ply").write_bytes(ply(form, elements))
    one, two = (vars(read_splats(tmp_path / name)) for name in (f"a{end}", "b.ply"))
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert splats_kind(tmp_path / "b.ply") == "ply"


@pytest.mark.parametrize("prefix", [b"scalar_", b"scal_", b"scalar_scal_"])
def test_properties_with_the_prefixes_of_cloudcompare_are_read(prefix: bytes, tmp_path: Path) -> None:
    splats = _splats()
    write_splats([splats], tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    for name in (b"f_dc_", b"f_rest_", b"opacity", b"scale_", b"rot_"):
        data = data.replace(b"property float " + name, b"property float " + prefix + name)
    (tmp_path / "b.ply").write_bytes(data)
    assert np.array_equal(read_splats(tmp_path / "b.ply").sh, read_splats(tmp_path / "a.ply").sh)
    assert file_kind(tmp_path / "b.ply") == SPLATS_PLY


def test_a_property_with_a_prefix_is_not_read_in_place_of_the_one_without(tmp_path: Path) -> None:
    splats = _splats()
    write_splats([splats], tmp_path / "a.ply")
    head, rows = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    size = len(rows) // splats.num_gaussians
    longer = b"".join(rows[at : at + size] + b"\0\0\0\0" for at in range(0, len(rows), size))
    (tmp_path / "b.ply").write_bytes(head + b"property float scalar_opacity\nend_header\n" + longer)
    assert np.array_equal(read_splats(tmp_path / "b.ply").opacities, read_splats(tmp_path / "a.ply").opacities)


def test_compressed_ply_with_an_empty_element_of_harmonics_is_read(tmp_path: Path) -> None:
    """gsplat writes the element also for harmonics of degree 0, without properties."""
    path = tmp_path / "a.compressed.ply"
    write_splats([_splats(degree=0)], path)
    expected, data = read_splats(path), path.read_bytes()
    path.write_bytes(data.replace(b"end_header\n", b"element sh 20\nend_header\n", 1))
    assert np.array_equal(read_splats(path).sh, expected.sh)


def test_ply_of_other_programs_is_read(tmp_path: Path) -> None:
    """Contains doubles, another column order, extra colours and normals, comments, and an empty list of faces."""
    splats = _splats(degree=1)
    write_splats([splats], tmp_path / "a.ply")
    rows = read_ply_elements(tmp_path / "a.ply")["vertex"].rows
    names = [name for name in reversed(rows.dtype.names or ()) if not name.startswith("n")]
    wide = np.zeros(len(rows), dtype=[("red", "u1"), *((name, "<f8") for name in names), ("label", "<i4")])
    for name in names:
        wide[name] = rows[name]
    content = ply("binary_little_endian", {"vertex": wide}, b"\r\n", (b"comment by \xc3\xa9diteur", b"obj_info x"))
    face = b"element face 0\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
    (tmp_path / "b.ply").write_bytes(content.replace(b"end_header\r\n", face))
    one, two = (vars(read_splats(tmp_path / name)) for name in ("a.ply", "b.ply"))
    assert all(np.array_equal(one[name], two[name]) for name in one)


@pytest.mark.parametrize("name", ["a.PLY.XZ", "b.ply", "c"])
def test_archive_of_a_ply_is_detected_by_content(name: str, tmp_path: Path) -> None:
    write_splats([_splats()], tmp_path / "a.ply")
    (tmp_path / name).write_bytes(lzma.compress((tmp_path / "a.ply").read_bytes()))
    assert read_splats(tmp_path / name).num_gaussians == _splats().num_gaussians


@pytest.mark.parametrize("end", [form.name for form in FORMATS.registered().values() if form.write])
def test_file_without_gaussians_is_one_error_in_each_format(end: str, tmp_path: Path) -> None:
    if end.startswith("usd"):
        pytest.importorskip("pxr", reason="usd-core is not installed")
    path, none = tmp_path / f"a.{end}", _splats().select(np.zeros(_splats().num_gaussians, np.bool_))
    for parts in ([], [none], iter([none, none])):
        with pytest.raises(InvalidValueError, match=r"a\..*: there is no Gaussian to write"):
            write_splats(parts, path)
    assert not list(tmp_path.iterdir())
    write_splats([none, _splats(), none], path)
    assert read_splats(path).num_gaussians == _splats().num_gaussians


def test_unwritable_gaussians_are_refused_and_leave_no_file(tmp_path: Path) -> None:
    splats = _splats(degree=0)
    splats.means[3, 1] = np.nan
    for write in (write_ply, write_splat):
        with pytest.raises(InvalidValueError, match="finite"):
            write([splats], tmp_path / "a")
        with pytest.raises(InvalidValueError, match="no Gaussian"):
            write([], tmp_path / "a")
    with pytest.raises(InvalidValueError, match="degree 1 after"):
        write_ply([_splats(degree=0), _splats(degree=1)], tmp_path / "a")
    flat = _splats()
    flat.scales[0, 0] = 0
    with pytest.raises(InvalidValueError, match="scales above 0"):
        write_ply([flat], tmp_path / "a")
    assert not list(tmp_path.iterdir())


def _without(data: bytes, name: bytes) -> bytes:
    return data.replace(b"property float " + name + b"\n", b"property float unknown_" + name + b"\n")


@pytest.mark.parametrize(
    ("name", "reason"),
    [("f_rest_3", "f_rest"), ("opacity", "opacity is missing"), ("rot_2", "rot_"), ("scale_2", "scale_"),
     ("f_dc_1", "f_dc_"), ("x", "x is missing")],
)  # fmt: skip
def test_missing_properties_are_named(name: str, reason: str, tmp_path: Path) -> None:
    write_ply([_splats()], tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(_without(data, name.encode()))
    with pytest.raises(DatasetError, match=reason) as caught:
        read_splats(tmp_path / "a.ply")
    assert "a.ply" in str(caught.value)


def test_paths_that_are_no_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(31))
    with pytest.raises(DatasetError, match="not records"):
        read_splat(tmp_path / "a.splat")
    with pytest.raises(DatasetError, match="no such file"):
        read_splats(tmp_path / "absent.ply")


def test_real_files_are_read(data_dir: Path) -> None:
    luigi = read_splats(data_dir / "splats" / "luigi_lgm_3dgs.ply")
    assert (luigi.num_gaussians, luigi.degree) == (14_526, 0)
    truck = read_splats(data_dir / "splats" / "tandt_truck_opensplat_116k.splat")
    assert truck.num_gaussians == 116_544
    assert 0.2 < float(truck.opacities.mean()) < 0.9
    assert bool((truck.scales > 0).all())


@pytest.mark.parametrize("kind", [".ply", ".splat"])
@pytest.mark.parametrize(
    ("name", "value", "word"),
    [("opacities", -2.0, "opacities"), ("opacities", 1.01, "opacities"), ("sh", 2e38, "harmonics")],
)
def test_invalid_values_are_refused_with_their_names(
    kind: str, name: str, value: float, word: str, tmp_path: Path
) -> None:
    splats = _splats()
    getattr(splats, name)[7] = value
    with pytest.raises(InvalidValueError, match=rf"{word} of Gaussians are invalid \(the first is row 7\)"):
        write_splats([splats], tmp_path / f"a{kind}")


def test_rounding_errors_of_opacities_are_clipped(tmp_path: Path) -> None:
    splats = _splats()
    splats.opacities[:2] = 1 + 2e-7, -1e-7
    assert write_ply([splats], tmp_path / "a.ply") == 20
    assert read_ply_elements(tmp_path / "a.ply")


@pytest.mark.parametrize("thickness", [0.0, 1e-31, 1e-38])
def test_splat_files_of_flat_gaussians_are_read(thickness: float, tmp_path: Path) -> None:
    records = np.zeros(64, [("place", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])
    records["scale"], records["color"], records["rotation"] = (0.1, 0.1, thickness), 255, (255, 128, 128, 128)
    (tmp_path / "flat.splat").write_bytes(records.tobytes())
    assert read_splats(tmp_path / "flat.splat").num_gaussians == 64
