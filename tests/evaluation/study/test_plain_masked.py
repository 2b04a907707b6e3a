"""Only pixels inside the masks of photos influence an evaluation."""

import csv
import io

import numpy as np
import pytest

from evaluation.masked_photos import LEFT, write_photos
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import open_dataset
from splatwire.evaluation import photo_views
from splatwire.evaluation.study import (
    InProcess,
    Loss,
    MemoryStore,
    SceneEntry,
    Study,
    concealment_rows,
    plain_content,
    run_study,
    summarize,
)
from splatwire.evaluation.study.pictures import take_pictures
from splatwire.evaluation.study.tables import leaderboard_csv
from splatwire.metrics import psnr, ssim
from splatwire.metrics.lpips import load_lpips
from splatwire.render import render_scene
from tensor_files import write_lpips_weights

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]


@pytest.fixture(scope="module")
def stream():
    return encode_scene(tiny_scene(seed=5, num_anchors=180), Packetization(block_size=60))


@pytest.fixture(scope="module")
def folders(stream, tmp_path_factory):
    """The same photos and masks with different garbage outside."""
    scene, cameras, folder = decode_stream(stream).scene, tiny_cameras(9, 72, 64), tmp_path_factory.mktemp("masked")
    write_stream(stream, folder / "tiny.swz")
    return [write_photos(folder / str(seed), scene, cameras, seed) for seed in (1, 2)]


@pytest.fixture(scope="module")
def datasets(folders):
    return [open_dataset(folder) for folder in folders]


@pytest.fixture(scope="module")
def evaluations(folders, tmp_path_factory):
    lpips = load_lpips(*write_lpips_weights(tmp_path_factory.mktemp("lpips")), "alex")
    found = []
    with pytest.MonkeyPatch.context() as patch:
        for module in ("run", "work"):
            patch.setattr(f"splatwire.evaluation.study.{module}.find_lpips_files", lambda: ("backbone", "linear"))
            patch.setattr(f"splatwire.evaluation.study.{module}.load_lpips", lambda *files: lpips)
        for folder in folders:
            entry = SceneEntry("tiny", folder.parent / "tiny.swz", "stream", photos=folder)
            study = Study(
                "tiny", "t", (entry,), concealment_rows(("drop", "idw")), (Loss("bernoulli:0.3"),),
                metrics=("psnr", "ssim", "lpips", "lpips_unscaled"),
            )  # fmt: skip
            store = MemoryStore(tmp_path_factory.mktemp("store"))
            found.append((store, run_study(study, store, InProcess(), lambda task, share: None)))
    return found


def scores(result):
    metrics = ("psnr", "ssim", "lpips", "lpips_unscaled")
    return [[tuple(map(r.figure, metrics)) for r in result.records[cell.unit.key]] for cell in result.cells]


def test_pixels_outside_the_masks_change_no_figure_and_no_picture(datasets, evaluations):
    assert not np.array_equal(datasets[0].image(0), datasets[1].image(0))
    first, second = (scores(result) for _, result in evaluations)
    assert first == second
    assert all(None not in figures for run in first for figures in run)
    one, two = (take_pictures(result, store) for store, result in evaluations)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.reference, b.reference)
        assert all(np.array_equal(x.pixels, y.pixels) for x, y in zip(a.shots, b.shots, strict=True))


def test_figures_count_only_pixels_inside_the_masks(stream, datasets, evaluations):
    """The mask is a rectangle, so its view scores like a crop; the other view counts completely."""
    images = render_scene(decode_stream(stream).scene, datasets[0].cameras)
    photos = np.stack([datasets[0].image(view) for view in range(2)])
    found = scores(evaluations[0][1])[0]
    for index, metric in enumerate((psnr, ssim)):
        left = metric(images[:1, :, :LEFT], photos[:1, :, :LEFT])[0]
        expected = [left.item(), metric(images, photos)[1].item()]
        assert [view[index] for view in found] == pytest.approx(expected, abs=1e-4)


def test_leaderboard_has_lpips_as_published_tables_have_it(evaluations):
    """The column is the mean over views of LPIPS of pictures in [0, 1], which differs from the scaled variant."""
    _, result = evaluations[0]
    lines = list(csv.DictReader(io.StringIO(leaderboard_csv(summarize(result)))))
    for line, run in zip(lines, scores(result), strict=True):
        scaled, unscaled = (sum(column) / len(run) for column in tuple(zip(*run, strict=True))[2:])
        assert float(line["LPIPS"]) == pytest.approx(unscaled, abs=1e-6)
        assert scaled != pytest.approx(unscaled, rel=1e-3)


def test_result_states_the_use_of_masks(evaluations):
    said = plain_content(evaluations[0][1])
    assert said["masked"] is True
    assert said["reference"] == "photos inside their masks"
    assert "black outside the masks" in said["lpips"]


def test_selected_views_keep_their_masks(datasets):
    views = photo_views(datasets[0])
    assert [views.mask(view) is None for view in range(2)] == [False, True]
    first = photo_views(datasets[0].select([0]))
    assert np.array_equal(first.mask(0), datasets[0].mask(0))
    assert not bool(first.reference(0)[:, LEFT:].any())
    assert photo_views(datasets[0].select([1])).mask(0) is None
