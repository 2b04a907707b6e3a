"""Comparison of files: its figures are those of the packages it is made of."""

import math
from dataclasses import replace

import numpy as np
import pytest

import splatwire
from explicit import ball_of_gaussians, encode_splats
from random_numbers import Numbers
from splatwire.bitstream import Packetization, write_stream
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.evaluation.comparison import compare, compare_files
from splatwire.evaluation.extent import SceneExtent
from splatwire.evaluation.views import held_out_cameras, held_out_closeups
from splatwire.io import open_scene
from splatwire.io.formats import write_splats
from splatwire.metrics import psnr, ssim
from splatwire.metrics.lpips import Lpips
from splatwire.render import render_scene
from splatwire.render.closeups import closeup_cameras
from splatwire.render.framing import framing_cameras
from splatwire.render.importance import cameras_around, surrounding_cameras
from splatwire.render.precision import MEASURED_CLOSEUPS, MEASURED_FRAMINGS, VIEWS, VIEWS_OF_PART
from splatwire.render.pruning import COMPARED_VIEWS
from splatwire.types import SplatScene


class SumOfDifferences(Lpips):
    """Stands for LPIPS, without weights."""

    def __call__(self, images, references, *, scaled=True):
        assert scaled
        return np.abs(images - references).sum((1, 2, 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of one scene: the source, its copy, a stream, and a coarser format."""
    target, splats = tmp_path_factory.mktemp("compared"), ball_of_gaussians()
    for name in ("source.ply", "copy.ply", "small.spz"):
        write_splats([splats], target / name)
    write_stream(encode_splats(splats, Packetization(block_size=60)), target / "stream.swz")
    return target


@pytest.mark.slow
def test_scores_equal_those_of_separate_reading_rendering_and_metrics(folder):
    files = [folder / name for name in ("source.ply", "stream.swz", "small.spz")]
    comparison = compare_files(files, views=3)
    cameras = held_out_cameras(open_scene(files[0])).select([0, 7, 14])
    wanted = render_scene(open_scene(files[0]), cameras)
    assert comparison.cameras.names == cameras.names
    for score, file in zip(comparison.scores, files, strict=True):
        images = render_scene(open_scene(file), cameras)
        each = psnr(images, wanted)
        assert score.psnr_by_view == tuple(map(float, each))
        assert score.psnr == (pytest.approx(float(each.mean())) if np.isfinite(each).all() else math.inf)
        assert score.ssim == pytest.approx(float(ssim(images, wanted).mean()))
        assert score.worst_view == int(each.argmin())
        assert (score.num_bytes, score.num_gaussians) == (file.stat().st_size, 200)
        assert 0 < score.seconds < math.inf
    assert [score.format for score in comparison.scores] == ["ply", "stream", "spz"]


def test_lpips_is_measured_with_weights_and_pictures_that_are_large_enough(folder, monkeypatch):
    files = [folder / "source.ply", folder / "small.spz"]
    assert [score.lpips for score in compare_files(files, views=1).scores] == [None, None]
    monkeypatch.setattr(compare, "find_lpips", lambda: SumOfDifferences("vgg", {}, ()))
    comparison = compare_files(files, views=1)
    wanted, image = (render_scene(open_scene(file), comparison.cameras) for file in files)
    assert [score.lpips for score in comparison.scores] == [0, pytest.approx(float(np.abs(image - wanted).sum()))]
    few_pixels = comparison.cameras.scaled(0.1)
    assert [score.lpips for score in compare_files(files, cameras=few_pixels).scores] == [None, None]


def test_equal_files_have_infinite_psnr(folder):
    first, same = compare_files([folder / "source.ply", folder / "copy.ply"], views=2).scores
    for score in (first, same):
        assert score.exact
        assert score.psnr == math.inf
        assert score.ssim == pytest.approx(1)


def test_mean_psnr_ignores_views_that_are_equal(folder):
    (score, _) = compare_files([folder / "small.spz", folder / "source.ply"], views=2).scores
    mixed = replace(score, psnr_by_view=(math.inf, 30.0, 40.0))
    assert (mixed.psnr, mixed.worst_view, mixed.exact) == (35.0, 1, False)


def test_reference_may_be_any_of_the_files_or_another_one(folder):
    source, small = folder / "source.ply", folder / "small.spz"
    for files in ([small], [small, source]):
        comparison = compare_files(files, reference=source, views=2)
        assert comparison.reference == source
        assert [score.exact for score in comparison.scores] == [False, True][: len(files)]


def test_all_files_are_drawn_in_front_of_the_background_of_the_reference(folder, tmp_path):
    path = tmp_path / "white.swz"
    scene = open_scene(folder / "source.ply")
    assert isinstance(scene, SplatScene)
    write_stream(encode_splats(scene.splats, Packetization(block_size=60), background=(1.0, 1.0, 1.0)), path)
    on_black = compare_files([folder / "source.ply", path], views=2)
    on_white = compare_files([path, folder / "source.ply"], views=2)
    assert (on_black.background, on_white.background) == ((0, 0, 0), (1, 1, 1))
    assert min(on_black.scores[1].psnr, on_white.scores[1].psnr) > 40


def test_held_out_cameras_are_at_no_pose_that_an_encoder_uses():
    scene = SplatScene(ball_of_gaussians())
    held_out = held_out_cameras(scene).centers
    used = [surrounding_cameras(scene, number).centers for number in (8, 16, COMPARED_VIEWS)]
    used += [cameras_around(scene.positions, number).centers for number in (VIEWS, VIEWS_OF_PART)]
    used += [
        closeup_cameras(scene, MEASURED_CLOSEUPS, 64).centers,
        framing_cameras(scene, MEASURED_FRAMINGS, 64).centers,
    ]
    for views in (held_out, held_out_closeups(scene).centers):
        distances = np.linalg.norm(views[:, None] - np.concatenate(used), axis=2)
        assert distances.min() > 0.01 * np.linalg.norm(views, axis=1).min()


@pytest.mark.parametrize("change", [{"means": 100.0}, {"scale": 10.0}], ids=["far away", "much larger"])
def test_file_of_another_scene_is_an_error_that_names_both(folder, tmp_path, change):
    splats, path = ball_of_gaussians(), tmp_path / "other.ply"
    means = splats.means * np.float32(change.get("scale", 1)) + np.float32(change.get("means", 0))
    write_splats([replace(splats, means=means)], path)
    with pytest.raises(InvalidValueError, match=r"other\.ply is of another scene than .*source\.ply: centre"):
        compare_files([folder / "source.ply", path], views=2)


def test_files_of_which_one_is_drawn_antialiased_give_a_warning(folder, tmp_path, caplog):
    write_splats([ball_of_gaussians()], tmp_path / "mip.ply", antialiased=True)
    compare_files([tmp_path / "mip.ply", tmp_path / "mip.ply"], views=2)
    assert not caplog.text
    compare_files([folder / "source.ply", tmp_path / "mip.ply"], views=2)
    assert "mip.ply is drawn antialiased (Mip-Splatting) and " in caplog.text
    assert "source.ply is not" in caplog.text


def test_pruned_file_is_of_the_same_scene(folder, tmp_path):
    splats, path = ball_of_gaussians(), tmp_path / "pruned.ply"
    write_splats([splats.select(np.sort(Numbers(0).randperm(200, 40)))], path)
    assert compare_files([folder / "source.ply", path], views=2).scores[1].num_gaussians == 40


def test_scenes_of_one_gaussian_can_be_compared(folder, tmp_path):
    splats = ball_of_gaussians().select(np.array([0]))
    for name in ("one.ply", "one.spz"):
        write_splats([splats], tmp_path / name)
    _, score = compare_files([tmp_path / "one.ply", tmp_path / "one.spz"], views=2).scores
    assert score.psnr > 40


def test_origin_counts_for_the_position_of_a_scene(folder):
    splats = ball_of_gaussians()
    at = [SceneExtent.of(SplatScene(splats, origin=place), folder) for place in ((0.0, 0.0, 0.0), (5e5, 5e6, 0.0))]
    assert np.allclose(at[1].centre - at[0].centre, (5e5, 5e6, 0))
    assert "another scene" in str(at[0].difference(at[1]))
    assert at[0].difference(at[0]) is None


def test_fewer_than_two_files_or_no_view_is_an_error(folder):
    with pytest.raises(InvalidValueError, match="two files"):
        compare_files([folder / "source.ply"])
    with pytest.raises(InvalidValueError, match="at least 1 view"):
        compare_files([folder / "source.ply", folder / "copy.ply"], views=0)


def test_stream_with_losses_is_an_error(folder, tmp_path):
    received, _ = splatwire.transmit(splatwire.read_stream(folder / "stream.swz")[0], "bernoulli:0.5", seed=1)
    assert received.packets
    write_stream(received, tmp_path / "lossy.swz")
    with pytest.raises(BitstreamError, match=r"lossy\.swz: .* were lost"):
        compare_files([folder / "source.ply", tmp_path / "lossy.swz"], views=2)


def test_files_with_equal_names_are_distinguished_by_their_paths(folder, tmp_path):
    other = tmp_path / "source.ply"
    write_splats([ball_of_gaussians()], other)
    names = [score.name for score in compare_files([folder / "source.ply", other, folder / "copy.ply"], views=1).scores]
    assert names == [str(folder / "source.ply"), str(other), "copy.ply"]
