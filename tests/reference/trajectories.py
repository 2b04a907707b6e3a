"""What tracks do as coefficients, in plain numpy and torch."""

import numpy as np
import torch

from splatwire.codec.schemas.gaussians.attributes import LUMA_CHROMA
from splatwire.codec.schemas.gaussians.layout import BITS, DIRECTION_BITS
from splatwire.codec.schemas.tracks.basis import polynomials
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.codec.schemas.tracks.trajectories import Trajectories
from splatwire.ops.spherical_harmonics import DC

_TURN = float(1 << DIRECTION_BITS)
_FIXED = float(1 << BITS)


def targets_of(moves: Trajectories, bases: Trajectories, unit: int, size_log: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of what tracks do, relative to their bases, in units of the channels.

    Args:
        moves: n tracks over F frames.
        bases: The same when they were born, one frame each.
        unit: `-log2` of the lattice's unit, relative to the scene's size.
        size_log: log2 of the scene's size.

    Returns:
        float64 (n, C, F); and largest rotation of each, the tangent of a quarter of its angle, float64 (n).
    """
    values = np.empty((len(moves.means), NUM_CHANNELS, moves.num_frames))
    difference = moves.means.astype(np.float64) - bases.means
    values[:, :3] = np.ldexp(difference, unit + 1 - size_log).swapaxes(1, 2)
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

    They go on from frame to frame: of the two quaternions of a rotation the one nearer to the frame before counts, so
    that more than half a turn is one, too (up to a whole one).

    Args:
        quats: (n, F, 4).
        bases: (n, 1, 4).
    """
    q = torch.from_numpy(np.asarray(quats, np.float64))
    b = torch.from_numpy(np.asarray(bases, np.float64))
    q, b = q / q.norm(dim=2, keepdim=True), b / b.norm(dim=2, keepdim=True)
    w = (q * b).sum(dim=2)
    v = (
        b[..., :1] * q[..., 1:]
        - q[..., :1] * b[..., 1:]
        - torch.linalg.cross(q[..., 1:], b[..., 1:].expand_as(q[..., 1:]))
    )
    turn = torch.cat([w[..., None], v], dim=2)
    signs = torch.ones(turn.shape[:2], dtype=torch.float64)
    signs[:, 0] = torch.where(w[:, 0] < 0, -1.0, 1.0)
    steps = (turn[:, 1:] * turn[:, :-1]).sum(dim=2)
    signs[:, 1:] = torch.where(steps < 0, -1.0, 1.0)
    turn = turn * signs.cumprod(dim=1)[..., None]
    return (turn[..., 1:] / (1 + turn[..., :1]).clamp(min=1e-3)).numpy()


def offsets_at(coefficients: np.ndarray, frames: int, frame: int, unit: int, size_log: int) -> np.ndarray:
    """What coefficients do to bases in one frame, float64 (n, C) as in `splatwire.model.clip.GroupMotion.at`.

    Args:
        coefficients: (n, C, K), the first K of a group; the others are 0.
        frames: Frames of the group.
        frame: Which of them.
        unit: As for `targets_of`.
        size_log: As there.
    """
    tracks, channels, orders = coefficients.shape
    rows = coefficients.reshape(tracks * channels, orders).astype(np.float64)  # one product: of three axes it is many
    values = (rows @ polynomials(frames)[frame, :orders]).reshape(tracks, channels)
    values[:, :3] = np.ldexp(values[:, :3], size_log - unit - 1)
    values[:, 3:6] /= _TURN
    values[:, 6:10] *= np.log(2.0) / _FIXED
    values[:, 10:] = values[:, 10:] / (_FIXED * DC) @ LUMA_CHROMA
    return values
