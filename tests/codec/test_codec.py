import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenes import tiny_causal_scene, tiny_scene
from splatwire.bitstream import Packetization, SceneStream, make_packet, read_stream, stream_to_bytes, write_stream
from splatwire.bitstream.limits import SCHEMAS
from splatwire.codec import decode_stream, encode_scene, scene_in_order, side_info_parts
from splatwire.codec.registry import schema_named
from splatwire.errors import BitstreamError, DesyncError, InvalidValueError, MissingSideInfoError, SplatwireError
from splatwire.types import AnchorScene, HacppConfig, Prior

PACKETIZATION = Packetization(block_size=100, lanes=4)
GOLDEN = Path(__file__).parent.parent / "golden" / "tiny.swz"
GOLDEN_CAUSAL = GOLDEN.with_name("tiny_causal.swz")
ATTRIBUTES = ("positions", "features", "scalings", "offsets", "mask")


@pytest.fixture(scope="module")
def stream(scene: AnchorScene) -> SceneStream:
    return encode_scene(scene, PACKETIZATION)


def attributes_of(scene: AnchorScene) -> list[np.ndarray]:
    return [getattr(scene.anchors, name) for name in ATTRIBUTES]


def test_decoded_values_are_within_half_a_step(scene: AnchorScene, stream: SceneStream) -> None:
    received = decode_stream(stream)
    decoded, prior = received.scene.anchors, received[Prior]
    assert np.array_equal(decoded.positions, scene.anchors.positions)
    assert np.array_equal(decoded.mask, scene.anchors.mask)
    for name, step in (("features", prior.feature.step), ("scalings", prior.scaling.step)):
        error = np.abs(getattr(decoded, name) - getattr(scene.anchors, name))
        assert (error <= 0.5001 * step).all(), name
    error = np.abs(decoded.offsets - scene.anchors.offsets).reshape(decoded.num_anchors, -1)
    assert (error <= 0.5001 * prior.offset.step).all()
    assert not decoded.offsets[~decoded.mask].any()
    assert received.loss_mask.num_lost == 0


def test_lost_packets_affect_only_their_anchors(stream: SceneStream) -> None:
    whole = decode_stream(stream)
    kept = [p for i, p in enumerate(stream.packets) if i % 3]
    received = decode_stream(stream.with_packets(kept))
    plan = stream.manifest.plan
    lost = np.concatenate([plan.members(p.id) for i, p in enumerate(stream.packets) if i % 3 == 0])
    known = received.loss_mask.fully_received
    assert sorted(lost) == np.flatnonzero(~known).tolist()
    for a, b in zip(attributes_of(whole.scene), attributes_of(received.scene), strict=True):
        assert np.array_equal(a[known], b[known])
    assert np.array_equal(whole.scene.anchors.positions, received.scene.anchors.positions)
    assert not received.scene.anchors.features[~known].any()
    assert not received.scene.anchors.mask[~known].any()
    assert np.array_equal(whole[Prior].feature.mean, received[Prior].feature.mean)


def test_every_packet_decodes_alone(stream: SceneStream) -> None:
    whole = decode_stream(stream).scene.anchors
    for packet in stream.packets[::5]:
        alone = decode_stream(stream.with_packets([packet]))
        ranks = stream.manifest.plan.members(packet.id)
        assert np.array_equal(np.flatnonzero(alone.loss_mask.fully_received), ranks)
        assert np.array_equal(alone.scene.anchors.features[ranks], whole.features[ranks])


def test_side_information_alone_decodes(stream: SceneStream) -> None:
    received = decode_stream(stream.with_packets([]))
    assert received.loss_mask.num_lost == stream.manifest.num_elements


@pytest.mark.parametrize("order", ["morton", "raster"])
@pytest.mark.parametrize("grouping", ["stratified", "contiguous"])
def test_same_values_under_every_packetization(scene: AnchorScene, order: str, grouping: str) -> None:
    packetization = Packetization(block_size=150, lanes=3, order=order, grouping=grouping)
    decoded = decode_stream(encode_scene(scene, packetization)).scene.anchors
    expected = scene_in_order(scene, order).anchors
    assert np.array_equal(decoded.positions, expected.positions)
    assert np.array_equal(decoded.mask, expected.mask)


def test_anchors_that_draw_nothing_are_not_sent() -> None:
    scene = tiny_scene(seed=9, num_anchors=60)
    mask = scene.anchors.mask.copy()
    mask[10:20] = False
    assert encode_scene(replace(scene, anchors=replace(scene.anchors, mask=mask))).manifest.num_elements == 50


def test_encoding_is_repeatable_and_order_of_input_does_not_matter(scene: AnchorScene, stream: SceneStream) -> None:
    assert stream_to_bytes(encode_scene(scene, PACKETIZATION)) == stream_to_bytes(stream)


def test_full_size_model_round_trips() -> None:
    scene = tiny_scene(seed=1, num_anchors=150, config=HacppConfig())
    received = decode_stream(encode_scene(scene))
    assert np.array_equal(received.scene.anchors.mask, scene_in_order(scene, "morton").anchors.mask)


def test_desynchronised_decoder_is_detected(stream: SceneStream) -> None:
    with pytest.raises(DesyncError):
        decode_stream(replace(stream, manifest=replace(stream.manifest, symbols_digest="0" * 64)))


def test_missing_side_information_is_refused(stream: SceneStream) -> None:
    with pytest.raises(MissingSideInfoError):
        decode_stream(replace(stream, side_info=b""))


def test_manifest_and_side_information_must_agree(stream: SceneStream) -> None:
    manifest = replace(stream.manifest, num_offsets=9)
    with pytest.raises(BitstreamError, match="disagree"):
        decode_stream(replace(stream, manifest=manifest))


def test_side_information_parts_add_up(stream: SceneStream) -> None:
    assert sum(side_info_parts(stream.side_info, stream.manifest.schema_name).values()) == len(stream.side_info)


def test_unusable_scenes_are_refused(scene: AnchorScene) -> None:
    empty = replace(scene, anchors=replace(scene.anchors, mask=np.zeros_like(scene.anchors.mask)))
    with pytest.raises(InvalidValueError, match="nothing to encode"):
        encode_scene(empty)


@pytest.mark.parametrize("scene", [tiny_scene(num_anchors=20), tiny_causal_scene(num_anchors=20)])
def test_scenes_that_span_too_many_voxels_are_refused(scene: AnchorScene) -> None:
    positions = scene.anchors.positions.copy()
    positions[:2, 0] = np.array([-1, 1]) * ((1 << 20) + 1) * np.float32(scene.coding.voxel_size)
    far = replace(scene, anchors=replace(scene.anchors, positions=positions))
    with pytest.raises(InvalidValueError, match="more than 2,097,152"):
        encode_scene(far)


@pytest.mark.slow
def test_damaged_side_information_is_an_error_or_another_scene(stream: SceneStream) -> None:
    rng = np.random.default_rng(0)
    for _ in range(150):
        data = bytearray(stream.side_info)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        if rng.random() < 0.3:
            del data[rng.integers(len(data)) :]
        try:
            received = decode_stream(replace(stream, side_info=bytes(data)))
        except SplatwireError:
            continue
        assert received.scene.anchors.num_anchors == stream.manifest.num_elements


@pytest.mark.slow
def test_damaged_payloads_decode_without_an_error(stream: SceneStream) -> None:
    # checksums detect this before the codec, which must survive it as well
    rng = np.random.default_rng(1)
    for _ in range(100):
        packets = [make_packet(p.id, p.num_elements, rng.bytes(int(rng.integers(0, 60)))) for p in stream.packets[:4]]
        assert decode_stream(stream.with_packets(packets)).loss_mask.num_lost > 0


FRESH = """
import sys, hashlib
from pathlib import Path
from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
digest = hashlib.sha256()
for path in sys.argv[1:]:
    scene = decode_stream(read_stream(Path(path))[0]).scene
    for name in ("positions", "features", "scalings", "offsets", "mask"):
        digest.update(getattr(scene.anchors, name).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "environment",
    [
        pytest.param({"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}, id="one thread"),
        pytest.param(
            {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Nehalem"}, id="no AVX", marks=pytest.mark.extended
        ),
    ],
)
def test_fresh_process_decodes_the_same_integers(
    stream: SceneStream, tmp_path: Path, environment: dict[str, str]
) -> None:
    path = tmp_path / "scene.swz"
    write_stream(stream, path)
    digest = hashlib.sha256()
    for one in (stream, read_stream(GOLDEN_CAUSAL)[0]):
        for tensor in attributes_of(decode_stream(one).scene):
            digest.update(tensor.tobytes())
    command = [sys.executable, "-W", "ignore", "-c", FRESH, str(path), str(GOLDEN_CAUSAL)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=600, env={**os.environ, **environment}, check=False
    )
    assert done.stdout.strip() == digest.hexdigest(), done.stderr


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (GOLDEN, "7c58b34cbd54463bef72e1970211b9337e8ef4aedbfa04f548841fb0cc51433b"),
        (GOLDEN_CAUSAL, "1a48c385918ed8deaaad99a393b208c173a9dc1e6a296b52c5bec33d120528bd"),
    ],
    ids=["hacpp", "causal"],
)
def test_golden_streams_decode_to_pinned_values(path: Path, expected: str) -> None:
    # streams of format versions 1 and 2; other values mean that old streams can no longer be decoded
    stream, report = read_stream(path)
    digest = hashlib.sha256()
    for tensor in attributes_of(decode_stream(stream).scene):
        digest.update(tensor.tobytes())
    assert report.complete
    assert digest.hexdigest() == expected


def test_schemas_name_the_type_of_their_scenes():
    """By this name the encoder chooses the schemas that it imports."""
    for name, stream in SCHEMAS.registered().items():
        if stream.codec_path:
            kind = schema_named(name).scene_type
            assert stream.scene_path == f"{kind.__module__}:{kind.__qualname__}"
