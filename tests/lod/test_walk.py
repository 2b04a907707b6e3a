"""A camera path through a scene during a transfer: arrivals over time, and reference pictures."""

from dataclasses import replace

import numpy as np
import pytest

from close import assert_close
from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import Packetization
from splatwire.channel import parse_loss
from splatwire.errors import InvalidValueError
from splatwire.evaluation.walkthrough.delivery import Link, deliver
from splatwire.evaluation.walkthrough.evaluation import StreamedWalkthrough, score_walk, time_to_quality
from splatwire.evaluation.walkthrough.path import Walk
from splatwire.lod import cut_of, encode_levels, tiles_of
from splatwire.render.importance import surrounding_cameras
from splatwire.types import SplatScene

TILES = Packetization(block_size=40, lanes=2)
FAST, SLOW = Link(1e9, 0.0), Link(100e3)


@pytest.fixture(scope="module")
def scene():
    return SplatScene(some_splats(900))


@pytest.fixture(scope="module")
def stream(scene):
    return encode_levels(scene, TILES)


@pytest.fixture(scope="module")
def walk(scene):
    return Walk(surrounding_cameras(scene, 3, 32), 4.0)


def test_walk_passes_its_cameras_and_interpolates_between_them(walk):
    for number in range(3):
        assert_close(walk.at(2.0 * number).viewmats[0], walk.cameras.viewmats[number], atol=1e-5, rtol=0)
    between = walk.at(1.0)
    rotation = between.viewmats[0, :3, :3]
    assert_close(rotation @ rotation.T, np.eye(3, dtype=np.float32), atol=1e-5, rtol=0)
    assert_close(between.centers[0], walk.cameras.centers[:2].mean(axis=0), atol=1e-4, rtol=0)
    one = Walk(walk.cameras.select([1]), 3.0)
    assert np.array_equal(one.at(2.0).viewmats, walk.cameras.viewmats[1:2])


@pytest.mark.parametrize("loss", ["none", "bernoulli:0.2"])
def test_delivery_respects_the_link_rate_and_retransmits_losses(stream, walk, loss):
    link = replace(SLOW, loss=parse_loss(loss, "datagram"))
    delivery = deliver(stream, walk.viewpoint, walk.seconds, link)
    came = np.sort(delivery.arrivals[np.isfinite(delivery.arrivals)])
    for seconds in (0.5, 1.0, 2.0, 4.0):
        assert 8 * delivery.bytes_at(seconds) <= link.rate * seconds
    assert came[0] > delivery.head
    lost = delivery.sent_bytes - delivery.sizes[np.isfinite(delivery.arrivals)].sum()
    assert (lost > 0) == (loss != "none")
    ample = deliver(stream, walk.viewpoint, walk.seconds, replace(link, rate=10e6))
    tiles = tiles_of(stream)
    for seconds in (3.0, 4.0):  # every tile that the view requested, despite losses
        assert not cut_of(tiles, ample.drawable(tiles, seconds), walk.viewpoint(seconds - 0.5)).wanted


def test_coarse_tiles_arrive_before_visible_fine_tiles(stream, walk):
    tiles, delivery = tiles_of(stream), deliver(stream, walk.viewpoint, walk.seconds, SLOW)
    of_tile = np.array([delivery.arrivals[delivery.tile_of_packet == tile].max() for tile in range(tiles.num_tiles)])
    roots = tiles.parents < 0
    assert of_tile[roots].max() < of_tile[~roots].min()
    other = deliver(stream, lambda seconds: walk.viewpoint(walk.seconds), walk.seconds, SLOW)
    assert not np.array_equal(delivery.arrivals, other.arrivals)


def test_picture_with_all_tiles_equals_the_complete_one(stream, scene, walk):
    journey = StreamedWalkthrough.of(stream, walk, FAST)
    moments = score_walk(journey, scene, walk, [0.0, 3.5])
    assert moments[0].num_gaussians == 0
    assert moments[1].psnr == moments[1].complete_psnr
    assert time_to_quality(moments) == 3.5
    assert time_to_quality([*moments, replace(moments[1], psnr=moments[1].psnr - 2)]) is None
    assert journey.time_to_coarsest_level < 0.2


def test_incomplete_stream_is_refused(stream, walk):
    with pytest.raises(InvalidValueError, match="missing"):
        deliver(stream.with_packets(stream.packets[1:]), walk.viewpoint, 1.0, SLOW)
