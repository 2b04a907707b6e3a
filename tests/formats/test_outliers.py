"""Single Gaussians with extreme numbers cost the others nothing in formats with steps of a shared range."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import unit
from formats.handmade import some_splats
from splatwire.errors import UnknownNameError
from splatwire.formats import read_splats, write_splats
from splatwire.formats._codebooks import nearest_number, number_codebook
from splatwire.formats.outliers import check_outliers, find_outliers, pull_into_box
from splatwire.ops.knn import NeighborTree
from splatwire.scene.splats import Splats

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
    """Distance of each expected Gaussian from the nearest one that was found."""
    apart = expected.means[:, None].astype(np.float64) - found.means[None]
    return np.asarray(np.linalg.norm(apart, axis=2).min(axis=1))


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("far", [1e6, 3e4])
def test_a_floater_costs_the_others_nothing(
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


def test_a_moved_outlier_looks_the_same_from_the_middle() -> None:
    splats = with_floater(100)
    middle = np.array([0.1, 0.2, 0.3])
    moved = pull_into_box(splats, np.array([FAR]), middle, np.full(3, -5.0), np.full(3, 5.0))
    before, after = (some.means[FAR] - middle for some in (splats, moved))
    factor = np.linalg.norm(after) / np.linalg.norm(before)
    assert float(np.abs(moved.means[FAR]).max()) == pytest.approx(5)
    assert after / np.linalg.norm(after) == pytest.approx(before / np.linalg.norm(before), abs=1e-6)
    assert moved.scales[FAR] == pytest.approx(splats.scales[FAR] * factor, rel=1e-5)
    assert np.array_equal(without(moved).means, without(splats).means)


def test_a_scene_that_is_large_itself_has_no_outliers(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
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


def test_an_outlying_colour_costs_its_chunk_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
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


def test_code_books_of_values_with_an_outlier_are_as_good_as_without() -> None:
    values = np.random.default_rng(0).normal(size=20_000)
    for far in (1e3, 1e6, 1e9):
        both = [np.append(values, [far, -far]), values]
        books = [number_codebook(some, 256) for some in both]
        mean = [float(((book[nearest_number(values, book)] - values) ** 2).mean()) for book in books]
        assert mean[0] < 1.3 * mean[1]
        assert books[0][-1] == pytest.approx(far)


def test_a_compressed_ply_is_as_good_whatever_the_order_of_its_rows(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A site, wide and hardly high: in the order of a trainer every chunk would span all of it."""
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
