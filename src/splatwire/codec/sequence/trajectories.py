"""Converts trajectories of Gaussians to motion coefficients, and coefficients to offsets from keyframe Gaussians."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.codec.gaussians.attributes import LUMA_CHROMA
from splatwire.codec.gaussians.layout import BITS, DIRECTION_BITS
from splatwire.codec.sequence import _offset_kernels, _target_kernels
from splatwire.codec.sequence.basis import polynomials
from splatwire.codec.sequence.layout import KIND_OF, NUM_CHANNELS
from splatwire.codec.threads import ordered_map
from splatwire.ops.spherical_harmonics import DC
from splatwire.ops.threads import parallel_map

# Divides coded rotation vectors of length 4 tan(angle / 4). `_target_kernels` has four times this value, because it
# multiplies vectors of length tan(angle / 4).
_ROTATION_UNITS = float(1 << DIRECTION_BITS)
_FIXED_POINT_ONE = float(1 << BITS)
FIT_BATCH = 2048
"""Number of tracks to which a thread fits coefficients at a time."""
OFFSET_BATCH = 8192
"""Number of tracks of which a thread computes offsets at a time."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Trajectories of n tracks (Gaussians that persist over frames) over the F frames of a group.

    Attributes:
        means: Positions, float32 (n, F, 3).
        quats: Rotations as unit quaternions (w, x, y, z), float32 (n, F, 4).
        scales: Scales, float32 (n, F, 3).
        opacities: Opacities, float32 (n, F).
        colours: Spherical harmonics of degree 0, float32 (n, F, 3).
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colours: np.ndarray

    @property
    def num_frames(self) -> int:
        """Number of frames, F."""
        return int(self.means.shape[1])

    def select(self, index: np.ndarray | slice) -> "Trajectories":
        """Returns the trajectories of the selected tracks."""
        return replace(self, **{name: values[index] for name, values in vars(self).items()})

    def at(self, index: np.ndarray, frame: np.ndarray) -> "Trajectories":
        """Returns the state of some tracks (Gaussians over time) at one frame each.

        Args:
            index: Indices of the tracks, int64 (m).
            frame: Frame of each of these tracks, relative to the group, int64 (m).
        """
        return replace(self, **{name: values[index, frame][:, None] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class MotionCoefficients:
    """Motion of n tracks relative to their keyframe Gaussians, as polynomials over time before quantisation.

    Attributes:
        coefficients: Coefficients by channel of motion and degree of the polynomial, float64 (n, channels, frames), in
            the units that `layout.CHANNELS` lists.
        largest: Largest magnitude of each channel's coefficients, float64 (n, channels).
        largest_rotation: Largest rotation of each track, as the tangent of a quarter of its angle, float64 (n).
        last_rotation: Rotation of each track in the last frame added, as a unit quaternion, float64 (n, 4).
    """

    coefficients: np.ndarray
    largest: np.ndarray
    largest_rotation: np.ndarray
    last_rotation: np.ndarray

    @staticmethod
    def zero(count: int, num_frames: int) -> "MotionCoefficients":
        """Returns `MotionCoefficients` for tracks that do not move: all motion coefficients are 0.

        Args:
            count: Number of tracks, n.
            num_frames: Number of frames of the group, F.
        """
        values, last_rotation = np.zeros((count, NUM_CHANNELS, num_frames)), np.zeros((count, 4))
        last_rotation[:, 0] = 1
        return MotionCoefficients(values, np.zeros((count, NUM_CHANNELS)), np.zeros(count), last_rotation)

    def select(self, index: np.ndarray | slice) -> "MotionCoefficients":
        """Returns the coefficients of the tracks at `index`."""
        return MotionCoefficients(**{name: values[index] for name, values in vars(self).items()})

    def put(self, index: np.ndarray, others: "MotionCoefficients") -> None:
        """Replaces the motion coefficients of the tracks at `index` by `others`."""
        for name, values in vars(self).items():
            values[index] = getattr(others, name)

    def rescale_positions(self, index: np.ndarray, octaves: int) -> None:
        """Multiplies the position coefficients of the tracks at `index` by `2 ** octaves`, in place."""
        for values in (self.coefficients, self.largest):
            values[index, :3] = np.ldexp(values[index, :3], octaves)


def add_frames(
    motion: MotionCoefficients, trajectories: Trajectories, keyframes: Trajectories, keyframe_indices: np.ndarray,
    begin: int, end: int, lattice_bits: int, size_log: int, threads: int | None = None,
) -> None:  # fmt: skip
    """Adds further frames to the polynomials that are fitted to the motion of tracks (Gaussians over time).

    Args:
        motion: Polynomial coefficients of n tracks, changed in place.
        trajectories: Trajectories of the n tracks over all F frames of the group; frames from `end` on are ignored.
        keyframes: Keyframe Gaussians, as trajectories of one frame.
        keyframe_indices: Index in `keyframes` of the keyframe Gaussian of each track, int64 (n); tracks with a negative
            index are skipped.
        begin: First frame to add.
        end: End of the frames to add (exclusive).
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        size_log: log2 of the scene size in world units.
        threads: Number of threads; None for one per processor.
    """
    to_luma_chroma = np.ascontiguousarray(LUMA_CHROMA * (DC * _FIXED_POINT_ONE))
    basis = polynomials(trajectories.num_frames).copy()
    keyframe_arrays, world_to_units = tuple(vars(keyframes).values()), float(np.ldexp(1.0, lattice_bits + 1 - size_log))

    def fit(rows: slice) -> None:
        _target_kernels.fit_motion(
            tuple(values[rows] for values in vars(trajectories).values()), keyframe_arrays, keyframe_indices[rows],
            world_to_units, to_luma_chroma, basis, np.int64(begin), np.int64(end),
            *(values[rows] for values in vars(motion).values()),
        )  # fmt: skip

    batches = [slice(first, first + FIT_BATCH) for first in range(0, len(keyframe_indices), FIT_BATCH)]
    for _ in ordered_map(fit, batches, threads if len(batches) > 1 else 1):
        pass


@dataclass(frozen=True, eq=False)
class PacketMotion:
    """Decoded motion of the m moving tracks (Gaussians over time) of a packet, as polynomials over time.

    Attributes:
        coefficients: Polynomial coefficients, float32 (m, channels, K). Coefficients that the packet does not contain
            are 0.
        num_coefficients: For each kind of channel (position, rotation, scale, opacity, colour), number of coefficients
            that the packet contains per channel, int64 (kinds).
    """

    coefficients: np.ndarray
    num_coefficients: np.ndarray

    @property
    def nbytes(self) -> int:
        """Memory size of the coefficients, bytes."""
        return self.coefficients.nbytes


@dataclass(frozen=True, eq=False)
class MotionEvaluator:
    """Decoded motion of a group's tracks (Gaussians over time), which can be evaluated in any frame.

    Attributes:
        packets: Motion polynomials of the moving tracks of each packet.
        num_frames: Number of frames in the group.
        lattice_bits: Resolution of positions: the spacing of their lattice is `2**-lattice_bits` times the scene
            size.
        size_log: log2 of the scene size in world units.
    """

    packets: Sequence[PacketMotion]
    num_frames: int
    lattice_bits: int
    size_log: int

    def of(self, rows: np.ndarray) -> Callable[[int], np.ndarray]:
        """Returns a function that evaluates the motion of some tracks in a frame.

        Args:
            rows: Index of each of n tracks in the list of moving tracks of all packets, int64 (n); -1 for a track that
                does not move.

        Returns:
            Function whose argument is the index of a frame in the group. It returns the changes of the tracks relative
            to their keyframe Gaussians, float32 (n, channels): position (world units), rotation (vector along the axis
            of length 4 tan(angle / 4)), natural logarithms of the scales and of opacity, RGB.
        """
        counts = [len(packet.coefficients) for packet in self.packets]
        widths = np.array([packet.coefficients.shape[2] for packet in self.packets], np.int64)
        sizes, packets = NUM_CHANNELS * widths, np.repeat(np.arange(len(counts)), counts)
        row_starts = np.concatenate([[0], np.cumsum(np.repeat(sizes, counts))]).astype(np.int64)
        flat = np.concatenate([np.zeros(0, np.float32), *(packet.coefficients.ravel() for packet in self.packets)])
        num_coefficients = np.array([packet.num_coefficients[KIND_OF] for packet in self.packets], np.int64).reshape(
            -1, NUM_CHANNELS
        )
        starts = np.where(rows < 0, -1, row_starts[rows])
        packet_of_row = np.concatenate([packets, [0]])[rows]  # any packet for still tracks, which have no coefficients
        basis, factors, to_rgb = polynomials(self.num_frames), self._factors(), np.ascontiguousarray(LUMA_CHROMA)

        def at(frame: int) -> np.ndarray:
            offsets, basis_values = np.empty((len(rows), NUM_CHANNELS), np.float32), basis[frame].copy()

            def evaluate_slice(rows: slice) -> None:
                _offset_kernels.offsets(
                    flat, starts[rows], packet_of_row[rows], num_coefficients, widths, basis_values, factors, to_rgb,
                    offsets[rows],
                )  # fmt: skip

            parallel_map(
                evaluate_slice, [slice(begin, begin + OFFSET_BATCH) for begin in range(0, len(rows), OFFSET_BATCH)]
            )
            return offsets

        return at

    def _factors(self) -> np.ndarray:
        """Returns the factors that convert motion from fixed point to floats, by channel, float64 (channels)."""
        factors = np.ones(NUM_CHANNELS)
        factors[:3] = np.ldexp(1.0, self.size_log - self.lattice_bits - 1)
        factors[3:6] = 1 / _ROTATION_UNITS
        factors[6:10] = np.log(2.0) / _FIXED_POINT_ONE
        factors[10:] = 1 / (_FIXED_POINT_ONE * DC)
        return factors
