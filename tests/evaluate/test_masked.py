"""Photos with masks: only what the masks leave has any influence on an evaluation."""

import numpy as np
import pytest
import torch

from evaluate.masked_photos import LEFT, write_photos
from metrics.test_lpips import write_weights
from scenes import tiny_cameras, tiny_scene
from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import open_dataset
from splatwire.evaluate import Protocol, concealment_methods, evaluate_streams, photo_views
from splatwire.metrics import psnr, ssim
from splatwire.metrics.lpips import load_lpips
from splatwire.packets import Packetization
from splatwire.render import render_scene


@pytest.fixture(scope="module")
def stream():
    return encode_scene(tiny_scene(seed=5, num_anchors=180), Packetization(block_size=60))


@pytest.fixture(scope="module")
def datasets(stream, tmp_path_factory):
    """The same photos and masks with different garbage outside."""
    scene, cameras, folder = decode_stream(stream).scene, tiny_cameras(9, 72, 64), tmp_path_factory.mktemp("masked")
    return [open_dataset(write_photos(folder / str(seed), scene, cameras, seed)) for seed in (1, 2)]


@pytest.fixture(scope="module")
def evaluations(stream, datasets, tmp_path_factory):
    lpips = load_lpips(*write_weights(tmp_path_factory.mktemp("lpips"), "alex"), "alex")
    protocol = Protocol(concealment_methods(("drop", "idw")), parse_loss("bernoulli:0.3"), (0,))
    return [evaluate_streams(protocol, {"stream": stream}, photo_views(d), lpips=lpips) for d in datasets]


def test_garbage_outside_changes_no_figure_and_no_picture(datasets, evaluations):
    assert not torch.equal(datasets[0].image(0), datasets[1].image(0))
    first, second = ([run.scores for run in evaluation.runs] for evaluation in evaluations)
    assert first == second
    assert all(len(scores.lpips) == 2 for scores in first)
    pictures = [[p.pixels for p in e.pictures] + list(e.references.values()) for e in evaluations]
    assert all(np.array_equal(a, b) for a, b in zip(*pictures, strict=True))


def test_figures_are_those_of_what_is_left(stream, datasets, evaluations):
    """The mask is a rectangle, so its view scores what its left part would; the other view counts whole."""
    images = render_scene(decode_stream(stream).scene, datasets[0].cameras)
    photos = torch.stack([datasets[0].image(view) for view in range(2)])
    run = next(run for run in evaluations[0].runs if run.method.lossless)
    for metric, found in ((psnr, run.scores.psnr), (ssim, run.scores.ssim)):
        left = metric(images[:1, :, :LEFT], photos[:1, :, :LEFT])[0]
        assert found == pytest.approx([left.item(), metric(images, photos)[1].item()], abs=1e-4)


def test_the_result_says_that_masks_were_used(evaluations):
    said = evaluations[0].to_json()
    assert said["masked"] is True
    assert said["reference"] == "photos inside their masks"
    assert "black outside the masks" in said["lpips"]


def test_fewer_views_keep_their_masks(datasets):
    views = photo_views(datasets[0])
    assert [views.mask(view) is None for view in range(2)] == [False, True]
    first = views.every(1)
    assert torch.equal(first.mask(0), datasets[0].mask(0))
    assert not bool(first.reference(0)[:, LEFT:].any())
