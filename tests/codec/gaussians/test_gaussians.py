from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from close import assert_close, unit
from explicit import decode_splats, encode_splats
from random_numbers import Numbers
from reference.gaussian_packets import ReferencePacket
from splatwire.bitstream import HEADER_BYTES, PRESETS, Packetization, SceneStream, assign_packets, make_packet
from splatwire.bitstream.limits import FREE_ELEMENTS, MAX_BLOCK_SIZE
from splatwire.bitstream.packet import Packet
from splatwire.codec.gaussians.attributes import log2_scene_size, to_sources
from splatwire.codec.gaussians.decoder import decode_packets, open_side_info
from splatwire.codec.gaussians.quality import QUALITIES, Quality, quality_of
from splatwire.codec.gaussians.side_info import read_side_info, write_side_info
from splatwire.errors import BitstreamError, DesyncError, InvalidValueError, MissingSideInfoError, UnknownNameError
from splatwire.ops.quaternions import rotation_matrices
from splatwire.types.splats import Splats

SMALL = Packetization(block_size=200, lanes=3)
DATAGRAM = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=400)


def some_splats(count: int = 500, degree: int = 1, seed: int = 0) -> Splats:
    rng = Numbers(seed)
    directions = unit(rng.randn(count, 3))
    means = directions * (1 + 0.02 * rng.randn(count, 1)) + np.array([3.0, -7.0, 0.5], np.float32)
    quats = rng.randn(count, 4)
    scales = np.exp(rng.randn(count, 3) * 0.8 - 4)
    opacities = rng.rand(count) * 0.98 + 0.01
    sh = rng.randn(count, (degree + 1) ** 2, 3) * 0.15
    sh[:, 0] += means * 0.3
    return Splats(means, unit(quats), scales, opacities, sh)


@pytest.fixture(scope="module", params=["fixed", "datagram"])
def stream(request: pytest.FixtureRequest) -> SceneStream:
    return encode_splats(some_splats(), SMALL if request.param == "fixed" else DATAGRAM, quality=Quality(11.0))


def integers(stream: SceneStream, block: int, packets: list[Packet | None], sizes: list[int]) -> np.ndarray:
    info = open_side_info(stream.manifest, stream.side_info)
    rows, harmonics = decode_packets(info, block, np.array(sizes), [packet.payload for packet in packets])
    return np.concatenate([rows, harmonics], axis=1)


def partners(splats: Splats, decoded: Splats) -> Splats:
    """Index of the source Gaussian nearest to each decoded one; checks that each source is used once."""
    index = cdist(decoded.means.astype(np.float64), splats.means.astype(np.float64)).argmin(axis=1)
    assert len(np.unique(index)) == splats.num_gaussians
    return splats.select(index)


def covariances(splats: Splats) -> np.ndarray:
    m = rotation_matrices(splats.quats) * splats.scales[:, None]
    return m @ m.swapaxes(1, 2)


def test_decoded_gaussians_are_within_quantisation_steps(stream: SceneStream) -> None:
    decoded, known = decode_splats(stream)
    source = partners(some_splats(), decoded)
    assert known.all()
    assert float(np.abs(source.means - decoded.means).max()) < 1e-3
    assert float(np.abs(np.log2(source.opacities) - np.log2(decoded.opacities)).max()) <= 2.0**-6 + 2.0**-10
    assert float(np.abs(source.sh[:, 0] - decoded.sh[:, 0]).max()) < 0.01
    assert float(np.abs(source.sh[:, 1:] - decoded.sh[:, 1:]).max()) < 0.01
    ours, theirs = covariances(decoded), covariances(source)
    error = np.linalg.norm((ours - theirs).reshape(len(ours), -1), axis=1) / np.linalg.norm(
        theirs.reshape(len(theirs), -1), axis=1
    )
    assert float(error.max()) < 0.05
    assert_close(np.linalg.norm(decoded.quats, axis=1), np.ones(len(known), np.float32))


def test_finer_quality_has_smaller_error_and_more_bytes() -> None:
    sizes, errors = [], []
    for level in (6.0, 8.0, 10.0):
        stream = encode_splats(some_splats(degree=0), SMALL, quality=Quality(level))
        decoded = decode_splats(stream)[0]
        index = cdist(decoded.means.astype(np.float64), some_splats(degree=0).means.astype(np.float64)).argmin(axis=1)
        sizes.append(stream.num_bytes)
        errors.append(float(np.linalg.norm(some_splats(degree=0).means[index] - decoded.means)))
    assert sizes == sorted(sizes)
    assert errors == sorted(errors, reverse=True)


def test_coarser_precision_classes_cost_fewer_bytes() -> None:
    splats = some_splats()
    coarse = encode_splats(splats, SMALL, class_offsets=np.full(500, -3))
    assert coarse.num_bytes < 0.8 * encode_splats(splats, SMALL, class_offsets=np.zeros(500, int)).num_bytes


def test_packets_decode_to_the_same_integers_alone_and_together(stream: SceneStream) -> None:
    groups, packets = assign_packets(stream.manifest.plan, stream.packets)
    sizes = np.diff(groups.starts).tolist()
    for block in range(stream.manifest.plan.num_blocks):
        here = [i for i, packet in enumerate(packets) if packet is not None and packet.id.block == block]
        together = integers(stream, block, [packets[i] for i in here], [sizes[i] for i in here])
        alone = [integers(stream, block, [packets[i]], [sizes[i]]) for i in here]
        np.testing.assert_array_equal(together, np.concatenate(alone))


def test_plain_python_decodes_the_same_integers(stream: SceneStream) -> None:
    info = open_side_info(stream.manifest, stream.side_info)
    for packet in stream.packets[:2]:
        found = ReferencePacket(info, packet.id.block, packet.payload, packet.num_elements).decode()
        fast = integers(stream, packet.id.block, [packet], [packet.num_elements])
        np.testing.assert_array_equal(fast, [g.row() + g.harmonics for g in found])


@settings(max_examples=60, deadline=None)
@given(payload=st.binary(max_size=400), count=st.integers(1, 120))
def test_plain_python_and_kernels_agree_on_any_bytes(fuzzed: SceneStream, payload: bytes, count: int) -> None:
    info = open_side_info(fuzzed.manifest, fuzzed.side_info)
    packet = make_packet(fuzzed.packets[0].id, count, payload)
    found = ReferencePacket(info, 0, payload, min(count, 12)).decode()
    fast = integers(fuzzed, 0, [packet], [min(count, 12)])
    np.testing.assert_array_equal(fast, [g.row() + g.harmonics for g in found])
    assert integers(fuzzed, 0, [packet], [count]).shape == (count, 17 + info.num_harmonic_columns)


@pytest.fixture(scope="module")
def fuzzed() -> SceneStream:
    return encode_splats(some_splats(degree=2), DATAGRAM)


@pytest.mark.parametrize("seed", range(30))
def test_any_payload_decodes_to_finite_gaussians(fuzzed: SceneStream, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lies = [
        make_packet(p.id, p.num_elements, rng.bytes(int(rng.integers(0, 300))), fuzzed.manifest.stream_id)
        for p in fuzzed.packets[: len(fuzzed.packets) - 1]
    ]
    decoded, _ = decode_splats(fuzzed.with_packets(lies))
    for values in vars(decoded).values():
        assert bool(np.isfinite(values).all())
    assert float(decoded.scales.min()) > 0
    assert float(decoded.opacities.min()) >= 0
    assert float(decoded.opacities.max()) < 1


@pytest.mark.parametrize("seed", range(200))
def test_damaged_side_information_is_an_error_or_decodes(fuzzed: SceneStream, seed: int) -> None:
    rng, data = np.random.default_rng(seed), bytearray(fuzzed.side_info)
    for _ in range(int(rng.integers(1, 4))):
        data[rng.integers(len(data) if seed % 2 else 60)] = rng.integers(256)
    if seed % 5 == 0:
        del data[rng.integers(len(data)) :]
    try:
        decoded, _ = decode_splats(replace(fuzzed, side_info=bytes(data), packets=fuzzed.packets[:3]))
    except BitstreamError:
        return
    for values in vars(decoded).values():
        assert bool(np.isfinite(values).all())


def test_lost_gaussians_are_placed_among_neighbours_and_transparent() -> None:
    stream = encode_splats(some_splats(), SMALL)
    whole = decode_splats(stream)[0]
    part, known = decode_splats(stream.with_packets(stream.packets[1:6:2]))
    assert 0 < known.sum() < len(known)
    for name, values in vars(part).items():
        assert_close(values[known], getattr(whole, name)[known], rtol=0, atol=0)
    lost = part.select(~known)
    assert float(lost.opacities.max()) == 0
    assert bool((lost.quats == np.array([1.0, 0.0, 0.0, 0.0], np.float32)).all())
    assert float(np.linalg.norm(lost.means - whole.means.mean(axis=0), axis=1).max()) < 1.5
    assert float(np.abs(np.log2(lost.scales).mean() - np.log2(whole.scales).mean())) < 0.5


def test_stream_without_packets_has_positions_inside_block_bounds() -> None:
    stream = encode_splats(some_splats(), SMALL)
    part, known = decode_splats(stream.with_packets([]))
    whole = decode_splats(stream)[0]
    assert not known.any()
    low, high = whole.means.min(axis=0) - 0.1, whole.means.max(axis=0) + 0.1
    assert bool(((part.means >= low) & (part.means <= high)).all())
    assert len(np.unique(part.means, axis=0)) == 500


def test_side_information_round_trips(stream: SceneStream) -> None:
    num_blocks = stream.manifest.plan.num_blocks
    assert write_side_info(read_side_info(stream.side_info, num_blocks)) == stream.side_info
    with pytest.raises(BitstreamError):
        read_side_info(stream.side_info, num_blocks + 1)


def test_tiers_have_blocks_of_their_own() -> None:
    tiers = (np.arange(500) % 5 > 0).astype(np.uint8)
    splats = replace(some_splats(), opacities=np.where(tiers == 0, 0.9, 0.1))
    stream = encode_splats(splats, SMALL, tiers=tiers)
    important = [p for p in stream.packets if stream.manifest.plan.tier_of(p.id.block) == 0]
    decoded, known = decode_splats(stream.with_packets(important))
    assert int(known.sum()) == 100
    assert float(decoded.opacities[known].min()) > 0.5
    assert float(decode_splats(stream)[0].opacities[~known].max()) < 0.5


def test_stream_does_not_depend_on_the_number_of_threads() -> None:
    one, two = (encode_splats(some_splats(), DATAGRAM, threads=threads) for threads in (1, 2))
    assert one == two


def test_datagrams_are_filled_to_their_limit() -> None:
    stream = encode_splats(some_splats(), DATAGRAM)
    sizes = [p.num_bytes for p in stream.packets]
    last = {p.id.block: p.num_bytes for p in stream.packets}
    assert max(sizes) <= 400
    full = [p.num_bytes for p in stream.packets if p.num_bytes != last[p.id.block]]
    assert min(full) >= HEADER_BYTES + (400 - HEADER_BYTES) * 7 // 8


def test_forged_symbol_fails_the_digest(stream: SceneStream) -> None:
    first = stream.packets[0]
    payload = bytes([first.payload[0] ^ 64]) + first.payload[1:]
    forged = make_packet(first.id, first.num_elements, payload, stream.manifest.stream_id)
    with pytest.raises(DesyncError):
        decode_splats(stream.with_packets([forged, *stream.packets[1:]]))


def test_unencodable_gaussians_are_refused() -> None:
    splats = some_splats(20, 0)
    with pytest.raises(InvalidValueError):
        encode_splats(splats.select(np.zeros(0, np.int64)), SMALL)
    with pytest.raises(InvalidValueError):
        encode_splats(splats, PRESETS["hacpp"])
    with pytest.raises(InvalidValueError):
        encode_splats(splats, SMALL, class_offsets=np.zeros(19))
    with pytest.raises(InvalidValueError):
        Quality(classes=9)
    with pytest.raises(UnknownNameError):
        quality_of("best")


def test_missing_side_information_is_reported(stream: SceneStream) -> None:
    with pytest.raises(MissingSideInfoError):
        decode_splats(replace(stream, side_info=b""))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_few_gaussians_and_equal_positions_are_encoded(count: int) -> None:
    splats = some_splats(count, 3)
    splats = replace(splats, means=np.repeat(splats.means[:1], count, axis=0))
    decoded, known = decode_splats(encode_splats(splats, PRESETS["datagram"], quality=QUALITIES["near-lossless"]))
    assert known.all()
    assert_close(decoded.means, splats.means, rtol=1e-3, atol=1e-3)


def test_axes_are_sorted_by_scale() -> None:
    splats = some_splats(40)
    sources = to_sources(splats, log2_scene_size(splats))
    assert (np.diff(sources.logs[:, 1:], axis=1) <= 0).all()
    scales = 2.0 ** (sources.logs[:, 1:] / 4096 + log2_scene_size(splats))
    rebuilt = np.einsum("nij,nj,nkj->nik", sources.axes, scales**2, sources.axes)
    np.testing.assert_allclose(rebuilt, covariances(splats), rtol=1e-2, atol=1e-6)


def test_element_count_is_limited_by_side_information() -> None:
    """Tests the largest allowed count and one more; allowed counts still need bounds in the side information."""
    stream = encode_splats(some_splats(20), SMALL)
    manifest, size = stream.manifest, len(stream.side_info)
    most = FREE_ELEMENTS + MAX_BLOCK_SIZE // 7 * size
    large = replace(SMALL, block_size=MAX_BLOCK_SIZE, lanes=1)
    blocks = -(-most // MAX_BLOCK_SIZE)
    said = replace(manifest, packetization=large, num_elements=most, num_packets=blocks)
    with pytest.raises(InvalidValueError, match="cannot place"):
        replace(said, num_elements=most + 1)
    with pytest.raises(BitstreamError, match=f"cannot hold {blocks} boxes"):
        decode_splats(SceneStream(said, stream.side_info, ()))
