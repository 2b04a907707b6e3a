"""An update and the old stream give the changed stream, byte for byte, or one error."""

import contextlib
import os
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.gaussians.test_gaussians import DATAGRAM, SMALL, some_splats
from explicit import encode_splats
from mutations import mutated_bytes
from splatwire.bitstream import SceneStream, stream_from_bytes, stream_to_bytes
from splatwire.bitstream.sections import sections_of, with_section
from splatwire.codec import (
    apply_update,
    can_repack,
    decode_stream,
    encode_scene,
    encode_update,
    into_datagrams,
    repack,
)
from splatwire.codec.gaussians.copies import SECTION as SKETCH
from splatwire.codec.gaussians.copies import read_copies
from splatwire.codec.gaussians.copies_encoder import write_copies
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.codec.gaussians.rounding import round_splats
from splatwire.codec.update.apply import describe_update
from splatwire.codec.update.matching import find_unchanged
from splatwire.codec.update.removed import read_removed, write_removed
from splatwire.codec.update.section import SECTION, manifest_digest
from splatwire.errors import BitstreamError, DesyncError, InvalidValueError, SplatwireError
from splatwire.types import SplatScene
from splatwire.types.background import BLACK
from splatwire.types.metadata import SceneMetadata, StartView
from splatwire.types.splats import Splats

CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "200"))
COUNT = 500
BALL = np.argsort(np.linalg.norm(some_splats().means - some_splats().means[7], axis=1))[:40]
"""Gaussians of `some_splats` that the edits change."""
CLASSES = -(np.arange(COUNT) % 3).astype(np.int8)


def outside() -> np.ndarray:
    return np.setdiff1d(np.arange(COUNT), BALL)


def moved(splats: Splats) -> Splats:
    means = splats.means.copy()
    means[BALL, 0] += 0.7
    return replace(splats, means=means)


def recoloured(splats: Splats) -> Splats:
    sh = splats.sh.copy()
    sh[BALL, 0] += 0.4
    return replace(splats, sh=sh)


EDITS = {
    "same": (lambda splats: splats, 0, 0),
    "deleted": (lambda splats: splats.select(outside()), 40, 0),
    "moved": (moved, 40, 40),
    "recoloured": (recoloured, 40, 40),
    "reversed": (lambda splats: splats.select(np.arange(COUNT)[::-1]), 0, 0),
    "only the ball": (lambda splats: splats.select(BALL), COUNT - 40, 0),
    "nothing stays": (lambda splats: replace(splats, means=splats.means + np.float32(0.3)), COUNT, COUNT),
}


@pytest.fixture(scope="module", params=["fixed", "datagram"])
def base(request: pytest.FixtureRequest) -> SceneStream:
    return encode_splats(some_splats(), SMALL if request.param == "fixed" else DATAGRAM, class_offsets=CLASSES)


def sorted_rows(splats: Splats) -> np.ndarray:
    rows = np.concatenate([values.reshape(splats.num_gaussians, -1) for values in vars(splats).values()], axis=1)
    return rows[np.lexsort(rows.T)]


def classes_of(edit: str) -> np.ndarray:
    """Precision class of each Gaussian of an edited scene."""
    order = {"deleted": outside(), "only the ball": BALL, "reversed": np.arange(COUNT)[::-1]}
    return CLASSES[order.get(edit, np.arange(COUNT))]


@pytest.mark.parametrize("edit", EDITS)
def test_changed_streams_decode_to_the_edited_scene_in_the_old_steps(base: SceneStream, edit: str) -> None:
    change, num_removed, num_new = EDITS[edit]
    after, classes = change(some_splats()), classes_of(edit)
    update = encode_update(base, SplatScene(after), class_offsets=classes)
    result = apply_update(base, update)
    coding = decode_stream(base).scene.coding
    levels = (classes - CLASSES.min()).astype(np.uint8) + np.uint8(int(coding.precision_classes.max()) + CLASSES.min())
    expected = round_splats(after, replace(coding, precision_classes=levels))
    np.testing.assert_array_equal(sorted_rows(decode_stream(result).scene.splats), sorted_rows(expected))
    counts = describe_update(base, update)
    assert counts == {"num_kept": COUNT - num_removed, "num_removed": num_removed, "num_new": num_new}
    assert result.manifest.packetization == base.manifest.packetization


@pytest.mark.parametrize("edit", EDITS)
def test_applying_gives_the_bytes_that_the_encoder_promised(base: SceneStream, edit: str) -> None:
    update = encode_update(base, EDITS[edit][0](some_splats()), class_offsets=classes_of(edit))
    received = stream_from_bytes(stream_to_bytes(update))[0]
    first, second = (apply_update(base, one, threads=threads) for one, threads in ((update, 1), (received, 2)))
    assert stream_to_bytes(first) == stream_to_bytes(second)
    named = bytes.fromhex(manifest_digest(first.manifest))
    assert named in sections_of(update)[SECTION]


@pytest.mark.parametrize("edit", ["deleted", "moved", "recoloured"])
def test_edits_of_the_decoded_scene_and_of_its_source_remove_the_same_gaussians(base: SceneStream, edit: str) -> None:
    scene = decode_stream(base).scene
    decoded = scene.splats.select(find_unchanged(scene.splats, scene.coding, some_splats()))
    updates = [
        encode_update(base, EDITS[edit][0](splats), class_offsets=classes_of(edit))
        for splats in (some_splats(), decoded)
    ]
    np.testing.assert_array_equal(*(decode_removed(update, base) for update in updates))
    assert updates[0].manifest.num_elements == updates[1].manifest.num_elements


def test_updates_follow_each_other(base: SceneStream) -> None:
    first = apply_update(base, encode_update(base, moved(some_splats()), class_offsets=CLASSES))
    second = encode_update(first, some_splats(), class_offsets=CLASSES)
    assert describe_update(first, second) == {"num_kept": 460, "num_removed": 40, "num_new": 40}
    back = decode_stream(apply_update(first, second)).scene.splats
    np.testing.assert_array_equal(sorted_rows(back), sorted_rows(decode_stream(base).scene.splats))


def test_each_of_several_equal_gaussians_counts() -> None:
    splats = some_splats(60)
    base = encode_splats(splats.select(np.array([*range(60), 5, 5, 7])), SMALL)
    update = encode_update(base, splats.select(np.array([*range(60), 5])))
    assert describe_update(base, update) == {"num_kept": 61, "num_removed": 2, "num_new": 0}
    assert apply_update(base, update).manifest.num_elements == 61


def test_updates_are_a_small_part_of_large_streams() -> None:
    splats = some_splats(6000)
    base = encode_splats(splats, DATAGRAM)
    near = np.argsort(np.linalg.norm(splats.means - splats.means[0], axis=1))[:120]
    update = encode_update(base, splats.select(np.setdiff1d(np.arange(6000), near)))
    assert len(sections_of(update)[SECTION]) < 250
    assert update.num_bytes < 0.03 * base.num_bytes


def test_background_metadata_and_sections_of_the_old_stream_stay() -> None:
    base = with_section(encode_splats(some_splats(), SMALL, background=(0.25, 0.5, 1.0)), "own", b"content")
    result = apply_update(base, encode_update(base, moved(some_splats())))
    assert sections_of(result) == sections_of(base)


def test_copies_of_gaussians_that_stay_are_kept() -> None:
    plain = encode_splats(some_splats(), DATAGRAM)
    info, splats = open_side_info(plain.manifest, plain.side_info), decode_stream(plain).scene.splats
    places = np.arange(0, COUNT, 9)
    base = with_section(plain, SKETCH, write_copies(splats, places, info, precision_class=2, growth=(0.25, 0.75, 0.5)))
    at = find_unchanged(splats, decode_stream(base).scene.coding, some_splats())
    result = apply_update(base, encode_update(base, some_splats().select(outside())))
    copies = read_copies(open_side_info(result.manifest, result.side_info), result.manifest.num_elements)
    expected = np.setdiff1d(places, at[BALL])
    found = decode_stream(result).scene.splats.select(copies.indices)
    assert copies.growth == (0.25, 0.75, 0.5)
    np.testing.assert_array_equal(sorted_rows(found), sorted_rows(splats.select(expected)))
    result = apply_update(base, encode_update(base, some_splats(seed=1)))
    assert SKETCH not in sections_of(result)


def test_updates_in_other_packets_give_the_same_stream(base: SceneStream) -> None:
    splats = moved(some_splats())
    splats.means[BALL[:9]] = splats.means[BALL[0]]  # in one cell of the curve that sorts Gaussians
    update = encode_update(base, splats)
    packed = repack(update, replace(DATAGRAM, packet_bytes=256))
    assert len(packed.packets) > len(update.packets) or update.manifest.packetization == SMALL
    assert stream_to_bytes(apply_update(base, packed)) == stream_to_bytes(apply_update(base, update))


def test_updates_without_new_gaussians_are_put_into_other_packets_too(base: SceneStream) -> None:
    update = encode_update(base, some_splats().select(outside()))
    assert not update.packets
    for packed in (repack(update, replace(DATAGRAM, packet_bytes=256)), into_datagrams(update)):
        assert packed.manifest.packetization.hashed
        assert can_repack(packed)
        received = stream_from_bytes(stream_to_bytes(packed))[0]
        assert stream_to_bytes(apply_update(base, received)) == stream_to_bytes(apply_update(base, update))


def test_another_antialiasing_is_logged(base: SceneStream, caplog: pytest.LogCaptureFixture) -> None:
    encode_update(base, some_splats())
    assert not caplog.text
    update = encode_update(base, SplatScene(some_splats(), antialiased=True))
    assert "the changed scene is antialiased, its stream is not: an update keeps what the stream has" in caplog.text
    assert not decode_stream(apply_update(base, update)).scene.antialiased


def test_another_background_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    grey = (0.1, 0.1, 0.1)  # float32 rounds it
    base = encode_scene(SplatScene(some_splats(), background=grey), SMALL)
    for known in (grey, BLACK):  # files of other formats have no background, which reads as black
        encode_update(base, SplatScene(some_splats(), background=known))
    assert not caplog.text
    update = encode_update(base, SplatScene(some_splats(), background=(0.0, 0.25, 0.0)))
    assert "has the background colour (0, 0.25, 0), its stream (0.1, 0.1, 0.1): an update keeps that" in caplog.text
    assert decode_stream(apply_update(base, update)).scene.background == decode_stream(base).scene.background


def test_a_scene_far_from_the_origin_of_its_stream_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    """Files such as SPZ that another program has edited lack the origin of a scene in map coordinates."""
    origin, near = (451_235.0, 5_411_876.0, 118.0), (451_230.0, 5_411_870.0, 118.0)
    base = encode_scene(SplatScene(some_splats(), origin=origin), SMALL)
    encode_update(base, SplatScene(some_splats().moved_origin(origin, near), origin=near))
    assert not caplog.text
    encode_update(base, SplatScene(some_splats()))
    assert "5.41188e+06 away from the origin of its stream (451235 5411876 118), which an update keeps" in caplog.text
    assert "rounded to steps of 0.5" in caplog.text


def test_other_metadata_than_that_of_the_stream_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    view = StartView((1.0, 2.0, 3.0), (0.0, 0.1, 0.2), (0.0, -1.0, 0.0))
    known = SceneMetadata(title="Room", author="Ana", up="z", view=view)
    base = encode_scene(SplatScene(some_splats(), metadata=known), SMALL)
    edited = SplatScene(moved(some_splats()))
    zero, origin = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    there = known.moved_origin(zero, origin)
    far = SplatScene(edited.splats.moved_origin(zero, origin), origin=origin, metadata=there)
    for same in (edited, far, replace(edited, metadata=known), replace(edited, metadata=SceneMetadata(up="z"))):
        encode_update(base, same)
    assert not caplog.text
    encode_update(base, replace(edited, metadata=replace(known, title="Hall", license="CC0")))
    assert "another title, license than its stream" in caplog.text


def test_incomplete_and_foreign_streams_are_refused(base: SceneStream) -> None:
    update = encode_update(base, moved(some_splats()))
    lost = update.with_packets(update.packets[1:])
    with pytest.raises(InvalidValueError, match=r"1 of \d packets of the update are missing: the old stream remains"):
        apply_update(base, lost)
    with pytest.raises(InvalidValueError, match="packets of the stream to change are missing"):
        apply_update(base.with_packets(base.packets[1:]), update)
    with pytest.raises(InvalidValueError, match="the update changes another stream: one with the digest"):
        apply_update(apply_update(base, update), update)
    with pytest.raises(InvalidValueError, match="the same scene in other packets is another stream, too"):
        apply_update(repack(base, replace(DATAGRAM, packet_bytes=300)), update)
    with pytest.raises(InvalidValueError, match="the update changes another stream"):
        describe_update(apply_update(base, update), update)
    with pytest.raises(BitstreamError, match="has Gaussians, it is not an update"):
        apply_update(base, base)


def test_streams_and_scenes_that_have_no_updates_are_refused() -> None:
    splats = some_splats()
    base = encode_splats(splats, SMALL)
    tiered = encode_splats(splats, SMALL, tiers=np.arange(COUNT) % 2)
    with pytest.raises(InvalidValueError, match="importance tiers cannot be updated"):
        encode_update(tiered, splats)
    update = encode_update(base, moved(splats))
    with pytest.raises(InvalidValueError, match="not for schema 'update'"):
        encode_update(update, splats)
    with pytest.raises(InvalidValueError, match="of degree 2, its stream those of degree 1"):
        encode_update(base, some_splats(degree=2))
    with pytest.raises(InvalidValueError, match="no Gaussian that draws anything"):
        encode_update(base, replace(splats, opacities=np.zeros(COUNT, np.float32)))
    with pytest.raises(InvalidValueError, match=r"see `splatwire\.encode_update`"):
        encode_scene(decode_stream(update).scene)


def test_a_result_with_other_bytes_is_refused(base: SceneStream) -> None:
    update = encode_update(base, moved(some_splats()))
    section = bytearray(sections_of(update)[SECTION])
    section[40] ^= 1  # digest of the result
    with pytest.raises(DesyncError, match="get that stream as a whole"):
        apply_update(base, with_section(update, SECTION, bytes(section)))
    other = encode_update(encode_splats(some_splats(seed=3), SMALL, quality="small"), some_splats(seed=4))
    section[40] ^= 1
    with pytest.raises(BitstreamError, match="other quantisation steps"):
        apply_update(base, with_section(other, SECTION, bytes(section)))


def test_an_update_that_removes_everything_is_refused(base: SceneStream) -> None:
    update = encode_update(base, some_splats().select(outside()))
    section = sections_of(update)[SECTION]
    removed = write_removed(np.ones(COUNT, bool))
    head = len(section) - len(write_removed(decode_removed(update, base)))
    with pytest.raises(BitstreamError, match="removes all Gaussians"):
        apply_update(base, with_section(update, SECTION, section[:head] + removed))


def decode_removed(update: SceneStream, base: SceneStream) -> np.ndarray:
    return read_removed(decode_stream(update).scene.removed, base.manifest.num_elements)


@given(
    count=st.integers(1, 2000), density=st.sampled_from([0.0, 0.01, 0.3, 0.99, 1.0]), seed=st.integers(0, 1 << 16),
    block=st.sampled_from([1, 16, 300]),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_masks_of_removed_gaussians_round_trip(count: int, density: float, seed: int, block: int) -> None:
    rng = np.random.default_rng(seed)
    mask = np.repeat(rng.random(-(-count // block)) < density, block)[:count]
    np.testing.assert_array_equal(read_removed(write_removed(mask), count), mask)


@given(data=st.binary(max_size=200), count=st.integers(1, 5000))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_a_mask_or_an_error(data: bytes, count: int) -> None:
    with contextlib.suppress(BitstreamError):
        assert read_removed(data, count).shape == (count,)


def test_random_masks_take_their_entropy() -> None:
    mask = np.random.default_rng(0).random(100_000) < 0.2
    entropy = -(0.2 * np.log2(0.2) + 0.8 * np.log2(0.8)) * 100_000 / 8
    assert len(write_removed(mask)) < 1.04 * entropy


def applied(base: SceneStream, data: bytes) -> bytes | None:
    """Bytes of the changed stream; None after an error."""
    try:
        return stream_to_bytes(apply_update(base, stream_from_bytes(data)[0]))
    except SplatwireError:
        return None


@pytest.mark.slow
def test_mutated_updates_give_the_changed_stream_or_one_error(base: SceneStream) -> None:
    data = stream_to_bytes(encode_update(base, moved(some_splats())))
    found = [applied(base, mutated_bytes(data, random.Random(case))) for case in range(CASES)]
    assert set(found) <= {None, applied(base, data)}
    assert found.count(None) > CASES / 2


@pytest.mark.slow
def test_mutated_sections_give_the_changed_stream_or_one_error(base: SceneStream) -> None:
    update = encode_update(base, moved(some_splats()))
    section, expected = sections_of(update)[SECTION], applied(base, stream_to_bytes(update))
    mutated = (mutated_bytes(section, random.Random(case)) for case in range(CASES))
    found = [applied(base, stream_to_bytes(with_section(update, SECTION, one))) for one in mutated]
    assert set(found) <= {None, expected}
