"""Photos with masks: only what the masks leave has any influence on an evaluation."""

import numpy as np
import pytest

from evaluate.masked_photos import LEFT, write_photos
from metrics.test_lpips import write_weights
from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import open_dataset
from splatwire.evaluate import photo_views
from splatwire.evaluate.study import (
    InProcess,
    Loss,
    MemoryStore,
    SceneEntry,
    Study,
    concealment_rows,
    plain_content,
    run_study,
)
from splatwire.evaluate.study.pictures import take_pictures
from splatwire.metrics import psnr, ssim
from splatwire.metrics.lpips import load_lpips
from splatwire.packets import Packetization, write_stream
from splatwire.render import render_scene


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
    lpips = load_lpips(*write_weights(tmp_path_factory.mktemp("lpips"), "alex"), "alex")
    found = []
    with pytest.MonkeyPatch.context() as patch:
        for module in ("run", "work"):
            patch.setattr(f"splatwire.evaluate.study.{module}.find_lpips_files", lambda: ("backbone", "linear"))
        patch.setattr("splatwire.metrics.lpips.load_lpips", lambda *files: lpips)
        for folder in folders:
            entry = SceneEntry("tiny", folder.parent / "tiny.swz", "stream", photos=folder)
            study = Study("tiny", "t", (entry,), concealment_rows(("drop", "idw")), (Loss("bernoulli:0.3"),))
            store = MemoryStore(tmp_path_factory.mktemp("store"))
            found.append((store, run_study(study, store, InProcess(), lambda task, share: None)))
    return found


def scores(result):
    return [[(r.psnr, r.ssim, r.lpips) for r in result.records[cell.unit.key]] for cell in result.cells]


def test_garbage_outside_changes_no_figure_and_no_picture(datasets, evaluations):
    assert not np.array_equal(datasets[0].image(0), datasets[1].image(0))
    first, second = (scores(result) for _, result in evaluations)
    assert first == second
    assert all(lpips is not None for run in first for *_, lpips in run)
    one, two = (take_pictures(result, store) for store, result in evaluations)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.reference, b.reference)
        assert all(np.array_equal(x.pixels, y.pixels) for x, y in zip(a.shots, b.shots, strict=True))


def test_figures_are_those_of_what_is_left(stream, datasets, evaluations):
    """The mask is a rectangle, so its view scores what its left part would; the other view counts whole."""
    images = render_scene(decode_stream(stream).scene, datasets[0].cameras)
    photos = np.stack([datasets[0].image(view) for view in range(2)])
    found = scores(evaluations[0][1])[0]
    for index, metric in enumerate((psnr, ssim)):
        left = metric(images[:1, :, :LEFT], photos[:1, :, :LEFT])[0]
        expected = [left.item(), metric(images, photos)[1].item()]
        assert [view[index] for view in found] == pytest.approx(expected, abs=1e-4)


def test_the_result_says_that_masks_were_used(evaluations):
    said = plain_content(evaluations[0][1])
    assert said["masked"] is True
    assert said["reference"] == "photos inside their masks"
    assert "black outside the masks" in said["lpips"]


def test_fewer_views_keep_their_masks(datasets):
    views = photo_views(datasets[0])
    assert [views.mask(view) is None for view in range(2)] == [False, True]
    first = photo_views(datasets[0].select([0]))
    assert np.array_equal(first.mask(0), datasets[0].mask(0))
    assert not bool(first.reference(0)[:, LEFT:].any())
    assert not photo_views(datasets[0].select([1])).masked
