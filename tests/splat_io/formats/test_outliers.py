"""Single Gaussians with extreme values do not affect the others in formats with shared ranges."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import unit
from splat_io.formats.handmade import some_splats
from splatwire.errors import UnknownNameError
from splatwire.io.formats import read_splats, write_splats
from splatwire.io.formats._codebooks import nearest_number, number_codebook
from splatwire.io.formats.outliers import check_outliers, find_outliers, pull_into_box
from splatwire.io.formats.ply_file import read_ply_elements
from splatwire.ops.knn import NeighborTree
from splatwire.types.splats import Splats

ENDS = ("spz", "sog", "compressed.ply")
FAR = 7


def with_floater(count: int = 600, far: float = 1e6) -> Splats:
    """Gaussians around 0, and one very far away."""
    splats = some_splats(count, 0)
    splats.means[FAR] = (far, -far / 3, 10)
    splats.scales[FAR] = far / 100
    return splats


def without(splats: Splats) -> Splats:
    return splats.select(np.arange(splats.num_gaussians) != FAR)


def errors(found: Splats, expected: Splats) -> np.ndarray:
    """Distance of each expected Gaussian from the nearest found one."""
    apart = expected.means[:, None].astype(np.float64) - found.means[None]
    return np.asarray(np.linalg.norm(apart, axis=2).min(axis=1))


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("far", [1e6, 3e4])
def test_outlier_does_not_degrade_other_gaussians(
    end: str, far: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats, path = with_floater(far=far), tmp_path / f"a.{end}"
    others = without(splats)
    write_splats([others], path)
    alone = errors(read_splats(path), others)
    assert not caplog.messages
    write_splats([splats], path)
    found = read_splats(path)
    assert found.num_gaussians == 600
    assert errors(found, others).max() < 3 * alone.max()
    assert "1 of 600 Gaussians have outlying positions" in caplog.text
    assert f"{far:.4g}" in caplog.text
    assert "moved to the end" in caplog.text


@pytest.mark.parametrize("end", ENDS)
def test_outliers_are_kept_or_pruned_on_request(
    end: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:  # fmt: skip
    splats, path = with_floater(), tmp_path / f"a.{end}"
    assert write_splats([splats], path, outliers="prune") == 599
    pruned = read_splats(path)
    assert "left out" in caplog.text
    write_splats([without(splats)], path)
    alone = read_splats(path)
    assert all(np.array_equal(getattr(pruned, name), value) for name, value in vars(alone).items())
    assert write_splats([splats], path, outliers="keep") == 600
    assert float(np.abs(read_splats(path).means).max()) == pytest.approx(1e6, rel=1e-3)
    assert "kept" in caplog.text
    with pytest.raises(UnknownNameError, match="clamp, keep, prune"):
        check_outliers("remove")


def test_moved_outlier_keeps_its_angular_position_and_size() -> None:
    splats = with_floater(100)
    middle = np.array([0.1, 0.2, 0.3])
    moved = pull_into_box(splats, np.array([FAR]), middle, np.full(3, -5.0), np.full(3, 5.0))
    before, after = (some.means[FAR] - middle for some in (splats, moved))
    factor = np.linalg.norm(after) / np.linalg.norm(before)
    assert float(np.abs(moved.means[FAR]).max()) == pytest.approx(5)
    assert after / np.linalg.norm(after) == pytest.approx(before / np.linalg.norm(before), abs=1e-6)
    assert moved.scales[FAR] == pytest.approx(splats.scales[FAR] * factor, rel=1e-5)
    assert np.array_equal(without(moved).means, without(splats).means)


def test_large_scene_has_no_outliers(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats = some_splats(600, 0)
    large = replace(splats, means=splats.means * 5000)
    assert not find_outliers(large.means).outside.any()
    write_splats([large], tmp_path / "a.spz")
    assert "steps of 0.00" in caplog.text
    assert errors(read_splats(tmp_path / "a.spz"), large).max() < 0.0035


def test_far_backgrounds_of_captures_are_written_without_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(5000, 0)
    distances = np.exp(np.linspace(0, 5, 5000, dtype=np.float32))[:, None]  # up to 150 times as far
    splats = replace(splats, means=unit(splats.means) * distances)
    for end in ENDS:
        write_splats([splats], tmp_path / f"a.{end}")
    assert not caplog.messages


def test_outlying_colour_does_not_degrade_its_chunk(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats, path = some_splats(256, 0), tmp_path / "a.compressed.ply"
    splats.sh[FAR, 0, 1] = 1e4
    rest = np.arange(256) != FAR

    def worst(treatment: str) -> float:
        write_splats([splats], path, outliers=treatment)  # type: ignore[arg-type]
        found = read_splats(path)
        row = np.linalg.norm(splats.means[rest][:, None] - found.means[None], axis=2).argmin(axis=1)
        return float(np.abs(found.sh[row, 0] - splats.sh[rest, 0]).max())

    assert worst("keep") > 1
    assert worst("clamp") < 0.05
    assert worst("prune") < 0.05
    assert "1 of 256 Gaussians have outlying colours" in caplog.text


def test_codebooks_are_robust_to_outliers() -> None:
    values = np.random.default_rng(0).normal(size=20_000)
    for far in (1e3, 1e6, 1e9):
        both = [np.append(values, [far, -far]), values]
        books = [number_codebook(some, 256) for some in both]
        mean = [float(((book[nearest_number(values, book)] - values) ** 2).mean()) for book in books]
        assert mean[0] < 1.3 * mean[1]
        assert books[0][-1] == pytest.approx(far)


def test_compressed_ply_quality_is_independent_of_row_order(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A wide, flat site: in the row order of a trainer every chunk would span all of it."""
    splats = some_splats(8192, 0)
    splats = replace(splats, means=splats.means * np.float32([200, 0.1, 200]))
    along_x = splats.means[:, 0].argsort()
    found = []
    for order in (np.arange(8192), along_x):
        write_splats([splats.select(order)], tmp_path / "a.compressed.ply")
        found.append(read_splats(tmp_path / "a.compressed.ply"))
    assert all(np.array_equal(getattr(found[0], name), value) for name, value in vars(found[1]).items())
    nearest = NeighborTree(found[0].means).query(splats.means[::8], 1)[1]
    assert float(np.median(nearest)) < 0.06  # a chunk that spans the site has steps of 0.6
    assert not caplog.messages


def with_far(share: float, far: float, kind: str, count: int = 1000) -> tuple[Splats, np.ndarray]:
    """Gaussians around 0 and many far ones: a sky around them, or a second site; and a mask of the near ones."""
    splats, rng = some_splats(count, 0), np.random.default_rng(0)
    picked = rng.permutation(count)[: int(share * count)]
    if kind == "sky":
        splats.means[picked] = unit(rng.normal(size=(len(picked), 3)).astype(np.float32)) * far
        splats.scales[picked] = far / 50
    else:
        splats.means[picked] += np.array((far, far / 3, -far / 2), np.float32)
    return splats, np.isin(np.arange(count), picked, invert=True)


@pytest.mark.parametrize("kind", ["sky", "site"])
@pytest.mark.parametrize(("share", "far"), [(0.02, 1e3), (0.02, 1e6), (0.1, 1e3), (0.3, 1e6)])
@pytest.mark.parametrize("end", ENDS)
def test_many_far_gaussians_do_not_degrade_near_ones(
    end: str, share: float, far: float, kind: str, tmp_path: Path
) -> None:
    (splats, near), path = with_far(share, far, kind), tmp_path / f"a.{end}"
    for treatment in ("clamp", "prune"):
        count = write_splats([splats], path, outliers=treatment)  # type: ignore[arg-type]
        found = read_splats(path)
        assert count == found.num_gaussians
        assert errors(found, splats.select(near)).max() < 0.02  # steps of the whole range are larger


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
def test_many_far_gaussians_are_pruned_on_request(
    end: str, share: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats, near = with_far(share, 1e6, "site")
    assert write_splats([splats], tmp_path / f"a.{end}", outliers="prune") == int(near.sum())
    assert "left out" in caplog.text
    assert f"{int((~near).sum())} of 1,000 Gaussians" in caplog.text


@pytest.mark.parametrize("kind", ["sky", "site"])
def test_chunks_of_a_compressed_ply_hold_near_or_far_gaussians(kind: str, tmp_path: Path) -> None:
    splats, near = with_far(0.1, 1e6, kind)
    path = tmp_path / "a.compressed.ply"
    assert write_splats([splats], path, outliers="keep") == 1000
    assert errors(read_splats(path), splats.select(near)).max() < 0.02
    assert errors(read_splats(path), splats.select(~near)).max() < 2000
    elements = read_ply_elements(path)
    chunks = elements["chunk"]
    assert len(chunks.rows) == -(-len(elements["vertex"].rows) // 256)
    low, high = (chunks.select([f"{side}_{axis}" for axis in "xyz"]) for side in ("min", "max"))
    holds_near = ((low < 10) & (high > -10)).all(axis=1)
    assert holds_near.any()
    assert kind == "sky" or float((high - low)[holds_near].max()) < 20


@pytest.mark.parametrize("end", ["spz", "sog"])
def test_a_file_that_rounds_gaussians_visibly_gets_a_warning_with_numbers(
    end: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats, _ = with_far(0.3, 1e6, "site")
    write_splats([splats], tmp_path / f"a.{end}", outliers="keep")
    assert "Gaussians are rounded by up to" in caplog.text


def test_many_outlying_colours_do_not_degrade_their_chunk(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats, path = some_splats(512, 0), tmp_path / "a.compressed.ply"
    bright = np.arange(512) % 16 == FAR
    splats.sh[bright, 0] = 1e4
    write_splats([splats], path)
    found = read_splats(path)
    row = np.linalg.norm(splats.means[~bright][:, None] - found.means[None], axis=2).argmin(axis=1)
    assert float(np.abs(found.sh[row, 0] - splats.sh[~bright, 0]).max()) < 0.1
    assert "32 of 512 Gaussians have outlying colours" in caplog.text


@pytest.mark.parametrize(("end", "most"), [("spz", 1.44), ("splat", 1.0), ("sog", 3.5), ("compressed.ply", 3.5)])
def test_colours_beyond_a_format_are_clipped_with_a_warning(
    end: str, most: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(300, 0)
    write_splats([splats], tmp_path / f"a.{end}")
    assert not caplog.messages
    splats.sh[5:7, 0] = 3 / 0.28209479
    write_splats([splats], tmp_path / f"a.{end}")
    found = 0.5 + 0.28209479 * read_splats(tmp_path / f"a.{end}").sh[:, 0]
    assert float(found.max()) == pytest.approx(most, abs=0.01)
    assert ("base colours of 2 of 300 Gaussians, from 3.5 to 3.5, are clipped" in caplog.text) == (most < 3)


@pytest.mark.parametrize(("end", "most"), [("spz", 127 / 128), ("compressed.ply", 4.0), ("sog", 6.0)])
def test_harmonics_beyond_a_format_are_clipped_with_a_warning(
    end: str, most: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    splats = some_splats(300, 1)
    write_splats([splats], tmp_path / f"a.{end}")
    assert not caplog.messages
    splats.sh[5, 2, 1] = 6
    write_splats([splats], tmp_path / f"a.{end}")
    assert float(read_splats(tmp_path / f"a.{end}").sh[:, 1:].max()) == pytest.approx(most, abs=0.02)
    assert ("harmonics of 1 of 300 Gaussians, from" in caplog.text) == (most < 6)


def test_harmonics_that_a_splat_file_does_not_have_give_one_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_splats([some_splats(20, 2), some_splats(20, 2)], tmp_path / "a.splat")
    assert caplog.text.count("the scene's harmonics, of degree 2, are not in it") == 1
