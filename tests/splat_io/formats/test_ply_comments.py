"""Comments and columns of training programs: antialiasing, and the 3D filter of Mip-Splatting."""

import lzma
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splat_io.formats.handmade import some_splats
from splatwire.errors import DatasetError
from splatwire.io.formats import is_antialiased, read_content, read_splats, write_splats
from splatwire.io.formats._placement import warn_of_unused_fields
from splatwire.io.formats.ply_comments import states_antialiasing
from splatwire.types.splats import Splats


def commented(folder: Path, *comments: str, newline: str = "\n") -> Path:
    """A PLY with more comments in its header."""
    path = folder / "commented.ply"
    write_splats([some_splats(30, 1)], path)
    head, mark, rows = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    lines[2:2] = [f"comment {text}" for text in comments]
    path.write_bytes(newline.join([*lines, mark.decode().strip(), ""]).encode() + rows)
    return path


@pytest.mark.parametrize(
    "comment",
    [
        "SplatRenderMode: mip", "splatrendermode=MIP", "SplatRenderMode mip", "Render_Mode: antialiased",
        "rasterize_mode: antialiased", "RasterizationMode: Mip-Splatting", "antialiased 1", "Antialiased: True",
        "anti-aliased yes", "anti_aliasing=on", "antialiasing enabled", "antialiased", "mip_splatting: true",
        "GaussianRenderMode: mip", "splat.render_mode: mip", "mode: antialiased",
        'SplatRenderMode: "mip"', "use_mip_filter true", "with antialiasing", "enable_mip_splatting: 1",
    ],
)  # fmt: skip
def test_training_comments_enable_antialiasing(comment: str, tmp_path: Path) -> None:
    path = commented(tmp_path, "Exported from a program", comment)
    assert is_antialiased(path)
    assert read_content(path).antialiased


@pytest.mark.parametrize(
    "comment",
    [
        "SplatRenderMode: default", "SplatRenderMode: classic", "antialiased 0", "antialiased: false",
        "anti-aliased no", "not antialiased", "antialiased pictures of a house", "mipmap 1", "mip 0",
        "trained without antialiasing", "filter: mip", "mode: mips", "commode mip house", "",
        "filter mode: mip", "texture mode: mip", "commode mip", "MSAA mode: antialiased", "not in mode: mip",
        "no render mode: mip", "previous mode: mip",
    ],
)  # fmt: skip
def test_other_comments_do_not_enable_antialiasing(comment: str, tmp_path: Path) -> None:
    path = commented(tmp_path, comment)
    assert not is_antialiased(path)
    assert not read_content(path).antialiased


@pytest.mark.parametrize("comment", ["filter: mip", "texture mode: mip", "renderer='mip'", "kernel mip."])
def test_other_settings_named_mip_give_a_warning(
    comment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_content(commented(tmp_path, comment))
    assert "is not understood: the scene is drawn without antialiasing" in caplog.text


def test_last_antialiasing_comment_applies() -> None:
    assert states_antialiasing(["antialiased 0", "SplatRenderMode: mip"])
    assert not states_antialiasing(["SplatRenderMode: mip", "antialiased 0"])


@pytest.mark.parametrize(
    ("start", "filling"), [("pose ", "1"), ("colour space ", "-"), ("", "opacity "), ("a", " a."), ("rotation ", "-1 ")]
)
def test_a_long_comment_takes_little_time(start: str, filling: str, tmp_path: Path) -> None:
    """A header has up to 65,536 bytes; patterns took minutes in such comments."""
    path = commented(tmp_path, (start + 60_000 * filling)[:60_000] + "!")
    before = time.process_time()
    assert not read_content(path).antialiased
    assert time.process_time() - before < 5


def test_a_shift_late_in_a_long_comment_gives_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for place in (5000, *range(975, 996), 1785):
        caplog.clear()
        read_content(commented(tmp_path, f"settings {'x' * place} shift 100 200 300"))
        assert "may be a shift of the positions" in caplog.text, place


@pytest.mark.parametrize("newline", ["\r\n", "\r"])
def test_comments_are_read_with_any_line_ending_and_from_archives(newline: str, tmp_path: Path) -> None:
    path = commented(tmp_path, "antialiased 1", newline=newline)
    packed = tmp_path / "packed.ply"
    packed.write_bytes(lzma.compress(path.read_bytes()))
    assert is_antialiased(path)
    assert is_antialiased(packed)
    assert read_content(packed).antialiased


def with_filter(splats: Splats, sizes: np.ndarray, path: Path, name: str = "filter_3D") -> Path:
    """A PLY with one more property, the standard deviation of each Gaussian's filter."""
    write_splats([splats], path)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    rows = np.frombuffer(data, "<f4").reshape(splats.num_gaussians, -1)
    filtered = np.concatenate([rows, sizes[:, None].astype("<f4")], axis=1)
    path.write_bytes(head + f"property float {name}\n".encode() + mark + filtered.tobytes())
    return path


@pytest.mark.parametrize("name", ["filter_3D", "filter_3d", "filter3D", "Filter-3D"])
def test_the_filter_of_mip_splatting_widens_gaussians_and_keeps_their_mass(name: str, tmp_path: Path) -> None:
    splats = some_splats(200, 1)
    sizes = np.linspace(0, 0.2, 200)
    found = read_splats(with_filter(splats, sizes, tmp_path / "a.ply", name))
    squares = splats.scales.astype(np.float64) ** 2
    wider = squares + sizes.astype(np.float64)[:, None] ** 2
    opacities = splats.opacities.astype(np.float64) * np.sqrt(squares.prod(axis=1) / wider.prod(axis=1))
    assert np.allclose(found.scales.astype(np.float64), np.sqrt(wider), rtol=1e-5)
    assert np.allclose(found.opacities.astype(np.float64), opacities, rtol=1e-4, atol=2e-6)
    assert np.array_equal(found.means, splats.means)


def test_filters_of_tiny_gaussians_are_applied_and_invalid_ones_refused(tmp_path: Path) -> None:
    splats = some_splats(4, 0)
    splats = replace(splats, scales=np.full_like(splats.scales, 1e-20))
    sizes = np.array([0.0, 1e-3, np.nan, np.inf], np.float32)
    found = read_splats(with_filter(splats, sizes, tmp_path / "a.ply"))
    assert found.num_gaussians == 1  # the second is invisible, the others are invalid
    assert float(found.scales[0, 0]) == pytest.approx(1e-20, rel=1e-4)


@pytest.mark.parametrize(
    "name",
    [
        *("filter_3D_0", "filter_2D", "mip_filter", "antialias", "smoothing", "trbf_center", "motion_0", "t"),
        *("deleted", "sg_axis_0", "sb_params_0"),
    ],
)
def test_unsupported_columns_that_may_change_gaussians_give_a_warning(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(20, 0)
    found = read_splats(with_filter(splats, np.ones(20), tmp_path / "a.ply", name))
    assert np.allclose(found.scales, splats.scales, rtol=1e-5)
    assert f"properties {name} are not known and left out" in caplog.text


@pytest.mark.parametrize(
    "comment",
    [
        "antialiasing: mip-splatting filter of 0.3 px", "SplatRenderMode: smooth", "trained without antialiasing",
        "mip-splatting with a kernel of 0.1", "rasterize_mode: 2", "use_mip_filter 2",
    ],
)  # fmt: skip
def test_unparsable_antialiasing_comments_give_a_warning(
    comment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert not read_content(commented(tmp_path, comment)).antialiased
    assert f"comment '{comment}' is not understood: the scene is drawn without antialiasing" in caplog.text


def test_contradictory_comments_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(commented(tmp_path, "antialiased 1", "SplatRenderMode: default"))
    assert "comments enable and disable antialiasing: the scene is drawn without it" in caplog.text
    caplog.clear()
    assert read_content(commented(tmp_path, "Vertical Axis: z", "y-up", "up: sideways")).metadata.up == "y"
    assert "comments name different axes that are up: z, y" in caplog.text
    caplog.clear()
    read_content(commented(tmp_path, "Vertical Axis: z", "z-up", "aa 1", "SplatRenderMode: mip"))
    assert not caplog.messages


@pytest.mark.parametrize("comment", ["SplatRenderMode: default", "antialiased 0", "Made by a program", "mipmap 1"])
def test_other_comments_give_no_warning(comment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(commented(tmp_path, comment))
    assert not caplog.messages


def test_a_long_header_is_refused_with_its_limit(tmp_path: Path) -> None:
    path = commented(tmp_path, *("x" * 1000 for _ in range(1000)))
    with pytest.raises(DatasetError, match="header is longer than 65,536 bytes: shorten its comments"):
        read_content(path)


@pytest.mark.parametrize(
    ("comment", "reason"),
    [
        ("splatwire-origin 1 2", "is not three numbers within 1e12"),
        ("splatwire-origin 1 2 nan", "is not three numbers within 1e12"),
        ("splatwire-offset 451234 5411876 118", "may be a shift of the positions"),
        ("global_shift 451234 5411876 118", "may be a shift of the positions"),
        ("Global Shift: -451234 -5411876 0", "may be a shift of the positions"),
        ("shift_x 451234", "may be a shift of the positions"),
        ("offsetZ: 1", "may be a shift of the positions"),
        ("offset: [451234, 5411876, 118]", "may be a shift of the positions"),
    ],
)
def test_unused_origin_comments_give_a_warning(
    comment: str, reason: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert read_content(commented(tmp_path, comment)).origin == (0, 0, 0)
    assert f"comment '{comment}' {reason}" in caplog.text


def test_contradictory_origins_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    content = read_content(commented(tmp_path, "splatwire-origin 1 0 0", "splatwire-origin 2 0 0"))
    assert content.origin == (1, 0, 0)
    assert "comment 'splatwire-origin 2 0 0' differs from an earlier one: (1 0 0) is used" in caplog.text


def test_shift_comment_in_a_compressed_ply_gives_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.compressed.ply"
    write_splats([some_splats(30, 0)], path)
    comments = b"comment splatwire-offset 1 2\ncomment global_shift 1 2 3\nelement chunk"
    path.write_bytes(path.read_bytes().replace(b"element chunk", comments, 1))
    read_content(path)
    assert "comment 'splatwire-offset 1 2' is not three numbers within 1e12" in caplog.text
    assert "comment 'global_shift 1 2 3' may be a shift of the positions" in caplog.text


@pytest.mark.parametrize(
    "comment",
    [
        "translation 451234.5 5411876 100", "Shift applied: x=-400000 y=-5000000", "shifted by 4.5e5, 5.4e6, 0",
        "origin: (451,234.5, 5,411,876.25, 118)", "local_origin 1 2 3", "scene center: 100 200 5", "geoOffset 1 2 3",
        "reference point 48.1 11.5 500", "LLA: 48.1, 11.5, 500", "latlon 48.1 11.5",
        "CloudCompare global shift (x,y,z) = (-4.5e5,-5.4e6,0)", "northing 5411876",
        "transform 2 0 0 5 0 2 0 0 0 0 2 0 0 0 0 1", "sim3 2 0 0 0 1 10 20 30", "mean 1 2 3", "pose 1 0 0 0 4 5 6",
        "world_to_local 0 0 1 0 1 0 0 0 0 1 0 0 0 0 0 1", "WorldToLocal = [1 0 0 5; 0 1 0 6; 0 0 1 7]", "offset 1 0 1",
        "T_world_local 1 2 3 0 0 0 1", "gps 48.1 11.5", "location: 48, 11, 300", "georegistration 1 2 3",
        "camera pose: 1.5e2, 2, 3", "transform 0 1 0 1 0 0 0 0 1", "Exported from Metashape, offset 450000 5400000 0",
    ],
)  # fmt: skip
@pytest.mark.parametrize("keyword", ["comment", "obj_info"])
def test_shift_comments_of_any_wording_give_a_warning(
    keyword: str, comment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = commented(tmp_path, comment)
    path.write_bytes(path.read_bytes().replace(f"comment {comment}".encode(), f"{keyword} {comment}".encode(), 1))
    assert read_content(path).origin == (0, 0, 0)
    assert f"comment {comment!r} may be a shift of the positions: it is left out" in caplog.text


@pytest.mark.parametrize(
    ("comment", "meaning"),
    [
        ("recenter 10 20 30", "a shift of the positions"),
        ("normalization 0.5 0.5 0.5 2", "a shift of the positions"),
        ("offsetx 451234", "a shift of the positions"),
        ("units cm", "the unit of the positions"),
        ("unit = inches", "the unit of the positions"),
        ("coordinates in millimetres", "the unit of the positions"),
        ("scale 0.01", "a scale of the positions"),
        ("sceneScale: 2.5", "a scale of the positions"),
        ("metersPerUnit 0.01", "the unit of the positions"),
        ("EPSG:25832", "the coordinate reference system of the positions"),
        ("crs UTM zone 33N", "the coordinate reference system of the positions"),
        ("rotate x 180", "a rotation of the positions"),
        ("flip y", "a rotation of the positions"),
        ("flipped: 1", "a rotation of the positions"),
        ("rotation 0.7 0 0.7 0", "a rotation of the positions"),
        ("quaternion: 0.7 0.7 0 0", "a rotation of the positions"),
        ("euler angles 90 0 0", "a rotation of the positions"),
        ("coordinate system: OpenGL", "a system of axes"),
        ("left-handed", "a system of axes"),
        ("up axis: q", "a system of axes"),
        ("opacity: linear", "another unit of opacities or scales"),
        ("scales are activated", "another unit of opacities or scales"),
        ("opacity range 0-255", "another unit of opacities or scales"),
        ("quaternion order: xyzw", "another order of the rotations"),
        ("ColorSpace: linear", "another colour space"),
        ("gamma 2.2", "another colour space"),
        ("up 0.6 0.7 0", "a system of axes"),
        ("Vertical axis: nan 1 0", "a system of axes"),
    ],
)
def test_unapplied_unit_scale_and_axis_comments_give_a_warning(
    comment: str, meaning: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_content(commented(tmp_path, comment))
    assert f"comment {comment!r} may be {meaning}: it is left out" in caplog.text


@pytest.mark.parametrize(
    "comment",
    [
        "Generated by SuperSplat 1.7.1", "Created by CloudCompare v2.13 (Kharkiv)", "Generated by Nerfstudio 1.1.5",
        "title: Center of town, 1:100 scale", "units m", "coordinates in metres", "scale 1.0", "offset 0 0 0",
        "translation 0 0 0", "rotation 1 0 0 0", "rotation: 0.0", "flipped: 0",
        "rotation 1 0 0 0 1 0 0 0 1", "quaternion order wxyz", "the 3 4 5 of all", "location: Berlin",
        "rotation: (1, 0, 0, 0)", "coordinate system: RDF", "File cleaned up 2024",
        "Generated by splat-transform 1.10.2", "splat-transform v2.0.0", "Created in Scale Studio 3.1",
        "colorspace: sRGB", "opacity: logit", "scales: log", "rotations are wxyz", "opacities are not linear",
        "original file scene_01.ply", "Generated by opensplat at iteration 30000", "multiscale, 3 levels",
        "transform 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "world_to_local 1 0 0 0 0 1 0 0 0 0 1 0", "sim3 1 1 0 0 0 0 0 0",
        "mean psnr 27.1 ssim 0.8 lpips 0.2", "pose graph of 12 views", "mean 0 0 0", "author Shift 1 2 3",
        "Vertical Axis: z", "up vector: (0, -1, 0)",
    ],
)  # fmt: skip
def test_comments_without_effect_on_the_positions_give_no_warning(
    comment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_content(commented(tmp_path, comment))
    assert not caplog.messages


@pytest.mark.parametrize(
    ("comment", "up"),
    [
        ("Vertical Axis: z", "z"), ("up z", "z"), ("z-up", "z"), ("Up Axis: +Y", "y"), ("up vector: (0, -1, 0)", "-y"),
        ("UP: 0 0 1", "z"), ("Y_UP", "y"), ("up: sideways", None), ("up 0 0.5 0.5", None),
        ("Vertical axis: y", "-y"), ("Vertical axis: +y", "y"), ("Vertical axis: 0.013 -0.9987 0.0488", "-y"),
        ("Vertical axis: 0.02 0.05 -0.998", "z"), ("Vertical axis: 0 0 1", "z"), ("Vertical axis: 0.99 0.1 0", None),
        ("Vertical axis: y.", "-y"), ("vertical axis: y;", "-y"), ("Vertical axis: 0.02 0.05 -0.998;", "z"),
        ("Vertical axis: 1 0 0", "x"), ("Vertical axis: 0 0.7 0.7", None), ("Vertical axis: z.", "z"),
    ],
)  # fmt: skip
def test_the_axis_that_is_up_has_several_notations(comment: str, up: str | None, tmp_path: Path) -> None:
    assert read_content(commented(tmp_path, comment)).metadata.up == up


def changed(folder: Path, count: int, **columns: np.ndarray | None) -> Path:
    """A PLY with other opacities, scales or colours (f_dc)."""
    path = folder / "a.ply"
    write_splats([some_splats(count, 0)], path)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[-1] for line in head.decode().splitlines() if line.startswith("property")]
    rows = np.frombuffer(data, "<f4").reshape(count, -1).copy()
    for prefix, values in columns.items():
        for place, name in enumerate(names):
            if name.startswith(prefix):
                rows[:, place] = values
    path.write_bytes(head + mark + rows.tobytes())
    return path


@pytest.mark.parametrize("count", [4, 9, 30])
@pytest.mark.parametrize(("prefix", "word"), [("opacity", "logits"), ("scale_", "logarithms")])
def test_linear_opacities_and_scales_give_a_warning(
    prefix: str, word: str, count: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_content(changed(tmp_path, count))
    assert not caplog.messages
    read_content(changed(tmp_path, count, **{prefix: np.linspace(0.01, 0.9, count)}))
    assert "are from 0.01 to 0.9, so they may be linear" in caplog.text
    assert f"read as {word}" in caplog.text
    assert len(caplog.messages) == 1


@pytest.mark.parametrize("count", [1, 2, 3])
def test_linear_values_of_very_few_gaussians_give_a_warning(
    count: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_content(changed(tmp_path, count, opacity=np.full(count, 0.9), scale_=np.full(count, 0.05)))
    assert "all scales are from 0.05 to 0.05, so they may be linear" in caplog.text
    assert "all opacities are from 0.9 to 0.9, so they may be linear" in caplog.text


def test_one_invalid_row_does_not_hide_linear_columns(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    opacities = np.linspace(0.01, 0.9, 200)
    opacities[3], opacities[5] = np.nan, 1.2
    read_content(changed(tmp_path, 200, opacity=opacities))
    assert "all opacities are from 0.01 to 1.2, so they may be linear" in caplog.text


@pytest.mark.parametrize("values", [np.linspace(0, 255, 30), np.arange(30) % 4, np.linspace(0, 100, 30)])
def test_opacities_with_another_maximum_give_a_warning(
    values: np.ndarray, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_content(changed(tmp_path, 30, opacity=values))
    assert "so they may be from 0 to 255 or another maximum; they are read as logits" in caplog.text


def test_colours_from_0_to_255_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(changed(tmp_path, 30, f_dc_=np.linspace(0, 255, 30)))
    assert "all properties f_dc_* are from 0 to 255, so they may be colours from 0 to 255" in caplog.text


@pytest.mark.parametrize("extent", [0.2, 2.0, 500.0, 20_000.0])
@pytest.mark.parametrize("count", [2, 12, 3000])
def test_plausible_logits_and_logarithms_give_no_warning(
    extent: float, count: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rng, splats = np.random.default_rng(7), some_splats(count, 0)
    scales = extent / 500 * np.exp(rng.normal(size=(count, 3)) * 0.7)
    opacities = rng.beta(0.5, 0.5, count).clip(0.01, 0.999)
    scene = replace(splats, means=splats.means * extent, scales=scales, opacities=opacities)
    write_splats([Splats(**{k: np.asarray(v, np.float32) for k, v in vars(scene).items()})], tmp_path / "a.ply")
    read_content(tmp_path / "a.ply")
    assert not caplog.messages


def retyped(folder: Path, **kinds: str) -> Path:
    """A PLY with properties of other types."""
    path = changed(folder, 30)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[-1] for line in head.decode().splitlines() if line.startswith("property")]
    types = {"uchar": "u1", "float": "<f4", "int": "<i4"}
    rows = np.frombuffer(data, "<f4").reshape(30, -1)
    other = np.zeros(30, [(name, types[kinds.get(name, "float")]) for name in names])
    for place, name in enumerate(names):
        other[name] = np.abs(rows[:, place]) if name in kinds else rows[:, place]
        head = head.replace(
            f"property float {name}\n".encode(), f"property {kinds.get(name, 'float')} {name}\n".encode()
        )
    path.write_bytes(head + mark + other.tobytes())
    return path


def test_integer_properties_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(retyped(tmp_path, rot_1="uchar", f_dc_0="int"))
    assert "properties f_dc_0, rot_1 are integers, so they may be quantised" in caplog.text
    caplog.clear()
    read_content(retyped(tmp_path, nx="uchar", ny="int"))
    assert not caplog.messages


def test_byte_opacities_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(retyped(tmp_path, opacity="uchar"))
    assert "so they may be" in caplog.text


@pytest.mark.parametrize(("space", "named"), [(0, False), (1, True)])
def test_linear_colours_of_sharp_give_a_warning(
    space: int, named: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = changed(tmp_path, 30)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    path.write_bytes(head + b"element color_space 1\nproperty uchar color_space\n" + mark + data + bytes([space]))
    read_content(path)
    assert ("element color_space is 1, linear RGB" in caplog.text) == named


def without(folder: Path, *prefixes: str, extra: tuple[str, ...] = ()) -> Path:
    """A text PLY without some properties, and with others that are 0."""
    path = folder / "text.ply"
    head = changed(folder, 30).read_bytes().partition(b"end_header\n")[0].decode().splitlines()
    names = [line.split()[-1] for line in head if line.startswith("property")]
    names = [name for name in names if not name.startswith(prefixes)] + list(extra)
    lines = ["ply", "format ascii 1.0", "element vertex 30", *(f"property float {name}" for name in names)]
    path.write_text("\n".join([*lines, "end_header", *[" ".join(["0"] * len(names))] * 30]) + "\n")
    return path


def test_errors_for_2dgs_and_coloured_points_explain_the_conversion(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"2 properties scale_\*, .* those of 2DGS are flat: add a property scale_2"):
        read_content(without(tmp_path, "scale_2"))
    with pytest.raises(DatasetError, match=r"has colours \(red, green, blue\) and no properties f_dc_\*: write f_dc"):
        read_content(without(tmp_path, "f_dc_", extra=("red", "green", "blue")))
    for gone, extra in ((("scale_",), ("scale",)), (("scale_1", "scale_2"), ())):
        with pytest.raises(DatasetError, match="isotropic Gaussians have their only size three times"):
            read_content(without(tmp_path, *gone, extra=extra))


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("commented_offset.xyz", "451234 5411876 118", True),
        ("offset.xyz", "451234 5411876 118", True),
        ("metadata.xml", "<ModelMetadata><SRSOrigin>451234,5411876,0</SRSOrigin></ModelMetadata>", True),
        ("metadata.xml", "<ModelMetadata></ModelMetadata>", False),
        ("other_offset.xyz", "451234 5411876 118", False),
    ],
)  # fmt: skip
def test_file_next_to_a_ply_with_its_shift_gives_a_warning(
    name: str, content: str, named: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = commented(tmp_path)
    (tmp_path / name).write_text(content)
    read_content(path)
    assert (f"commented.ply: {name} beside it may have a shift of the positions" in caplog.text) == named
    assert bool(caplog.messages) == named


@pytest.mark.parametrize(
    "comment", ["kernel_size 0.1", "2D filter 0.3", "low-pass filter", "eps2d 0.1", "dilation: 0.1", "filter size 0.3"]
)
def test_filter_comments_give_a_warning(comment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert not read_content(commented(tmp_path, comment)).antialiased
    assert "is not understood: the scene is drawn without antialiasing" in caplog.text


@pytest.mark.parametrize(("comment", "expected"), [("aa: true", True), ("aa 1", True), ("AA=0", False)])
def test_comment_aa_means_antialiasing(comment: str, expected: bool, tmp_path: Path) -> None:
    assert read_content(commented(tmp_path, comment)).antialiased is expected


def test_integer_positions_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_content(retyped(tmp_path, x="int", y="int", z="int"))
    assert "properties x, y, z are integers, so they may be quantised" in caplog.text


def test_a_field_with_a_long_name_takes_little_time(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    before = time.process_time()
    warn_of_unused_fields(tmp_path / "a.sog", {f"colour space {1_000_000 * '-'}!": 1.0, "shift": [1, 2, 3]})
    assert time.process_time() - before < 5
    assert "field 'shift: 1 2 3' may be a shift of the positions" in caplog.text
