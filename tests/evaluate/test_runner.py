"""Laws of a fair comparison: shared losses, shared decodes, means in the right order, nothing scored twice."""

import dataclasses
import math
import statistics

import numpy as np
import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal
from splatwire.evaluate import Method, Protocol, ReferenceViews, concealment_methods, evaluate_scene, evaluate_streams
from splatwire.evaluate.runner import to_pixels
from splatwire.metrics import psnr
from splatwire.packets import Packetization
from splatwire.render import render_scene

PACKETIZATION = Packetization(block_size=60)


@pytest.fixture(scope="module")
def stream():
    return encode_scene(tiny_scene(seed=5, num_anchors=180), PACKETIZATION)


@pytest.fixture(scope="module")
def views(stream):
    cameras = tiny_cameras(3, 48, 36)
    images = render_scene(decode_stream(stream).scene, cameras)
    return ReferenceViews(cameras, images.__getitem__, "renders of the lossless scene")


@pytest.fixture(scope="module")
def evaluation(stream, views):
    protocol = Protocol(concealment_methods(("drop", "idw")), parse_loss("bernoulli:0.3"), (0, 4))
    return evaluate_streams(protocol, {"stream": stream}, views)


def test_a_run_is_what_the_rooms_give_one_by_one(stream, views, evaluation):
    """The runner adds bookkeeping, never a different picture."""
    received, _ = transmit(stream, parse_loss("bernoulli:0.3"), seed=4)
    images = render_scene(conceal(decode_stream(received), "idw"), views.cameras)
    references = torch.stack([views.reference(v) for v in range(3)])
    run = next(run for run in evaluation.runs if run.method.name == "idw" and run.seed == 4)
    assert run.scores.psnr == pytest.approx(psnr(images, references).tolist(), abs=1e-5)
    assert run.num_lost_packets == len(stream.packets) - len(received.packets)


def test_methods_share_losses(evaluation):
    drop, idw = ([run for run in evaluation.runs if run.method.name == name] for name in ("drop", "idw"))
    assert [run.num_lost for run in drop] == [run.num_lost for run in idw]
    assert drop[0].num_lost > 0


def test_psnr_is_averaged_over_views_then_seeds(evaluation):
    row = next(row for row in evaluation.rows() if row["method"] == "drop")
    runs = [run for run in evaluation.runs if run.method.name == "drop"]
    assert row["psnr"] == pytest.approx(statistics.fmean(statistics.fmean(run.scores.psnr) for run in runs))
    assert row["psnr_spread"] == pytest.approx(statistics.stdev(row["psnr_by_seed"]))


def test_infinity_is_null_and_said(evaluation):
    row = evaluation.rows()[0]
    assert row["method"] == "no loss"
    assert row["psnr"] is None
    assert row["exact"]
    assert all(math.isinf(value) for value in evaluation.runs[0].scores.psnr)


def test_each_received_stream_is_decoded_once(stream, views):
    calls = []

    def decode(received):
        calls.append(len(received.packets))
        return decode_stream(received)

    protocol = Protocol(concealment_methods(("drop", "prior", "idw")), parse_loss("bernoulli:0.3"), (0, 1))
    evaluate_streams(protocol, {"stream": stream}, views, decode=decode)
    assert len(calls) == 3  # two seeds and the complete stream


def test_streams_of_equally_many_packets_meet_the_same_losses(stream, views):
    other = encode_scene(decode_stream(stream).scene, dataclasses.replace(PACKETIZATION, grouping="contiguous"))
    protocol = Protocol((Method("a", "one"), Method("b", "two")), parse_loss("bernoulli:0.3"), (2,))
    runs = evaluate_streams(protocol, {"one": stream, "two": other}, views).runs
    assert len(stream.packets) == len(other.packets)
    assert runs[0].num_lost_packets == runs[1].num_lost_packets > 0


def test_pictures_of_the_hardest_views_of_the_first_lossy_method(evaluation):
    drop = next(run for run in evaluation.runs if run.method.name == "drop" and run.seed == 0)
    hardest = sorted(range(3), key=drop.scores.psnr.__getitem__)[:2]
    assert list(evaluation.references) == hardest
    assert {(p.view, p.method) for p in evaluation.pictures} == {
        (view, name) for view in hardest for name in ("no loss", "drop", "idw")
    }
    lossless = next(p for p in evaluation.pictures if p.method == "no loss" and p.view == hardest[0])
    assert np.array_equal(lossless.pixels, evaluation.references[hardest[0]])
    assert [loss_map.view for loss_map in evaluation.loss_maps] == hardest[:1]


def test_progress_ends_at_one_for_every_method(stream, views):
    seen = {}
    protocol = Protocol(concealment_methods(("drop",)), parse_loss("bernoulli:0.3"))
    evaluate_streams(protocol, {"stream": stream}, views, progress=lambda task, share: seen.update({task: share}))
    assert seen == {"drop": 1.0, "no loss": 1.0}


def test_a_scene_is_scored_as_it_is(stream, views):
    partial = decode_stream(transmit(stream, parse_loss("bernoulli:0.3"), seed=0)[0])
    protocol = Protocol((Method("drop"), Method("idw", concealer="idw")))
    result = evaluate_scene(protocol, partial, partial.erasures, {"everything": 10}, views)
    assert [row["num_lost"] for row in result.rows()] == [partial.erasures.num_lost] * 2
    assert result.rows()[0]["num_bytes"] == 10
    sent = Protocol(concealment_methods(("drop", "idw"), complete=False), parse_loss("bernoulli:0.3"))
    there = evaluate_streams(sent, {"stream": stream}, views)
    assert [row["psnr"] for row in result.rows()] == [row["psnr"] for row in there.rows()]


def test_to_pixels_rounds_to_the_nearest_byte():
    image = torch.tensor([[[0.0, 1.0, 0.5], [-1.0, 2.0, 1 / 255 * 0.49]]])
    assert to_pixels(image).tolist() == [[[0, 255, 128], [0, 255, 0]]]
