"""Motion of tracks as coefficients, in plain numpy and torch."""

import numpy as np

from splatwire.codec.gaussians.attributes import LUMA_CHROMA
from splatwire.codec.gaussians.layout import BITS, DIRECTION_BITS
from splatwire.codec.sequence.basis import polynomials
from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.codec.sequence.trajectories import Trajectories
from splatwire.ops.spherical_harmonics import DC

_TURN = float(1 << DIRECTION_BITS)
_FIXED = float(1 << BITS)


def targets_of(
    moves: Trajectories, bases: Trajectories, lattice_bits: int, size_log: int
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the motion of tracks relative to their bases, in units of the channels.

    Args:
        moves: n tracks over F frames.
        bases: Their first frames.
        lattice_bits: `-log2` of the lattice's unit, relative to the scene size.
        size_log: log2 of the scene size.

    Returns:
        float64 (n, C, F); and largest rotation of each, the tangent of a quarter of its angle, float64 (n).
    """
    values = np.empty((len(moves.means), NUM_CHANNELS, moves.num_frames))
    difference = moves.means.astype(np.float64) - bases.means
    values[:, :3] = np.ldexp(difference, lattice_bits + 1 - size_log).swapaxes(1, 2)
    turns = rotation_vectors(moves.quats, bases.quats)
    values[:, 3:6] = (turns * (4 * _TURN)).swapaxes(1, 2)
    falling = np.argsort(-bases.scales[:, 0], axis=1, kind="stable")
    ratios = np.log2(moves.scales.astype(np.float64)) - np.log2(bases.scales.astype(np.float64))
    values[:, 6:9] = np.take_along_axis(ratios, falling[:, None, :], axis=2).swapaxes(1, 2) * _FIXED
    values[:, 9] = (np.log2(moves.opacities.astype(np.float64)) - np.log2(bases.opacities.astype(np.float64))) * _FIXED
    colours = (moves.colours.astype(np.float64) - bases.colours) * DC
    values[:, 10:] = (colours @ LUMA_CHROMA.T * _FIXED).swapaxes(1, 2)
    return values @ polynomials(moves.num_frames), np.linalg.norm(turns, axis=2).max(axis=1, initial=0.0)


def rotation_vectors(quats: np.ndarray, bases: np.ndarray) -> np.ndarray:
    """Rotations from bases, as axes times the tangent of a quarter of the angle, float64 (n, F, 3).

    They are continuous over frames: of the two quaternions of a rotation the one nearer to the earlier frame counts.
    Rotations between half a turn and a whole one are therefore represented.

    Args:
        quats: (n, F, 4).
        bases: (n, 1, 4).
    """
    q, b = np.asarray(quats, np.float64), np.asarray(bases, np.float64)
    q, b = (values / np.linalg.norm(values, axis=2, keepdims=True) for values in (q, b))
    w = (q * b).sum(axis=2)
    v = b[..., :1] * q[..., 1:] - q[..., :1] * b[..., 1:] - np.cross(q[..., 1:], b[..., 1:])
    turn = np.concatenate([w[..., None], v], axis=2)
    signs = np.ones(turn.shape[:2])
    signs[:, 0] = np.where(w[:, 0] < 0, -1.0, 1.0)
    steps = (turn[:, 1:] * turn[:, :-1]).sum(axis=2)
    signs[:, 1:] = np.where(steps < 0, -1.0, 1.0)
    turn = turn * signs.cumprod(axis=1)[..., None]
    return turn[..., 1:] / np.maximum(1 + turn[..., :1], 1e-3)


def offsets_at(coefficients: np.ndarray, frames: int, frame: int, lattice_bits: int, size_log: int) -> np.ndarray:
    """Change of the bases in one frame by the coefficients, float64 (n, C) as in `types.sequence_scene.GroupMotion.at`.

    Args:
        coefficients: (n, C, K), the first K of a group; the others are 0.
        frames: Number of frames of the group.
        frame: Index of the frame.
        unit: As for `targets_of`.
        size_log: As for `targets_of`.
    """
    tracks, channels, orders = coefficients.shape
    # a product of one axis; for three axes there are many
    rows = coefficients.reshape(tracks * channels, orders).astype(np.float64)
    values = (rows @ polynomials(frames)[frame, :orders]).reshape(tracks, channels)
    values[:, :3] = np.ldexp(values[:, :3], size_log - lattice_bits - 1)
    values[:, 3:6] /= _TURN
    values[:, 6:10] *= np.log(2.0) / _FIXED
    values[:, 10:] = values[:, 10:] / (_FIXED * DC) @ LUMA_CHROMA
    return values
