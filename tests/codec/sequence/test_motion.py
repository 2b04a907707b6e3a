"""Motion packets: fast kernels against plain Python, laws of bit planes, and pinned bytes."""

from fractions import Fraction

import numpy as np
import pytest

from moving_sequences import moving_frames
from reference.motion_packets import ReferenceMotion, coefficients
from reference.neighbours import plain_interpolation, plain_smooth_weights
from reference.trajectories import offsets_at
from reference.trajectories import targets_of as plain_targets
from splatwire.bitstream import Packet, SceneStream
from splatwire.codec.sequence.basis import polynomials
from splatwire.codec.sequence.layout import KIND_OF, NUM_CHANNELS, NUM_KINDS, STATE
from splatwire.codec.sequence.motion_rows import coefficients_of, decode_motion
from splatwire.codec.sequence.side_info import SequenceInfo, open_side_info
from splatwire.codec.sequence.trajectories import (
    MotionCoefficients,
    MotionEvaluator,
    PacketMotion,
    Trajectories,
    add_frames,
)
from splatwire.concealment.temporal.neighbors import Neighbors, smooth_weights
from splatwire.sequence import SequenceOptions, encode_sequence

FRAMES, GROUP = 10, 5


def targets_of(moves, bases, numbers, lattice_bits: int, size_log: int) -> MotionCoefficients:
    """Coefficients of motion, fitted to all frames at once."""
    found = MotionCoefficients.zero(len(numbers), moves.num_frames)
    add_frames(found, moves, bases, numbers, 0, moves.num_frames, lattice_bits, size_log)
    return found


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_sequence(moving_frames(500, FRAMES), SequenceOptions(Fraction(30), GROUP))[0]


@pytest.fixture(scope="module")
def info(stream: SceneStream) -> SequenceInfo:
    return open_side_info(stream.manifest, stream.side_info)


def motion_packets(stream: SceneStream, group: int) -> list[Packet]:
    plan = stream.manifest.plan
    return [p for p in stream.packets if plan.tier_of(p.id.block) == 2 * group + 1]


@pytest.mark.parametrize("group", [0, 1])
def test_motion_packets_decode_as_in_the_reference(stream, info, group):
    first_new = 0 if group == 0 else info.groups[0].num_births
    packets = motion_packets(stream, group)
    assert packets
    for packet in packets:
        counts = np.array([packet.num_elements])
        heads, residuals, num_coefficients = decode_motion(info, group, counts, [packet.payload], first_new)
        plain = ReferenceMotion(
            packet.payload, info.zero_probabilities.tolist(), packet.num_elements, GROUP, first_new
        ).decode()
        assert heads.tolist() == plain[0]
        assert residuals.reshape(-1, NUM_CHANNELS, GROUP).tolist() == plain[1]
        behind = np.arange(GROUP) >= num_coefficients[0][KIND_OF][:, None]
        assert not residuals.reshape(-1, NUM_CHANNELS, GROUP)[:, behind].any()


@pytest.mark.parametrize("seed", range(20))
def test_altered_motion_packets_decode_as_in_the_reference(stream, info, seed):
    rng, packet = np.random.default_rng(seed), motion_packets(stream, 0)[0]
    payload = bytearray(packet.payload)
    for place in rng.integers(0, len(payload), 3):
        payload[place] = rng.integers(0, 256)
    altered = bytes(payload)
    heads, residuals, _ = decode_motion(info, 0, np.array([packet.num_elements]), [altered], 0)
    plain = ReferenceMotion(altered, info.zero_probabilities.tolist(), packet.num_elements, GROUP, 0).decode()
    found = len(plain[0])
    assert heads[:found].tolist() == plain[0]
    assert (heads[found:] == -1).all()
    assert residuals[:found].reshape(-1, NUM_CHANNELS, GROUP).tolist() == plain[1]


def test_offsets_equal_the_numpy_reference():
    rng, frames = np.random.default_rng(4), 7
    packets = []
    for count, width in ((9, 4), (0, 3), (5, 7)):
        num_coefficients = rng.integers(0, width + 1, NUM_KINDS)
        values = rng.normal(0, 5000, (count, NUM_CHANNELS, width)).astype(np.float32)
        values[:, np.arange(width) >= num_coefficients[KIND_OF][:, None]] = 0
        packets.append(PacketMotion(values, num_coefficients))
    rows = rng.permutation(np.concatenate([np.arange(14), [-1, -1]]))
    at = MotionEvaluator(packets, frames, 24, 3).of(rows)
    for frame in range(frames):
        plain = [offsets_at(packet.coefficients, frames, frame, 24, 3) for packet in packets]
        wanted = np.concatenate([*plain, np.zeros((1, NUM_CHANNELS))])[rows]
        np.testing.assert_allclose(at(frame), wanted, rtol=2e-6, atol=1e-9)


@pytest.mark.parametrize(("seed", "size"), [(0, 1 << 12), (1, 1 << 26), (2, 3), (3, 1 << 20)])
def test_neighbour_prediction_equals_the_reference(seed, size):
    rng, count = np.random.default_rng(seed), 60
    heads = np.zeros((count, 6), np.int64)
    heads[:, STATE] = rng.random(count) < 0.8
    places = rng.integers(-size, size, (count, 3))
    shifts = rng.integers(0, 12, (count, NUM_CHANNELS))
    residuals = rng.integers(-40, 40, (count, NUM_CHANNELS, 4)).astype(np.int32)
    residuals[rng.random(residuals.shape) < 0.5] = 0
    residuals[heads[:, STATE] == 0] = 0
    fast = coefficients_of(heads, residuals.reshape(count, -1), np.full(NUM_KINDS, 4), places, shifts)
    plain = coefficients(places.tolist(), heads[:, STATE].tolist(), shifts.tolist(), residuals.tolist())
    assert fast.tolist() == [own for own, state in zip(plain, heads[:, STATE], strict=True) if state]


@pytest.mark.parametrize("frames", [1, 2, 15, 64])
def test_polynomials_are_orthonormal_and_rise_in_degree(frames):
    table = polynomials(frames)
    assert np.allclose(table.T @ table, np.eye(frames), atol=1e-9)
    time = np.arange(frames, dtype=np.float64)
    for degree in range(min(frames, 4)):
        assert np.allclose(table[:, degree + 1 :].T @ time**degree, 0, atol=1e-6 * frames**degree)


def test_trajectories_are_restored_from_coefficients():
    frames = moving_frames(200, 6)
    stacked = {name: np.stack([getattr(f, name) for f in frames], axis=1) for name in ("means", "quats", "scales")}
    opacities = np.full((200, 6), 0.5, np.float32)
    moves = Trajectories(**stacked, opacities=opacities, colours=np.stack([f.sh[:, 0] for f in frames], axis=1))
    here = np.arange(200)
    targets = targets_of(moves, moves.at(here, np.zeros(200, np.int64)), here, 30, 0)
    offsets = np.stack([offsets_at(np.rint(targets.coefficients), 6, frame, 30, 0) for frame in range(6)], axis=2)
    assert targets.largest_rotation.max() < 1e-12
    assert np.allclose(offsets[:, :3], (moves.means - moves.means[:, :1]).swapaxes(1, 2), atol=1e-6)
    assert np.allclose(offsets[:, 10:], (moves.colours - moves.colours[:, :1]).swapaxes(1, 2), atol=1e-2)
    assert np.abs(offsets[:, 3:10]).max() < 1e-3


def random_tracks(frames: int) -> tuple[Trajectories, np.ndarray, Trajectories]:
    """Tracks, some of them fully or partly static, with keyframe Gaussians and the integers that encode these."""
    rng = np.random.default_rng(frames)
    shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "colours": (3,)}
    moves = {name: rng.normal(size=(300, frames, *shape)).astype(np.float32) for name, shape in shapes.items()}
    moves |= {name: np.exp(moves[name]) for name in ("scales", "opacities")}
    for name, values in moves.items():  # some are fully static, some in one channel
        values[:40] = values[:40, :1]
        if name != "quats":
            values[40:60] = values[40:60, :1]
    moves["scales"][60:90, :, 1] = moves["scales"][60:90, :, 0]
    numbers, tracks = rng.permutation(300), Trajectories(**moves)
    return tracks, numbers, tracks.at(np.argsort(numbers), np.zeros(300, np.int64))


@pytest.mark.parametrize("frames", [1, 6])
def test_coefficients_equal_the_reference(frames):
    tracks, numbers, bases = random_tracks(frames)
    fast = targets_of(tracks, bases, numbers, 30, 2)
    coefficients, turns = plain_targets(tracks, bases.select(numbers), 30, 2)
    assert np.allclose(fast.coefficients, coefficients, rtol=1e-9, atol=1e-9 * np.abs(coefficients).max() + 1e-9)
    assert np.array_equal(fast.largest, np.abs(fast.coefficients).max(axis=2))
    assert np.allclose(fast.largest_rotation, turns, rtol=1e-6)
    assert not fast.coefficients[:40].any()


def test_incremental_fit_is_bit_identical():
    tracks, numbers, bases = random_tracks(6)
    whole, found = targets_of(tracks, bases, numbers, 30, 2), MotionCoefficients.zero(300, 6)
    for begin, end in ((0, 3), (3, 4), (4, 6)):
        add_frames(found, tracks, bases, numbers, begin, end, 30, 2)
    for name, values in vars(whole).items():
        assert np.array_equal(getattr(found, name), values), name


def test_smoothing_weights_preserve_linear_motion_and_reduce_curvature():
    rng = np.random.default_rng(0)
    offsets = rng.normal(size=(50, 40, 3)) + 0.3
    weights = smooth_weights(offsets).astype(np.float64)
    assert np.allclose(weights.sum(axis=1), 1, atol=1e-5)
    slope, bend = rng.normal(size=3), rng.normal(size=(3, 3))
    assert np.allclose((weights * (offsets @ slope)).sum(axis=1), 0, atol=0.05)
    bent = np.einsum("nka,ab,nkb->nk", offsets, bend, offsets)
    assert np.linalg.norm((weights * bent).sum(axis=1)) < 0.2 * np.linalg.norm(bent.mean(axis=1))


def test_smoothing_weights_equal_those_of_the_normal_equations():
    rng = np.random.default_rng(2)
    offsets = rng.normal(size=(200, 40, 3)) * rng.uniform(0.01, 10, (200, 1, 1)) + rng.normal(size=(200, 1, 3))
    offsets[100:] -= 40 * rng.normal(size=(100, 1, 3))  # extrapolation, which falls back to inverse distances
    expected = plain_smooth_weights(offsets)
    assert np.allclose(smooth_weights(offsets), expected, atol=1e-5)
    assert 0 < (expected > 0).all(axis=1).sum() < 200  # both kinds


@pytest.mark.parametrize("zero", [slice(0), slice(6, 10), slice(10, 13), slice(6, 13)])
def test_interpolation_equals_weighted_sums(zero):
    rng = np.random.default_rng(3)
    places, colours = rng.uniform(size=(400, 3)).astype(np.float32), rng.normal(size=(400, 3)).astype(np.float32)
    observed, values = np.arange(300), rng.normal(size=(300, NUM_CHANNELS)).astype(np.float32)
    values[:, zero] = 0
    neighbors = Neighbors.of(places, colours, observed, observed, np.arange(300, 400), 40, smooth=True)
    assert np.allclose(neighbors.interpolate(values), plain_interpolation(neighbors, values), atol=1e-5)


def test_colour_changes_are_predicted_from_similar_colours():
    rng = np.random.default_rng(1)
    places, colours = rng.uniform(size=(400, 3)).astype(np.float32), rng.normal(size=(400, 3)).astype(np.float32)
    observed, lost_tracks = np.arange(300), np.arange(300, 400)
    neighbors = Neighbors.of(places, colours, observed, observed, lost_tracks, 40, smooth=True)
    values = np.zeros((300, NUM_CHANNELS), np.float32)
    values[:, 10:] = 0.2 * colours[:300]
    error = np.abs(neighbors.interpolate(values)[:, 10:] - 0.2 * colours[300:])
    assert error.max() < 0.1 * 0.2 * np.abs(colours[300:]).max()
