"""A chain of updates leads from each state of a served scene to the newest one."""

from dataclasses import replace

import numpy as np
import pytest

from codec.gaussians.test_gaussians import DATAGRAM, SMALL, some_splats
from codec.update.test_updates import BALL, moved, outside, recoloured, sorted_rows
from explicit import encode_splats
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.bitstream.packetization import DATAGRAM_PACKET_BYTES
from splatwire.codec import apply_update, decode_stream, encode_update, into_datagrams, repack
from splatwire.codec.update import chain as chains
from splatwire.codec.update.chain import UpdateChain
from splatwire.codec.update.removed import curve_order
from splatwire.codec.update.section import manifest_digest, update_name
from splatwire.errors import InvalidValueError
from splatwire.types import SplatScene
from splatwire.types.splats import Splats


def edits(base: SceneStream, splats: Splats | None = None) -> list[SceneStream]:
    """Three updates, each of the result of the one before."""
    updates, splats = [], splats or some_splats()
    for edit in (moved, recoloured, lambda each: each.select(outside())):
        splats = edit(splats)
        updates.append(encode_update(base, splats))
        base = apply_update(base, updates[-1])
    return updates


@pytest.mark.slow
@pytest.mark.parametrize("packetization", [SMALL, DATAGRAM])
def test_receivers_of_every_state_reach_the_newest_one(packetization) -> None:
    source = encode_splats(some_splats(), packetization)
    chain = UpdateChain(source, into_datagrams(source))
    states = [chain.scene]
    for update in edits(source):
        chain = chain.extended(update)
        states.append(chain.scene)
    for state in states:
        while (update := chain.offers()[update_name(manifest_digest(state.manifest))]) is not None:
            assert update.manifest.packetization.hashed
            state = apply_update(state, update)
        assert stream_to_bytes(state) == stream_to_bytes(chain.scene)
    rows = [sorted_rows(decode_stream(stream).scene.splats) for stream in (chain.source, chain.scene)]
    np.testing.assert_array_equal(*rows)
    assert chain.scene.manifest.num_elements == 500 - len(BALL)


def test_gaussians_keep_their_classes_in_datagrams() -> None:
    source, splats = encode_splats(some_splats(), SMALL), some_splats()
    finest = int(decode_stream(source).scene.coding.precision_classes.max())
    chain, full = UpdateChain(source, into_datagrams(source)), UpdateChain(source, source)
    # The second update has a class that no Gaussian has after the first one.
    for level in (-1, 0):
        classes = np.full(splats.num_gaussians, level, np.int8)
        splats = recoloured(splats)
        full = full.edited(SplatScene(replace(splats, sh=splats.sh + np.float32(0.2))), finest, classes)
        update = full.updates[-1]
        chain = chain.extended(update)
        for stream in (full.scene, chain.source, chain.scene):
            np.testing.assert_array_equal(decode_stream(stream).scene.coding.precision_classes, finest + level)
        rows = [sorted_rows(decode_stream(stream).scene.splats) for stream in (chain.source, chain.scene)]
        np.testing.assert_array_equal(*rows)


def test_updates_in_packets_larger_than_datagrams_are_split() -> None:
    source, splats = encode_splats(some_splats(), DATAGRAM), some_splats()
    update = encode_update(source, replace(splats, means=splats.means + np.float32(0.3)))
    large = repack(update, replace(DATAGRAM, block_size=700, packet_bytes=9000))
    assert max(packet.num_bytes for packet in large.packets) > 2 * DATAGRAM_PACKET_BYTES
    [offered] = UpdateChain(source, source).extended(large).updates
    assert max(packet.num_bytes for packet in offered.packets) <= DATAGRAM_PACKET_BYTES
    assert stream_to_bytes(apply_update(source, offered)) == stream_to_bytes(apply_update(source, update))


def test_updates_of_another_state_are_refused() -> None:
    source = encode_splats(some_splats(), DATAGRAM)
    first, second, _ = edits(source)
    with pytest.raises(InvalidValueError, match="the update changes another stream"):
        UpdateChain(source, source).extended(second)
    with pytest.raises(InvalidValueError, match="the update changes another stream"):
        UpdateChain(source, source).extended(first).extended(first)


def test_old_updates_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    source = encode_splats(some_splats(), DATAGRAM)
    names = [update_name(manifest_digest(source.manifest))]
    monkeypatch.setattr(chains, "MAX_UPDATES", 2)
    chain = UpdateChain(source, source)
    for update in edits(source):
        chain = chain.extended(update)
        names.append(update_name(chain.source_digest))
    assert list(chain.offers()) == names[1:]
    assert list(chain.offers().values())[-1] is None


def test_updates_larger_than_the_scene_are_dropped() -> None:
    source = encode_splats(some_splats(), DATAGRAM)
    splats, chain = some_splats(), UpdateChain(source, source)
    for _ in range(3):
        splats = replace(splats, means=splats.means + np.float32(0.3))
        chain = chain.extended(encode_update(chain.source, SplatScene(splats)))
    assert len(chain.updates) == 1


def test_the_order_of_removed_gaussians_does_not_depend_on_their_order_in_the_stream() -> None:
    splats = some_splats()
    splats.means[BALL] = splats.means[BALL[0]]  # in one cell
    scene = decode_stream(encode_splats(splats, DATAGRAM)).scene
    shuffled = np.random.default_rng(0).permutation(500)
    first = scene.splats.select(curve_order(scene.splats, scene.coding))
    other = scene.splats.select(shuffled)
    second = other.select(curve_order(other, scene.coding))
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, getattr(second, name))
