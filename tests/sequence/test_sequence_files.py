"""Clips of other programs, checked by their own packages: `.4dgs` (fourdgs) and `.splat4d` (splats4d)."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.errors import DatasetError
from splatwire.files.kinds import FOURDGS, SPLAT4D, file_kind
from splatwire.io.formats import write_splats
from splatwire.io.formats.content import FileContent, relative_to_first
from splatwire.io.formats.dispatch import read_content
from splatwire.sequence.frame_writer import write_frame_files
from splatwire.sequence.frames import is_sequence, open_sequence
from splatwire.sequence.sequence_files import sequence_format_for
from splatwire.types.metadata import SceneMetadata
from splatwire.types.splats import Splats

PROGRAM = shutil.which("splat4d", path=str(Path(sys.executable).parent)) or shutil.which("splat4d")
needs_splat4d = pytest.mark.skipif(PROGRAM is None, reason="splats4d is not installed")


def cloud(count=200, degree=1):
    rng = Numbers(5)
    quats = rng.randn(count, 4)
    return Splats(
        rng.randn(count, 3),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        0.02 + 0.05 * rng.rand(count, 3),
        0.3 + 0.6 * rng.rand(count),
        0.3 * rng.randn(count, (degree + 1) ** 2, 3).clip(-1.4, 1.4),
    )


def clip(degree=1, frames=4, count=200):
    """Half of the Gaussians move, the others rest."""
    first, moves = cloud(count, degree), np.arange(count) % 2 == 0
    for number in range(frames):
        shift = np.float32([0.1 * number, 0, 0]) * moves[:, None]
        yield FileContent(replace(first, means=(first.means + shift).astype(np.float32)))


def write(frames, path, rate=24.0):
    return sequence_format_for(str(path)).write(frames, path, rate)


def nearest(found, expected):
    """Indices of the Gaussians of `found` that are nearest to those of `expected`."""
    return np.array([int(np.argmin(((found.means - mean) ** 2).sum(axis=1))) for mean in expected.means])


def assert_close(found, expected, *, scales, colors):
    assert found.num_gaussians == expected.num_gaussians
    order = nearest(found, expected)
    assert len(set(order.tolist())) == len(order)
    found = found.select(order)
    np.testing.assert_allclose(found.means, expected.means, atol=4e-3)
    np.testing.assert_allclose(found.scales, expected.scales, rtol=scales)
    np.testing.assert_allclose(found.opacities, expected.opacities, atol=0.03)
    np.testing.assert_allclose(np.abs((found.quats * expected.quats).sum(axis=1)), 1, atol=2e-3)
    np.testing.assert_allclose(found.sh[:, 0], expected.sh[:, 0], atol=colors)


def test_4dgs_keeps_the_frames(tmp_path):
    fourdgs = pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    path = tmp_path / "a.4dgs"
    assert write(clip(), path) == 4
    assert file_kind(path) == FOURDGS
    assert is_sequence(path)
    scene = fourdgs.read(str(path))
    assert scene.duration_sec == pytest.approx(4 / 24)
    assert scene.gaussians.count == 100 + 4 * 100  # those that rest have one record
    sequence = open_sequence(path)
    assert (sequence.num_frames, sequence.rate) == (4, 24.0)
    for frame, expected in zip(sequence.read(), clip(), strict=True):
        assert_close(frame.splats, expected.splats, scales=0.03, colors=0.03)
        found = frame.splats.select(nearest(frame.splats, expected.splats))
        np.testing.assert_allclose(found.sh, expected.splats.sh, atol=0.04)


def test_4dgs_files_of_other_programs_keep_their_axes(tmp_path):
    fourdgs = pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    splats = cloud(degree=0)
    ones = np.ones(200, np.float32)
    records = fourdgs.GaussianSet(
        positions=splats.means, scales=splats.scales, rotations=np.roll(splats.quats, -1, axis=1),
        colors=np.concatenate([np.clip(0.5 + 0.2820948 * splats.sh[:, 0], 0, 1), splats.opacities[:, None]], axis=1),
        motions=np.tile(np.float32([3, 0, 0]), (200, 1)), mu_t=0 * ones, sigma_t=np.inf * ones, win_lo=0 * ones,
        win_hi=ones,
    )  # fmt: skip
    for axes, flips in (("", [1, 1, 1]), ("z-up-right-handed", [1, 1, 1]), ("y-up-right-handed", [1, -1, -1])):
        options = fourdgs.WriteOptions(metadata={"coordinate_system": axes} if axes else None)
        fourdgs.write(str(tmp_path / "a.4dgs"), records, 1.0, options=options)
        sequence = open_sequence(tmp_path / "a.4dgs")
        assert (sequence.num_frames, sequence.rate) == (30, 30.0)
        last = list(sequence.read())[-1]
        moved = (splats.means + np.float32([3 * 29.5 / 30, 0, 0])) * np.float32(flips)
        np.testing.assert_allclose(np.sort(last.splats.means, axis=0), np.sort(moved, axis=0), atol=0.01)
        assert last.metadata.up == ("z" if axes.startswith("z") else None)


@pytest.mark.parametrize(
    ("attributes", "frame", "warning"),
    [
        ({"coordinate_system": "y-up-right-handed", "color_space": "srgb-rec709-display"}, False, ""),
        ({"coordinate_system": "x-up-left-handed"}, False, "coordinate_system 'x-up-left-handed' is not known"),
        ({"color_space": "linear-rec709-display"}, False, "color_space 'linear-rec709-display' is read as srgb"),
        ({}, True, "its coordinate frames and geodetic anchors are left out"),
    ],
)
def test_statements_of_4dgs_files_that_are_not_applied_give_a_warning(tmp_path, caplog, attributes, frame, warning):
    fourdgs = pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    from fourdgs import records as records_of
    from fourdgs.provenance import Provenance

    write(clip(frames=1), tmp_path / "a.4dgs")
    records = fourdgs.read(str(tmp_path / "a.4dgs")).gaussians
    frames = [records_of.CoordinateFrame("", 1, 2, 3, 1, 1.0)] if frame else []
    options = fourdgs.WriteOptions(metadata=attributes, provenance=Provenance(frames))
    fourdgs.write(str(tmp_path / "b.4dgs"), records, 1.0, options=options)
    open_sequence(tmp_path / "b.4dgs")
    assert warning in caplog.text
    assert bool(caplog.messages) == bool(warning)


def test_damaged_4dgs_is_one_error(tmp_path):
    pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    write(clip(), tmp_path / "a.4dgs")
    data = (tmp_path / "a.4dgs").read_bytes()
    for cut in (9, 60, len(data) // 2):
        (tmp_path / "b.4dgs").write_bytes(data[:cut])
        with pytest.raises(DatasetError, match=r"b\.4dgs"):
            list(open_sequence(tmp_path / "b.4dgs").read())


def test_a_4dgs_file_that_announces_too_many_gaussians_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    fourdgs = pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    count = 300_000
    zeros, ones = np.zeros((count, 4), np.float32), np.ones((count, 4), np.float32)
    same = fourdgs.GaussianSet(
        positions=zeros[:, :3], scales=ones[:, :3], rotations=np.eye(4, dtype=np.float32)[[3] * count], colors=ones,
        motions=zeros[:, :3], mu_t=zeros[:, 0], sigma_t=ones[:, 0], win_lo=zeros[:, 0], win_hi=ones[:, 0],
        sh=None, sh_degree=0,
    )  # fmt: skip
    fourdgs.write(str(tmp_path / "a.4dgs"), same, 1.0)
    assert (tmp_path / "a.4dgs").stat().st_size < 10_000
    monkeypatch.setattr(fourdgs, "read", None)
    with pytest.raises(DatasetError, match="a count of 300000 Gaussians is more than"):
        open_sequence(tmp_path / "a.4dgs")


@needs_splat4d
def test_splat4d_keeps_the_frames(tmp_path):
    path = tmp_path / "a.splat4d"
    assert write(clip(degree=0), path) == 4
    assert file_kind(path) == SPLAT4D
    assert is_sequence(path)
    done = subprocess.run([str(PROGRAM), "info", str(path)], capture_output=True, text=True, check=True)
    header = json.loads(done.stdout[: done.stdout.rindex("}") + 1])
    assert (header["n"], header["t"], header["fps"]) == (200, 4, 24)
    sequence = open_sequence(path)
    assert (sequence.num_frames, sequence.rate) == (4, 24.0)
    for frame, expected in zip(sequence.read(), clip(degree=0), strict=True):
        assert_close(frame.splats, expected.splats, scales=0.04, colors=0.06)


@needs_splat4d
def test_clipped_colours_of_splat4d_are_one_warning_with_the_name_of_the_file(tmp_path, caplog):
    splats = cloud(20, 0)
    frames = [replace(splats, sh=splats.sh + number) for number in (0, 2, 3)]
    write([FileContent(frame) for frame in frames], tmp_path / "a.splat4d")
    (message,) = [record.getMessage() for record in caplog.records if "base colours" in record.getMessage()]
    assert message.startswith(f"{tmp_path / 'a.splat4d'}: base colours of 20 of 20 Gaussians")


def scaled_clip(factor):
    for frame in clip(degree=0):
        splats = frame.splats
        yield FileContent(replace(splats, means=splats.means * factor, scales=splats.scales * factor))


@needs_splat4d
def test_positions_of_small_scenes_in_splat4d_are_as_precise_as_their_gaussians(tmp_path):
    for factor in (np.float32(0.1), np.float32(0.001)):
        write(scaled_clip(factor), tmp_path / "a.splat4d")
        for frame, expected in zip(open_sequence(tmp_path / "a.splat4d").read(), scaled_clip(factor), strict=True):
            found = frame.splats.select(nearest(frame.splats, expected.splats))
            np.testing.assert_allclose(found.means, expected.splats.means, atol=0.2 * factor * 0.07)


@pytest.mark.parametrize("end", [".4dgs", pytest.param(".splat4d", marks=needs_splat4d)])
@pytest.mark.parametrize("far", [1e7, 1e12, 1e30])
@pytest.mark.parametrize(("count", "shape"), [(20, (1, 1, 1)), (100, (1, 0.1, 0.1)), (200, (1, 0.1, 0.1))])
def test_a_gaussian_beyond_the_range_of_a_format_is_moved_with_a_warning(tmp_path, caplog, end, far, count, shape):
    pytest.importorskip("fourdgs", reason="fourdgs is not installed")

    def frames():
        for frame in clip(degree=0, count=count):
            means = frame.splats.means.copy()
            means[7] = (far, 0, -far)
            yield FileContent(replace(frame.splats, means=means, scales=frame.splats.scales * np.float32(shape)))

    write(frames(), tmp_path / f"a{end}")
    assert caplog.text.count("Gaussians are up to") == 1
    assert "1 of " in caplog.text
    others = np.arange(count) != 7
    for frame, expected in zip(open_sequence(tmp_path / f"a{end}").read(), frames(), strict=True):
        found = frame.splats.select(nearest(frame.splats, expected.splats.select(others)))
        np.testing.assert_allclose(found.means, expected.splats.means[others], atol=4e-3)


def test_a_moving_gaussian_beyond_the_range_of_4dgs_is_moved(tmp_path, caplog):
    """Each frame has another interval of the moving Gaussian, so that most intervals are beyond the range."""
    pytest.importorskip("fourdgs", reason="fourdgs is not installed")

    def frames():
        for number in range(30):
            splats = cloud(40, 0)
            splats.means[:15] = (1e12 * (1 + number), 0, 0)
            yield FileContent(splats)

    write(frames(), tmp_path / "a.4dgs")
    assert "450 of 475 Gaussians are up to" in caplog.text
    for frame, expected in zip(open_sequence(tmp_path / "a.4dgs").read(), frames(), strict=True):
        found = frame.splats.select(nearest(frame.splats, expected.splats.select(np.arange(40) >= 15)))
        np.testing.assert_allclose(found.means, expected.splats.means[15:], atol=4e-3)


@needs_splat4d
def test_a_scene_that_is_large_only_because_of_several_gaussians_gives_a_warning(tmp_path, caplog):
    splats = cloud(20, 0)
    splats.means[:2] = 1e12
    write([FileContent(splats)], tmp_path / "a.splat4d")
    assert "positions are rounded to steps of" in caplog.text
    caplog.clear()
    write(clip(degree=0), tmp_path / "a.splat4d")
    assert not caplog.text


def test_values_that_4dgs_cannot_store_are_one_error(tmp_path):
    pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    frame = next(clip(degree=0))
    scales = np.full_like(frame.splats.scales, 1e-30)
    with pytest.raises(DatasetError, match=r"a\.4dgs: fourdgs cannot store the values of these Gaussians"):
        write([FileContent(replace(frame.splats, scales=scales))], tmp_path / "a.4dgs")
    assert not (tmp_path / "a.4dgs").exists()


@pytest.mark.parametrize(("suffix", "same"), [(".spz", True), (".splat", True), (".ply", False), (".glb", False)])
def test_frame_files_without_world_coordinates_have_one_origin(tmp_path, suffix, same):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    for number in range(3):
        write_splats([cloud(20, 0)], tmp_path / "in" / f"{number}.ply", origin=(5e5 + 2 * number, 4e6, 0.0))
    write_frame_files(open_sequence(tmp_path / "in"), tmp_path / "out", suffix, lambda *_: None)
    contents = [read_content(path) for path in sorted((tmp_path / "out").iterdir())]
    assert (len({content.origin for content in contents}) == 1) is same
    centres = [float(content.splats.means[:, 0].mean()) + content.origin[0] for content in contents]
    np.testing.assert_allclose(np.diff(centres), 2, atol=0.1)


def test_an_empty_first_frame_does_not_choose_the_origin_of_frame_files(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    for number in range(4):
        splats = cloud(20, 0)
        if number < 2:
            splats = replace(splats.select(np.arange(1)), means=np.zeros((1, 3)), opacities=np.zeros(1))
        write_splats([splats], tmp_path / "in" / f"{number}.ply", origin=(5e5 * (number >= 2), 0.0, 0.0))
    write_frame_files(open_sequence(tmp_path / "in"), tmp_path / "out", ".spz", lambda *_: None)
    contents = [read_content(path) for path in sorted((tmp_path / "out").iterdir())]
    assert len(contents) == 4
    for content in contents[2:]:
        centre = np.median(content.splats.means.astype(np.float64), axis=0) + content.origin
        np.testing.assert_allclose(centre, np.median(cloud(20, 0).means, axis=0) + np.array([5e5, 0, 0]), atol=1e-3)


def test_an_empty_first_frame_does_not_choose_the_origin_of_a_file(tmp_path):
    pytest.importorskip("pxr")
    empty = FileContent(replace(cloud(20, 0), opacities=np.zeros(20, np.float32)))
    write([empty, FileContent(cloud(20, 0), origin=(5e5, 4e6, 0.0))], tmp_path / "a.usdc")
    *_, last = open_sequence(tmp_path / "a.usdc").read()
    assert last.origin == (5e5, 4e6, 0.0)
    order = nearest(last.splats, cloud(20, 0))
    np.testing.assert_allclose(last.splats.means[order], cloud(20, 0).means, atol=0.01)


@needs_splat4d
def test_an_origin_that_a_file_cannot_hold_is_that_of_the_first_visible_frame(tmp_path, caplog):
    empty = FileContent(replace(cloud(20, 0), opacities=np.zeros(20, np.float32)))
    write([empty, FileContent(cloud(20, 0), origin=(5e5, 4e6, 0.0))], tmp_path / "a.splat4d")
    assert "origin (500000, 4000000, 0)" in caplog.text


def test_frames_are_relative_to_the_first_visible_one():
    visible = FileContent(cloud(20, 0), origin=(5e5, 0.0, 0.0))
    clear = FileContent(replace(cloud(20, 0), opacities=np.zeros(20, np.float32)))
    for frames in ([clear, visible], [visible, clear], [clear] * 3, []):
        origins = [frame.origin for frame in relative_to_first(frames)]
        assert origins == [visible.origin if visible in frames else clear.origin] * len(frames)
    many = FileContent(clear.splats.select(np.zeros(1 << 19, np.int64)))
    taken = []
    for frame in relative_to_first(taken.append(0) or each for each in [many] * 5):
        assert frame.origin == many.origin
        break
    assert len(taken) == 3


@needs_splat4d
def test_splat4d_needs_the_same_gaussians_in_all_frames(tmp_path, caplog):
    frames = [next(clip()), FileContent(cloud(100))]
    with pytest.raises(DatasetError, match="same Gaussians in all frames"):
        write(frames, tmp_path / "a.splat4d")
    assert not (tmp_path / "a.splat4d").exists()
    assert "harmonics are left out" in caplog.text


@pytest.mark.parametrize("head", [b"SP4D", b"SP4D\1\0\0\0\xff\xff\xff\xff{", b"SP4D\1\0\0\0\2\0\0\0{}"])
def test_damaged_splat4d_is_one_error(tmp_path, head):
    (tmp_path / "a.splat4d").write_bytes(head)
    with pytest.raises(DatasetError, match="header is damaged"):
        open_sequence(tmp_path / "a.splat4d")


def test_what_a_4dgs_file_cannot_store_gives_a_warning(tmp_path, caplog):
    pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    write(clip(), tmp_path / "a.4dgs")
    assert not caplog.messages
    frames = [
        replace(frame, antialiased=True, origin=(5e5, 0.0, 0.0), metadata=SceneMetadata(title="Garden"))
        for frame in clip()
    ]
    frames[0].splats.sh[3, 0] = 4
    write(frames, tmp_path / "a.4dgs")
    for problem in ("antialiasing", "500000", "title", "base colours of 1 of"):
        assert problem in caplog.text


@needs_splat4d
def test_frames_of_splat4d_are_relative_to_one_origin(tmp_path, caplog):
    frames = [frame.relative_to((float(number), 0.0, 0.0)) for number, frame in enumerate(clip(degree=0))]
    write(frames, tmp_path / "a.splat4d")
    for frame, expected in zip(open_sequence(tmp_path / "a.splat4d").read(), clip(degree=0), strict=True):
        assert_close(frame.splats, expected.splats, scales=0.04, colors=0.06)


@needs_splat4d
def test_a_splat4d_file_with_a_damaged_header_is_one_short_error(tmp_path, monkeypatch):
    monkeypatch.setenv("RUST_BACKTRACE", "1")
    write(clip(degree=0), tmp_path / "a.splat4d")
    data = (tmp_path / "a.splat4d").read_bytes()
    (tmp_path / "b.splat4d").write_bytes(data.replace(b'"gops"', b'"gapz"', 1))
    with pytest.raises(DatasetError, match="missing field `gops`") as caught:
        list(open_sequence(tmp_path / "b.splat4d").read())
    assert "main" not in str(caught.value)
