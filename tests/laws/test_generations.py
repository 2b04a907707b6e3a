"""Decoded scenes are a fixed point: encoding them again gives the same integers in any packets."""

import base64
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenes import tiny_causal_scene, tiny_scene
from splatwire.anchors.scene_file import load_scene, save_partial, save_scene
from splatwire.bitstream import PRESETS, Packetization, SceneStream, spread_packetization, stream_from_bytes
from splatwire.codec import decode_stream, encode_scene, repack, with_section
from splatwire.codec.gaussians.coding import coding_to_bytes
from splatwire.codec.gaussians.copies_encoder import write_copies
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.io import open_scene
from splatwire.io import save_scene as save_scene_as
from splatwire.io.formats import PlySteps, write_splats
from splatwire.types import AnchorScene, Copies, SplatScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

ANCHORS = {"hacpp": tiny_scene(5, 300), "causal": tiny_causal_scene(5, 300)}
PACKETIZATIONS = {
    "paper": PRESETS["paper"],
    "few": Packetization(block_size=64, lanes=3),
    "contiguous": Packetization(block_size=100, lanes=2, grouping="contiguous"),
    "spread": spread_packetization(300),
    "datagram": PRESETS["datagram"],
    "small datagrams": replace(PRESETS["datagram"], packet_bytes=500),
}


def tensors(scene: AnchorScene) -> dict[str, np.ndarray]:
    """All rendered attributes, by name."""
    found = dict(vars(scene.anchors))
    for name, head in vars(scene.heads).items():
        for layer in ("hidden", "output"):
            found |= {f"{name}.{layer}.{part}": value for part, value in vars(getattr(head, layer)).items()}
    return found


def assert_equal(one: AnchorScene, other: AnchorScene) -> None:
    for name, values in tensors(one).items():
        assert np.array_equal(values, tensors(other)[name]), name


def digest(stream: SceneStream) -> str:
    return stream.manifest.symbols_digest


@pytest.mark.parametrize("codec", ANCHORS)
def test_decoded_anchors_encode_to_the_same_stream(codec: str) -> None:
    first = encode_scene(ANCHORS[codec], PACKETIZATIONS["few"])
    again = encode_scene(decode_stream(first).scene, PACKETIZATIONS["few"])
    assert digest(again) == digest(first)
    assert [packet.payload for packet in again.packets] == [packet.payload for packet in first.packets]
    assert abs(again.num_bytes - first.num_bytes) <= 0.01 * first.num_bytes  # steps of tiny networks have many names
    third = encode_scene(decode_stream(again).scene, PACKETIZATIONS["few"])
    assert third.side_info == again.side_info


@pytest.mark.parametrize("codec", ANCHORS)
@pytest.mark.parametrize("file", ["scene", "partial"])
def test_decoded_anchors_are_a_fixed_point_through_files(codec: str, file: str, tmp_path: Path) -> None:
    first = encode_scene(ANCHORS[codec], PACKETIZATIONS["few"])
    received, path = decode_stream(first), tmp_path / "decoded.safetensors"
    save_scene(received.scene, path) if file == "scene" else save_partial(received, path)
    assert digest(encode_scene(load_scene(path), PACKETIZATIONS["few"])) == digest(first)


@pytest.mark.parametrize("codec", ANCHORS)
@pytest.mark.parametrize("packets", PACKETIZATIONS)
def test_decoded_anchors_are_stable_under_other_packetizations(codec: str, packets: str) -> None:
    first = decode_stream(encode_scene(ANCHORS[codec], PACKETIZATIONS["few"])).scene
    assert_equal(decode_stream(encode_scene(first, PACKETIZATIONS[packets])).scene, first)


@pytest.mark.parametrize("codec", ANCHORS)
def test_decoded_anchors_are_stable_with_tiers(codec: str) -> None:
    first = decode_stream(encode_scene(ANCHORS[codec], PACKETIZATIONS["few"])).scene
    tiers = (np.arange(first.num_elements) % 3 > 0).astype(np.uint8)
    assert_equal(decode_stream(encode_scene(first, PACKETIZATIONS["datagram"], tiers=tiers)).scene, first)


def test_hacpp_anchors_are_stable_in_separated_packets() -> None:
    first = decode_stream(encode_scene(ANCHORS["hacpp"], PACKETIZATIONS["few"])).scene
    native = decode_stream(encode_scene(first, PRESETS["hacpp"])).scene
    again: Scene = decode_stream(encode_scene(native, PACKETIZATIONS["few"])).scene
    assert_equal(again, first)


@pytest.mark.parametrize("codec", ANCHORS)
def test_part_of_a_decoded_scene_keeps_its_integers(codec: str) -> None:
    first = decode_stream(encode_scene(ANCHORS[codec], PACKETIZATIONS["few"])).scene
    part = first.select(np.arange(first.num_elements) % 4 > 0)
    assert_equal(decode_stream(encode_scene(part, PACKETIZATIONS["few"])).scene, part)


def assert_same_content(one: SceneStream, other: SceneStream) -> None:
    assert one.side_info == other.side_info
    assert [(p.id, p.payload) for p in one.packets] == [(p.id, p.payload) for p in other.packets]
    assert digest(one) == digest(other)


@pytest.mark.parametrize("codec", ANCHORS)
@pytest.mark.parametrize("packets", PACKETIZATIONS)
def test_repacked_streams_decode_to_the_same_scene_and_back_to_the_same_bytes(codec: str, packets: str) -> None:
    tiers = (np.arange(300) % 3 > 0).astype(np.uint8)
    first = with_section(encode_scene(ANCHORS[codec], PACKETIZATIONS["few"], tiers=tiers), "mine", b"1")
    packed = repack(first, PACKETIZATIONS[packets])
    assert packed.side_info == first.side_info
    assert [tier.num_elements for tier in packed.manifest.tiers] == [tier.num_elements for tier in first.manifest.tiers]
    assert_equal(decode_stream(packed).scene, decode_stream(first).scene)
    assert_same_content(repack(packed, PACKETIZATIONS["few"]), first)


def test_separated_attributes_are_repacked_both_ways() -> None:
    first = encode_scene(ANCHORS["hacpp"], PACKETIZATIONS["few"])
    native = repack(first, PRESETS["hacpp"])
    assert native.manifest.packetization.separated
    assert_same_content(repack(native, PACKETIZATIONS["few"]), first)


def test_incomplete_streams_and_sections_of_another_order_are_not_repacked() -> None:
    first = with_section(encode_scene(ANCHORS["hacpp"], PACKETIZATIONS["few"]), "mine", b"1")
    with pytest.raises(InvalidValueError, match="'mine' of this stream is for anchors in morton order"):
        repack(first, PRESETS["hacpp"])
    with pytest.raises(InvalidValueError, match="1 packets are missing"):
        repack(replace(first, packets=first.packets[1:]), PRESETS["datagram"])


def gaussians(degree: int, seed: int = 0) -> tuple[SplatScene, np.ndarray]:
    """Gaussians of all kinds, some outside the ranges of the format, and their precision classes."""
    rng = np.random.default_rng(seed)
    count = 400
    means = rng.normal(size=(count, 3)) * 2.0 ** rng.integers(-3, 4, (count, 1)) + [100, -7, 0]
    scales = np.exp(rng.normal(size=(count, 3)) * 2 - 4)
    scales[:40] = scales[:40, :1]  # balls
    scales[40:60, 2] *= 2.0**-14  # thinner than the format allows
    opacities = rng.uniform(0.001, 1.0, count)
    opacities[::7] = 1.0
    opacities[1::50] = 1e-5
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3)) * rng.choice([0.01, 0.3, 20.0], (count, 1, 1))
    arrays = (means, rng.normal(size=(count, 4)), scales, opacities, sh)
    splats = Splats(*(array.astype(np.float32) for array in arrays))
    return SplatScene(splats), rng.integers(-6, 2, count)


def ordered(stream: SceneStream) -> tuple[np.ndarray, np.ndarray]:
    """All numbers of a stream's Gaussians with their precision classes, sorted by these numbers."""
    scene = decode_stream(stream).scene
    assert isinstance(scene, SplatScene)
    assert scene.coding is not None
    columns = [v.reshape(len(v), -1) for v in (*vars(scene.splats).values(), scene.coding.precision_classes)]
    numbers = np.concatenate(columns, axis=1)
    return numbers[np.lexsort(numbers.T)], numbers


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("quality", ["small", "default", "near-lossless"])
def test_decoded_gaussians_encode_to_the_same_integers(degree: int, quality: str) -> None:
    scene, classes = gaussians(degree)
    first = encode_scene(scene, PACKETIZATIONS["few"], class_offsets=classes, quality=quality)
    again = encode_scene(decode_stream(first).scene, PACKETIZATIONS["few"])
    assert digest(again) == digest(first)
    assert np.array_equal(ordered(again)[1], ordered(first)[1])
    assert abs(again.num_bytes - first.num_bytes) <= 0.005 * first.num_bytes
    assert digest(encode_scene(decode_stream(again).scene, PACKETIZATIONS["few"])) == digest(first)


@pytest.mark.parametrize("degree", [0, 3])
def test_decoded_gaussians_are_a_fixed_point_through_a_ply(degree: int, tmp_path: Path) -> None:
    """The received and all Gaussians; a changed row of the file has no recorded rounding."""
    scene, classes = gaussians(degree)
    first, path = encode_scene(scene, PACKETIZATIONS["few"], class_offsets=classes), tmp_path / "decoded.ply"
    save_scene_as(decode_stream(first), path)
    assert digest(encode_scene(open_scene(path), PACKETIZATIONS["few"])) == digest(first)
    some = decode_stream(first.with_packets(first.packets[::2]))
    save_scene_as(some, path)
    again = ordered(encode_scene(open_scene(path), PACKETIZATIONS["few"]))[0]
    received = some.scene.elements.select(some.loss_mask.received.all(axis=1))
    assert set(map(bytes, again[:, :3])) == set(map(bytes, received.means))
    assert set(map(bytes, again[:, 7:10])) == set(map(bytes, received.scales))
    raw = bytearray(path.read_bytes())
    raw[-100] ^= 1
    path.write_bytes(raw)
    changed = open_scene(path)
    assert isinstance(changed, SplatScene)
    assert changed.coding is None


def test_mutated_rounding_records_of_a_ply_are_read_or_refused(tmp_path: Path) -> None:
    scene, _ = gaussians(1)
    rng, path, refused = np.random.default_rng(0), tmp_path / "scene.ply", 0
    coding = decode_stream(encode_scene(scene, PACKETIZATIONS["few"])).scene.coding
    good = np.frombuffer(coding_to_bytes(coding), np.uint8)
    for case in range(120):
        content, marks = good.copy(), coding.precision_classes.copy()
        at = rng.integers(len(good) if case % 2 else 16)
        content[at] = rng.choice([0, 1, 63, 64, 127, 128, 255])
        if case % 5 == 0:
            marks[rng.integers(400)] = rng.integers(256)
        write_splats([scene.splats], path, PlySteps(content.tobytes(), marks))
        try:
            found = decode_stream(encode_scene(open_scene(path), PACKETIZATIONS["few"])).scene.elements
        except SplatwireError:
            refused += 1
        else:
            assert all(bool(np.isfinite(values).all()) for values in vars(found).values())
    assert 0 < refused < 120


@pytest.mark.parametrize("packets", PACKETIZATIONS)
def test_gaussians_are_equal_under_every_packetization(packets: str) -> None:
    scene, classes = gaussians(2)
    first = encode_scene(scene, PACKETIZATIONS["few"], class_offsets=classes)
    decoded, tiers = decode_stream(first).scene, (np.arange(400) % 3 > 0).astype(np.uint8)
    for other in (
        encode_scene(scene, PACKETIZATIONS[packets], class_offsets=classes),
        encode_scene(decoded, PACKETIZATIONS[packets]),
        encode_scene(decoded, PACKETIZATIONS[packets], tiers=tiers),
        repack(first, PACKETIZATIONS[packets]),
    ):
        assert np.array_equal(ordered(other)[0], ordered(first)[0])
    back = repack(repack(first, PACKETIZATIONS[packets]), PACKETIZATIONS["few"])
    assert digest(back) == digest(first)
    assert_same_content(back, repack(first, PACKETIZATIONS["few"]))


def test_part_of_decoded_gaussians_keeps_its_integers() -> None:
    scene, classes = gaussians(1)
    decoded = decode_stream(encode_scene(scene, PACKETIZATIONS["few"], class_offsets=classes)).scene
    part = decoded.select(np.arange(400) % 4 > 0)
    found = ordered(encode_scene(part, PRESETS["datagram"]))[0]
    assert isinstance(part, SplatScene)
    assert set(map(bytes, found[:, :3])) == set(map(bytes, part.splats.means))


@pytest.mark.parametrize("seed", range(6))
def test_positions_near_float_resolution_are_stable(seed: int) -> None:
    """Positions with cells about as small as the difference of neighbouring floats."""
    rng = np.random.default_rng(seed)
    scene, _ = gaussians(0, seed)
    splats = scene.splats
    means = (splats.means + 2.0 ** int(rng.integers(4, 16))) * 1.0
    scales = np.exp2(rng.uniform(-14, -2, (400, 3)).astype(np.float32))
    far = SplatScene(replace(splats, means=means, scales=scales))
    first = encode_scene(far, PACKETIZATIONS["few"], quality="near-lossless")
    assert digest(encode_scene(decode_stream(first).scene, PACKETIZATIONS["few"])) == digest(first)


def test_repacked_gaussians_keep_their_copies() -> None:
    scene, classes = gaussians(1)
    first = encode_scene(scene, PACKETIZATIONS["few"], class_offsets=classes)
    decoded = decode_stream(first).scene
    assert isinstance(decoded, SplatScene)
    info = open_side_info(first.manifest, first.side_info)
    chosen = np.arange(0, 400, 9)
    section = write_copies(decoded.splats, chosen, info, precision_class=2, growth=(1.0, 0.5, 0.25))
    first = with_section(first, "sketch", section)
    packed = repack(first, PRESETS["datagram"])
    partials = decode_stream(first), decode_stream(packed)
    before, after = (received[Copies] for received in partials)
    assert after.growth == before.growth
    for name, values in vars(before.splats).items():
        assert np.array_equal(values, getattr(after.splats, name))
    places = [received.scene.positions[received[Copies].indices] for received in partials]
    assert np.array_equal(*places)


def test_streams_of_version_2_are_not_repacked() -> None:
    pinned = json.loads((Path(__file__).parents[1] / "golden" / "gaussians.json").read_text())
    stream = stream_from_bytes(base64.b64decode(pinned["lanes"]["swz"]))[0]
    with pytest.raises(InvalidValueError, match="an older release encoded these Gaussians"):
        repack(stream, PRESETS["datagram"])
    again = encode_scene(decode_stream(stream).scene, PACKETIZATIONS["few"])
    assert digest(encode_scene(decode_stream(again).scene, PACKETIZATIONS["few"])) == digest(again)
