"""Levels: tiles and their parents, merging that keeps the appearance, and streams that keep every Gaussian."""

import itertools
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import PRESETS, Packetization, stream_from_bytes, stream_to_bytes
from splatwire.bitstream.sections import sections_of
from splatwire.bitstream.send_order import send_sequence
from splatwire.bitstream.tiers import TierCounts, spans_of
from splatwire.bitstream.tile_index import SECTION, read_tile_index
from splatwire.bitstream.tile_selection import Viewpoint, cut_of, finer_tile_of, pixel_errors
from splatwire.bitstream.tiles import Tiles, parents_of
from splatwire.codec import ProgressiveDecoder, decode_stream, encode_scene, repack, with_section
from splatwire.concealment import conceal, create_concealer
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError
from splatwire.lod.building import build_levels
from splatwire.lod.encoding import encode_levels
from splatwire.lod.merging import footprints, reduce_gaussians
from splatwire.lod.tiles import level_shapes, tiles_of
from splatwire.ops.kd_order import kd_order
from splatwire.types import SplatScene
from splatwire.types.lod_scene import Levels

TILES = Packetization(block_size=40, lanes=2)
DATAGRAMS = Packetization(block_size=40, lanes=1, grouping="hashed", packet_bytes=600)


@pytest.fixture(scope="module", params=[TILES, DATAGRAMS], ids=["lanes", "datagrams"])
def stream(request):
    return encode_levels(SplatScene(some_splats(900)), request.param)


@settings(deadline=None)  # independent of machine load
@given(st.integers(1, 10**7), st.sampled_from([37, 500, 3000]))
def test_tiles_are_the_blocks_of_a_plan(count, tile):
    shapes = level_shapes(count, tile)
    tiers = tuple(TierCounts(shape.count, 1) for shape in reversed(shapes))
    if len(tiers) > 1:
        spans = spans_of(tiers, sum(shape.count for shape in shapes), Packetization(block_size=tile))
        found = [(span.num_elements, span.block_size, span.num_blocks) for span in spans]
        assert found == [(shape.count, shape.size, shape.num_tiles) for shape in reversed(shapes)]
    for finer, shape in itertools.pairwise(shapes):
        parents = parents_of(finer.num_tiles, shape.num_tiles)
        assert set(parents.tolist()) == set(range(shape.num_tiles))
        assert (np.diff(parents) >= 0).all()


@settings(deadline=None)  # independent of machine load
@given(st.integers(1, 200), st.integers(1, 20), st.integers(0, 99), st.booleans())
def test_runs_of_a_kd_order_are_disjoint_in_space(count, runs, seed, alike):
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 2, (count, 3)) if alike else rng.normal(size=(count, 3))
    edges = np.arange(runs + 1, dtype=np.int64) * count // runs
    order = kd_order(points, [edges])
    assert sorted(order.tolist()) == list(range(count))
    first, second = order[: edges[runs // 2]], order[edges[runs // 2] :]
    if runs > 1 and len(first) and len(second):
        low, high = points[first], points[second]
        assert any(low[:, axis].max() <= high[:, axis].min() for axis in range(3))


def test_merging_keeps_mean_covariance_and_coverage():
    splats = some_splats(60)
    few, old, error = reduce_gaussians(splats, 1)
    mass = footprints(splats)
    mean = (splats.means * mass[:, None]).sum(axis=0) / mass.sum()
    assert old == 0
    assert few.num_gaussians == 1
    np.testing.assert_allclose(few.means[0], mean, rtol=1e-5, atol=1e-5)
    apart = splats.means - mean
    assert error == pytest.approx(np.sqrt((mass * (apart**2).sum(axis=1)).sum() / mass.sum()), rel=1e-4)
    assert float(few.opacities[0]) <= 0.99
    one = splats.select(np.array([3]))
    same, old, error = reduce_gaussians(one, 1)
    assert old == 0
    assert error == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(footprints(same), np.minimum(footprints(one), footprints(same)), rtol=1e-5)


def test_merging_copies_of_one_gaussian_gives_that_gaussian():
    one = some_splats(1)
    same, _, _ = reduce_gaussians(one, 1)

    def covariance(splats):
        w, x, y, z = splats.quats[0].astype(np.float64).tolist()
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        return turn @ np.diag(splats.scales[0].astype(np.float64) ** 2) @ turn.T

    np.testing.assert_allclose(covariance(same), covariance(one), rtol=1e-3, atol=1e-9)


def test_levels_are_stored_tile_by_tile():
    built = build_levels(SplatScene(some_splats(900)), 40)
    sizes = built.scene.level_sizes
    assert sum(sizes) == built.scene.num_elements
    assert sizes[-1] == 900
    finest = built.scene.splats.means[-900:]
    assert np.array_equal(finest, some_splats(900).means[built.order])
    start = sum(sizes[:-1])
    coarser = built.scene.splats.means[start - sizes[-2] : start]
    old = built.is_copy[start - sizes[-2] : start]
    assert 0 < int(old.sum()) < sizes[-2]
    there = {tuple(place) for place in finest.tolist()}
    assert all(tuple(place) in there for place in coarser[old].tolist())
    assert (np.diff([built.errors[: -level_shapes(900, 40)[0].num_tiles].min(), 0]) < 0).all()


def test_precision_classes_may_be_given_as_a_function():
    splats = some_splats(900)
    opacities = splats.opacities.copy()
    opacities[::7] = 0  # invisible Gaussians have a class as well and are left out
    scene, classes = SplatScene(replace(splats, opacities=opacities)), (-(np.arange(900) % 4)).astype(np.int8)
    known, found = encode_levels(scene, class_offsets=classes), encode_levels(scene, class_offsets=lambda: classes)
    assert (
        stream_to_bytes(known)
        == stream_to_bytes(found)
        != stream_to_bytes(encode_levels(scene, class_offsets=lambda: None))
    )


def test_finest_level_is_rendered_by_default(stream):
    received = decode_stream(stream)
    levels = received[Levels]
    shown = conceal(received, "drop").drawn()
    assert shown.num_gaussians == 900 == int((levels.lod_level == 0).sum())
    index, plan = read_tile_index(stream.manifest, sections_of(stream)), stream.manifest.plan
    assert len(index.sizes) == plan.num_blocks
    data = stream_to_bytes(stream)
    assert int(index.offsets[-1]) + len(data) - sum(len(packet.data) + 4 for packet in stream.packets) == len(data)
    assert stream_from_bytes(data)[0].manifest == stream.manifest
    assert bool(levels.copied[levels.lod_level == 1].any())
    assert not bool(levels.copied[levels.lod_level == 0].any())


def test_progressive_decoding_equals_decoding_at_once(stream):
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    for packet in reversed(stream.packets):
        decoder.add([packet])
    whole, stepwise = decode_stream(stream).scene, decoder.received_scene.scene
    assert np.array_equal(whole.splats.means, stepwise.splats.means)
    assert np.array_equal(whole.hints.left_out, stepwise.hints.left_out)


def test_coarse_concealer_draws_the_parents_of_lost_tiles(stream):
    first = stream.manifest.plan.spans[-1].first_block
    lost = stream.with_packets(packet for packet in stream.packets if packet.id.block != first)
    received = decode_stream(lost)
    scene, dropped = conceal(received, "coarse"), conceal(received, "drop")
    shown = ~scene.hints.left_out & (received[Levels].lod_level > 0)
    assert bool(shown.any())
    assert not bool((~dropped.hints.left_out & (received[Levels].lod_level > 0)).any())
    gone = stream.manifest.plan.block_elements(first)
    tiles = tiles_of(stream)
    where = scene.splats.means[shown & (received[Levels].copied)]
    near = ((where >= tiles.low[first] - 1e-3) & (where <= tiles.high[first] + 1e-3)).all(axis=1)
    assert gone
    assert near.any()
    nothing = decode_stream(stream.with_packets(p for p in stream.packets if p.id.block < first))
    assert conceal(nothing, "coarse").drawn().num_gaussians > 0


def test_without_trust_the_coarse_concealer_hides_merged_gaussians_even_if_all_finer_ones_are_lost(stream):
    first = stream.manifest.plan.spans[-1].first_block
    received = decode_stream(stream.with_packets(packet for packet in stream.packets if packet.id.block < first))
    shown = ~conceal(received, create_concealer("coarse", trust=0.0)).hints.left_out
    copied = received[Levels].copied
    assert bool((shown & copied).any())
    assert not bool((shown & ~copied).any())


def test_coarse_concealer_keeps_a_complete_scene(stream):
    received = decode_stream(stream)
    assert conceal(received, "coarse") is received.scene


def test_coarse_concealer_requires_levels():
    plain = encode_scene(SplatScene(some_splats(200)), TILES)
    lossy = decode_stream(plain.with_packets(plain.packets[1:]))
    with pytest.raises(InvalidValueError, match="needs Levels"):
        conceal(lossy, "coarse")


def test_repacked_stream_has_the_same_tiles(stream):
    for packetization in (DATAGRAMS, TILES):
        other, anew = repack(stream, packetization), encode_levels(SplatScene(some_splats(900)), packetization)
        assert other.manifest.symbols_digest == anew.manifest.symbols_digest
        index, data = read_tile_index(other.manifest, sections_of(other)), stream_to_bytes(other)
        assert int(index.packets.sum()) == len(other.packets)
        assert int(index.sizes.sum()) == sum(len(packet.data) + 4 for packet in other.packets) < len(data)
        assert (tiles_of(other).errors == tiles_of(stream).errors).all()
    with pytest.raises(InvalidValueError, match="encode the scene again"):
        repack(stream, PRESETS["paper"])


def test_server_sends_stream_tile_by_tile(stream):
    sent = [packet.id.block for packet in send_sequence(stream, "tiers")]
    assert sent == sorted(sent)


def test_tiles_hold_their_gaussians(stream):
    tiles, received, plan = tiles_of(stream), decode_stream(stream), stream.manifest.plan
    for tile in range(tiles.num_tiles):
        means = received.scene.splats.means[plan.block_indices(tile)].astype(np.float64)
        assert (means >= tiles.low[tile] - 1e-6).all()
        assert (means <= tiles.high[tile] + 1e-6).all()
        assert len(means) == tiles.counts[tile]
    assert (tiles.errors[tiles.levels == 0] == 0).all()
    assert (tiles.errors[tiles.levels > 0] > 0).all()
    finer = tiles.parents >= 0
    assert (tiles.levels[finer] == tiles.levels[tiles.parents[finer]] - 1).all()


def looking(tiles) -> Viewpoint:
    middle = (tiles.low.min(axis=0) + tiles.high.max(axis=0)) / 2
    matrix = np.eye(4)
    matrix[:3, 3] = -middle + [0, 0, float(np.ptp([tiles.low.min(), tiles.high.max()]))]
    return Viewpoint(matrix, 300.0, 320, 240)


@settings(deadline=None)  # independent of machine load
@given(st.integers(0, 10**6), st.integers(50, 2000), st.booleans())
def test_cut_draws_parents_and_requests_missing_tiles(stream, seed, budget, blind):
    tiles = tiles_of(stream)
    there = np.random.default_rng(seed).random(tiles.num_tiles) < 0.7
    cut = cut_of(tiles, there, None if blind else looking(tiles), budget)
    assert all(there[list(cut.drawn)])
    assert not any(there[list(cut.wanted)])
    assert len(set(cut.wanted)) == len(cut.wanted)
    above = tiles.parents[list(cut.drawn)]
    assert set(above[above >= 0].tolist()) <= set(cut.drawn)  # the parent is known wherever a tile is drawn
    place = {tile: n for n, tile in enumerate(cut.wanted)}
    assert all(place.get(tiles.parents[tile], -1) < n for tile, n in place.items())
    roots = int(tiles.counts[tiles.parents < 0].sum())
    assert tiles.counts[list(cut.drawn)].sum() <= max(budget, roots)


def test_cut_with_unlimited_budget_contains_all_tiles(stream):
    tiles = tiles_of(stream)
    cut = cut_of(tiles, np.ones(tiles.num_tiles, bool), None)
    assert cut.drawn == tuple(range(tiles.num_tiles))
    assert not cut.wanted
    nothing = cut_of(tiles, np.zeros(tiles.num_tiles, bool), None)
    assert not nothing.drawn
    assert sorted(nothing.wanted) == list(range(tiles.num_tiles))


def test_tiles_behind_the_camera_have_low_priority(stream):
    tiles = tiles_of(stream)
    viewpoint = looking(tiles)
    away = Viewpoint(
        np.diag([1.0, -1.0, -1.0, 1.0]) @ viewpoint.viewmat, viewpoint.focal, viewpoint.width, viewpoint.height
    )
    finer = tiles.parents >= 0
    assert (pixel_errors(tiles, away)[finer] < pixel_errors(tiles, viewpoint)[finer]).all()


def test_a_tile_with_thousands_of_children_needs_little_memory():
    count, rng = 3000, np.random.default_rng(0)
    centres, zeros = rng.random((count + 1, 3)), np.zeros(count + 1)
    tiles = Tiles(
        levels=np.array([1] + [0] * count), parents=np.array([-1] + [0] * count), counts=np.ones(count + 1, np.int64),
        packets=np.ones(count + 1, np.int64), sizes=np.ones(count + 1, np.int64), errors=zeros,
        low=centres, high=centres + 1e-3,
    )  # fmt: skip
    means = rng.random((3000, 3))
    tracemalloc.start()
    found = finer_tile_of(tiles, 0, means)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 150e6
    for row in range(0, 3000, 300):
        outside = np.maximum(np.maximum(centres[1:] - means[row], means[row] - centres[1:] - 1e-3), 0).max(axis=1)
        assert found[row] == 1 + outside.argmin()


def test_coarser_gaussians_represent_their_child_tiles(stream):
    tiles, plan = tiles_of(stream), stream.manifest.plan
    means = decode_stream(stream).scene.splats.means.astype(np.float64)
    for tile in range(tiles.num_tiles):
        finer = np.flatnonzero(tiles.parents == tile)
        found = finer_tile_of(tiles, tile, means[plan.block_indices(tile)])
        if not len(finer):
            assert (found == -1).all()
            continue
        # A coarser tile has Gaussians in proportion to its children; quantisation moves few across a border.
        shares = np.bincount(found, minlength=tiles.num_tiles)[finer] / len(found)
        np.testing.assert_allclose(shares, tiles.counts[finer] / tiles.counts[finer].sum(), atol=0.1)


@pytest.mark.parametrize("seed", range(40))
def test_hostile_indexes_are_refused(stream, seed):
    rng, sections = np.random.default_rng(seed), stream
    data = bytearray(sections_of(stream)[SECTION])
    for _ in range(rng.integers(1, 5)):
        data[rng.integers(len(data))] = rng.integers(256)
    sections = with_section(stream, SECTION, bytes(data[: rng.integers(len(data) + 1)]))
    try:
        found = tiles_of(sections)
    except SplatwireError:
        return
    assert (found.sizes >= 0).all()
    assert np.isfinite(found.errors).all()


def test_a_stream_without_levels_has_no_tiles():
    with pytest.raises(BitstreamError, match="no index"):
        tiles_of(encode_scene(SplatScene(some_splats(60)), TILES))
