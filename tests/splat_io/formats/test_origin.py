"""Positions of geo-referenced scenes: float64 in files, float32 relative to an origin in memory."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splat_io.formats.handmade import ply, some_splats
from splatwire.errors import DatasetError
from splatwire.io.formats import read_content, read_rows, read_splats, write_splats
from splatwire.io.formats._asset import origin_of_asset
from splatwire.io.formats.ply_file import read_ply_elements
from splatwire.types.metadata import SceneMetadata, StartView
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

UTM: Origin = (451234.0, 5411876.0, 118.0)
ECEF: Origin = (4199474.0, 868431.0, -4705921.0)


def geo_ply(splats: Splats, shift: np.ndarray, path: Path, kind: str = "double") -> Path:
    """A PLY of another program with float64 (or other) coordinates and no comment."""
    write_splats([splats], path)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    rows = np.frombuffer(data, "<f4").reshape(splats.num_gaussians, -1)
    record = np.dtype([("means", "<f8" if kind == "double" else "<f4", 3), ("rest", "<f4", rows.shape[1] - 3)])
    records = np.empty(len(rows), record)
    records["means"], records["rest"] = splats.means.astype(np.float64) + shift, rows[:, 3:]
    for axis in "xyz":
        head = head.replace(f"property float {axis}\n".encode(), f"property {kind} {axis}\n".encode())
    path.write_bytes(head + mark + records.tobytes())
    return path


@pytest.mark.parametrize(("shift", "has_origin"), [(60.0, False), (1e6, True)])
def test_origin_does_not_depend_on_the_byte_order_of_float32_positions(
    shift: float, has_origin: bool, tmp_path: Path
) -> None:
    path = geo_ply(some_splats(300, 0), np.full(3, shift), tmp_path / "a.ply", "float")
    elements = {"vertex": next(iter(read_ply_elements(path).values())).rows}
    origins = []
    for form in ("binary_little_endian", "binary_big_endian"):
        path.write_bytes(ply(form, elements))
        origins.append(read_content(path).origin)
    assert origins[0] == origins[1]
    assert (origins[0] != NO_ORIGIN) == has_origin


@pytest.mark.parametrize("near", [UTM, ECEF, (0.0, 7e6, 0.0)])
def test_float64_coordinates_keep_their_precision(near: Origin, tmp_path: Path) -> None:
    splats, shift = some_splats(500, 1), np.array(near) + np.array([0.5, 0.25, 0.125])
    content = read_content(geo_ply(splats, shift, tmp_path / "a.ply"))
    world = content.splats.means.astype(np.float64) + np.array(content.origin)
    assert np.abs(world - (splats.means.astype(np.float64) + shift)).max() < 1e-6
    assert max(abs(a - b) for a, b in zip(content.origin, near, strict=True)) < 2
    for name in ("quats", "scales", "opacities", "sh"):
        assert np.allclose(getattr(content.splats, name), getattr(splats, name), atol=1e-5)


def test_float32_coordinates_far_from_zero_are_unchanged(tmp_path: Path) -> None:
    splats, shift = some_splats(500, 0), np.array([4000.0, 2500.0, 100.0])
    content = read_content(geo_ply(splats, shift, tmp_path / "a.ply", "float"))
    there = (splats.means.astype(np.float64) + shift).astype(np.float32)
    assert content.origin != NO_ORIGIN
    assert np.array_equal((content.splats.means.astype(np.float64) + content.origin).astype(np.float32), there)


@pytest.mark.parametrize("kind", ["float", "double"])
def test_scenes_around_zero_have_no_origin(kind: str, tmp_path: Path) -> None:
    splats = some_splats(500, 0)
    splats.means[::50] += 1e6  # distant Gaussians do not move the others
    for shift in (0.0, 1.5):
        content = read_content(geo_ply(splats, np.array([shift, 0, 0]), tmp_path / "a.ply", kind))
        assert content.origin == NO_ORIGIN


@pytest.mark.parametrize(("near", "size"), [((1.1, 2.2, 3.3), 1e-6), ((100.37, 50.0, 2.0), 1e-4), (UTM, 1e-4)])
def test_small_scenes_far_from_zero_keep_their_precision(near: Origin, size: float, tmp_path: Path) -> None:
    splats = some_splats(500, 0)
    splats.means[:] *= size
    content = read_content(geo_ply(splats, np.array(near), tmp_path / "a.ply"))
    world = content.splats.means.astype(np.float64) + np.array(content.origin) - near
    resolution = np.spacing(np.abs(near).max())
    assert np.abs(world - splats.means).max() < 1e-4 * size + resolution


@pytest.mark.parametrize("name", ["a.spz", "a.sog", "a.compressed.ply"])
def test_origins_are_kept_where_other_programs_do_not_read_them(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    view = StartView((1.0, 2.0, 3.0), (0.0, 0.0, 0.5), (0.0, -1.0, 0.0))
    for metadata in (SceneMetadata(), SceneMetadata(title="Quay", view=view)):
        write_splats([some_splats(300, 1)], tmp_path / name, origin=UTM, metadata=metadata)
        assert "which only splatwire reads from such files" in caplog.text
        content = read_content(tmp_path / name)
        assert (content.origin, content.metadata) == (UTM, metadata)
        write_splats([some_splats(300, 1)], tmp_path / f"local_{name}", metadata=metadata)
        local = read_content(tmp_path / f"local_{name}")
        assert local.origin == NO_ORIGIN
        assert np.array_equal(content.splats.means, local.splats.means)


def test_an_invalid_origin_in_a_sog_is_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.sog"
    for bad in ("x", [1, 2], [1e13, 0, 0], [None, 0, 0], {}):
        caplog.clear()
        content = {"extras": {"splatwire": {"origin": bad}}}
        assert origin_of_asset(content, path) == NO_ORIGIN
        assert "a.sog: its origin is left out, so positions are read as they are in the file" in caplog.text
    caplog.clear()
    assert origin_of_asset({"extras": {"splatwire": {"origin": [1, 2, 3]}}}, path) == (1.0, 2.0, 3.0)
    assert not caplog.messages


def test_small_scenes_of_few_float32_steps_have_no_origin(tmp_path: Path) -> None:
    splats = some_splats(500, 0)
    splats.means[:] *= 0.01
    assert read_content(geo_ply(splats, np.array([0.5, 0, 0]), tmp_path / "a.ply")).origin == NO_ORIGIN


@pytest.mark.parametrize("suffix", ["glb", "usda"])
def test_transforms_of_small_scenes_keep_their_precision(suffix: str, tmp_path: Path) -> None:
    if suffix == "usda":
        pytest.importorskip("pxr")
    splats, origin = some_splats(500, 0), (300.0, 200.0, 10.0)
    splats.means[:] *= 1e-3
    write_splats([splats], tmp_path / f"a.{suffix}", origin=origin)
    content = read_content(tmp_path / f"a.{suffix}")
    world = content.splats.means.astype(np.float64) + np.array(content.origin) - origin
    assert np.abs(world - splats.means).max() < 1e-6


@pytest.mark.parametrize("suffix", ["glb", "usda"])
def test_transforms_of_large_scenes_near_zero_give_no_origin(suffix: str, tmp_path: Path) -> None:
    if suffix == "usda":
        pytest.importorskip("pxr")
    write_splats([some_splats(300, 0)], tmp_path / f"a.{suffix}", origin=(20.0, 0.0, 0.0))
    content = read_content(tmp_path / f"a.{suffix}")
    assert content.origin == NO_ORIGIN
    assert abs(float(np.median(content.splats.means[:, 0])) - 20) < 1


def test_a_small_scene_that_lost_its_precision_is_not_called_several_sites(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(300, 0)
    splats.means[:] *= 1e-5
    splats.scales[:] = 1e-6
    read_content(geo_ply(splats, np.array([20.0, 0.0, 0.0]), tmp_path / "a.ply", "float"))
    assert "the file has lost precision" in caplog.text
    assert "sites" not in caplog.text


def test_a_written_ply_has_float64_coordinates_and_its_origin(tmp_path: Path) -> None:
    splats, origin = some_splats(300, 2), (451234.5, 5411876.25, -118.0)
    write_splats([splats.slice_range(0, 100), splats.slice_range(100, 300)], tmp_path / "a.ply", origin=origin)
    text = (tmp_path / "a.ply").read_bytes().partition(b"end_header")[0].decode()
    assert "property double x\nproperty double y\nproperty double z\nproperty float nx" in text
    content = read_content(tmp_path / "a.ply")
    assert content.origin == origin
    assert np.allclose(content.splats.means, splats.means, atol=1e-9, rtol=0)
    for name in ("quats", "scales", "opacities", "sh"):
        assert np.allclose(getattr(content.splats, name), getattr(splats, name), atol=1e-5)


def test_a_compressed_ply_has_its_origin_in_a_comment(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_splats([some_splats(300, 0)], tmp_path / "plain.compressed.ply")
    write_splats([some_splats(300, 0)], tmp_path / "a.compressed.ply", origin=UTM)
    assert "451234, 5411876, 118" in caplog.text
    content = read_content(tmp_path / "a.compressed.ply")
    assert content.origin == UTM
    assert np.array_equal(content.splats.means, read_splats(tmp_path / "plain.compressed.ply").means)


def test_a_gltf_has_its_origin_in_the_node(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats = some_splats(300, 1)
    write_splats([splats], tmp_path / "a.glb", origin=UTM)
    data = (tmp_path / "a.glb").read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert document["nodes"] == [{"mesh": 0, "translation": [-UTM[0], -UTM[1], UTM[2]]}]
    content = read_content(tmp_path / "a.glb")
    assert content.origin == UTM
    assert np.array_equal(content.splats.means, splats.means)
    assert not caplog.messages


def test_a_splat_file_has_no_origin_and_a_warning_names_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_splats([some_splats(300, 0)], tmp_path / "a.splat", origin=UTM)
    assert "origin (451234, 5411876, 118), which such files do not hold" in caplog.text
    assert read_content(tmp_path / "a.splat").origin == NO_ORIGIN
    assert float(np.abs(read_splats(tmp_path / "a.splat").means).max()) < 10


def test_readers_return_world_coordinates_on_request(tmp_path: Path) -> None:
    splats = some_splats(300, 0)
    write_splats([splats], tmp_path / "a.ply", origin=UTM)
    expected = splats.means.astype(np.float64) + np.array(UTM, np.float64)
    for found in (read_splats(tmp_path / "a.ply"), read_rows(tmp_path / "a.ply")[0]):
        assert np.array_equal(found.means, expected.astype(np.float32))


def test_impossible_coordinates_and_origins_are_refused(tmp_path: Path) -> None:
    splats = some_splats(300, 0)
    shift = np.tile(np.array(UTM), (300, 1))
    shift[3], shift[7] = np.nan, np.inf
    path = geo_ply(splats, shift, tmp_path / "a.ply")
    content = read_content(path)
    assert content.splats.num_gaussians == 298
    assert max(abs(a - b) for a, b in zip(content.origin, UTM, strict=True)) < 2
    data = path.read_bytes()
    for words in ("1 2", "nan 0 0", "1e300 0 0", "a b c"):
        path.write_bytes(data.replace(b"comment splatwire", f"comment splatwire-origin {words}\ncomment x".encode(), 1))
        assert read_content(path).origin == content.origin
    gone = geo_ply(splats, np.full(3, np.nan), tmp_path / "b.ply")
    with pytest.raises(DatasetError, match="none of its 300"):
        read_content(gone)


@pytest.mark.parametrize("stated", [UTM, ECEF, (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("near", [NO_ORIGIN, (4199474.0, -868431.0, 4705921.0)])
def test_origin_far_from_the_positions_gives_a_warning_and_is_not_used(
    stated: Origin, near: Origin, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(300, 0)
    path = geo_ply(splats, np.array(near) + 0.25, tmp_path / "a.ply")
    words = " ".join(str(value) for value in stated)
    comment = f"comment splatwire-origin {words}\ncomment x".encode()
    path.write_bytes(path.read_bytes().replace(b"comment splatwire", comment, 1))
    content = read_content(path)
    world = content.splats.means.astype(np.float64) + np.array(content.origin)
    assert np.abs(world - (splats.means.astype(np.float64) + np.array(near) + 0.25)).max() < 1e-5
    fits = near == stated
    assert ("may be of another file" in caplog.text) is not fits
    assert fits or "origin (" in caplog.text


def test_offset_of_positions_already_far_from_zero_gives_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(300, 0)
    far = replace(splats, means=splats.means + np.float32([4000.0, 2500.0, 100.0]))
    write_splats([far], tmp_path / "a.compressed.ply", origin=UTM)
    caplog.clear()
    read_content(tmp_path / "a.compressed.ply")
    assert "adds the offset (451234 5411876 118)" in caplog.text


@pytest.mark.parametrize("kind", ["float", "double"])
def test_coordinates_beyond_any_map_are_refused(kind: str, tmp_path: Path) -> None:
    path = geo_ply(some_splats(300, 0), np.array([1e13, 0, 0]), tmp_path / "a.ply", kind)
    with pytest.raises(DatasetError, match=r"a.ply: positions are around 1e\+13 from 0"):
        read_content(path)


@pytest.mark.parametrize("form", ["ply", "splat"])
@pytest.mark.parametrize(("near", "named"), [((4000.0, 2500.0, 100.0), False), (UTM, True)])
def test_visibly_rounded_positions_give_a_warning(
    form: str, near: tuple[float, float, float], named: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats, path = some_splats(500, 0), tmp_path / f"a.{form}"
    far = replace(splats, means=(splats.means.astype(np.float64) + np.array(near)).astype(np.float32))
    write_splats([far], path)
    read_content(path)
    assert ("positions are float32" in caplog.text) == named
    if named:
        assert "where they have steps of 0.5, and the median size of Gaussians is 0.05" in caplog.text


def test_float64_positions_give_no_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(geo_ply(some_splats(500, 0), np.array(UTM), tmp_path / "a.ply"))
    assert not caplog.messages


def text_ply(splats: Splats, form: str, shift: np.ndarray, path: Path) -> Path:
    """A text PLY with positions of type float, printed by a format."""
    write_splats([splats], path)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    rows = np.frombuffer(data, "<f4").reshape(splats.num_gaussians, -1)
    lines = [" ".join([*(format(v, form) for v in row[:3] + shift), *map(str, row[3:])]) for row in rows]
    head = head.replace(b"binary_little_endian", b"ascii")
    path.write_bytes(head + mark + ("\n".join(lines) + "\n").encode())
    return path


def test_text_coordinates_with_more_digits_than_float_keep_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats, shift = some_splats(300, 0), np.array(UTM) + np.array([0.5, 0.25, 0.125])
    content = read_content(text_ply(splats, ".6f", shift, tmp_path / "a.ply"))
    world = content.splats.means.astype(np.float64) + np.array(content.origin)
    assert np.abs(world - (splats.means.astype(np.float64) + shift)).max() < 1e-6
    assert "lost precision" not in caplog.text
    assert read_content(text_ply(splats, ".6f", np.zeros(3), tmp_path / "b.ply")).origin == NO_ORIGIN


def test_rounded_text_coordinates_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats = some_splats(300, 0)
    splats.scales[:] = 0.01
    read_content(text_ply(splats, ".6g", np.array(UTM), tmp_path / "a.ply"))
    assert "the file has lost precision" in caplog.text


@pytest.mark.parametrize(("kind", "error"), [("double", 1e-3), ("float", 0.3)])
def test_positions_within_far_bounds_of_a_compressed_ply_are_not_rounded(
    kind: str, error: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats, shift = some_splats(600, 0), np.array(UTM) + np.array([0.5, 0.25, 0.125])
    splats.scales[:] = 0.01
    write_splats([splats], tmp_path / "near.compressed.ply")
    near = read_splats(tmp_path / "near.compressed.ply").means.astype(np.float64)
    head, mark, data = (tmp_path / "near.compressed.ply").read_bytes().partition(b"end_header\n")
    chunks = np.frombuffer(data, "<f4", 3 * 18).reshape(3, 18)
    record = np.dtype([("positions", "<f8" if kind == "double" else "<f4", 6), ("rest", "<f4", 12)])
    moved = np.empty(3, record)
    moved["positions"], moved["rest"] = chunks[:, :6] + np.tile(shift, 2), chunks[:, 6:]
    for name in ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z"):
        head = head.replace(f"float {name}\n".encode(), f"{kind} {name}\n".encode())
    (tmp_path / "far.ply").write_bytes(head + mark + moved.tobytes() + data[chunks.nbytes :])
    content = read_content(tmp_path / "far.ply")
    world = content.splats.means.astype(np.float64) + np.array(content.origin)
    assert np.abs(world - (near + shift)).max() < error
    assert len(np.unique(content.splats.means[:, 0])) > 500
    assert ("the file has lost precision" in caplog.text) == (kind == "float")


@pytest.mark.parametrize("kind", ["double", "float"])
@pytest.mark.parametrize(("share", "size", "warned"), [(2, 0.01, True), (2, 10.0, False), (50, 0.01, False)])
def test_a_second_site_far_from_the_origin_gives_a_warning(
    share: int, size: float, warned: bool, kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(300, 0)
    splats.scales[:] = size
    shift = np.where(np.arange(300)[:, None] % share == 0, np.array(UTM), 0.0)
    content = read_content(geo_ply(splats, shift, tmp_path / "two.ply", kind))
    assert content.origin == NO_ORIGIN
    assert ("split the sites into files" in caplog.text) == warned
