"""Matching of the Gaussians of two frames with different order, by smooth motion and similar appearance."""

from dataclasses import dataclass

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.ops.kd_tree import build_kd_tree
from splatwire.sequence.axes import continue_axes
from splatwire.types.splats import Splats

SAMPLE_SIZE = 4000
"""Number of Gaussians sampled to detect whether two frames have the same order, and to fit the affine motion."""
ROUNDS = ((32, 0.25), (16, 1.0), (8, 1.0))
"""Matching rounds: number of candidates, and weight of the position relative to the appearance."""
NUM_PREDICTING = 12
"""Number of neighbours with a confident match that predict a Gaussian's motion."""
MIN_DIFFERENCE = 0.03
"""Lower bound of the differences of position and appearance, as a fraction of the candidates' medians; smaller
differences are noise.
"""
SCORE_NEIGHBOR = 8
"""Distances in the score of a match are divided by the distance to this nearest Gaussian, counted from 0."""
MAX_SCORE = 0.06
"""Score from which a match is rejected as implausible: distance from the predicted position, times the difference in
appearance relative to that of random pairs. Above this score, a new track takes fewer bytes and gives a better picture.
This was measured on unrelated and on disturbed frames of one capture.
"""
MIN_MATCHED_SHARE = 0.2
"""Fraction of matched Gaussians below which all matches are rejected as random, and the frame is a scene cut."""
_AFFINE_STEPS = 20
_KEPT_SHARE = 0.7
"""Share of the pairs that each step of the affine fit keeps: the pairs with the smallest distances."""


@dataclass(frozen=True, eq=False)
class Match:
    """Matches between the Gaussians of a frame and the Gaussians of the previous frame.

    Attributes:
        partner: For each Gaussian, index of its match in the previous frame, int64 (M); -1 for new Gaussians.
        velocity: Motion since the previous frame, float64 (M, 3); predicted for new Gaussians. 0 for all if either
            frame is empty or all matches were rejected.
    """

    partner: np.ndarray
    velocity: np.ndarray

    @property
    def share(self) -> float:
        """Fraction of Gaussians with a match."""
        return float((self.partner >= 0).mean()) if len(self.partner) else 1.0


def has_same_order(previous: Splats, current: Splats) -> bool:
    """True if two frames probably have the same Gaussians in the same order.

    Args:
        previous: Previous frame.
        current: Current frame.
    """
    # Gaussians with equal index look far more similar than random pairs, or move like their neighbours.
    count = previous.num_gaussians
    if count != current.num_gaussians:
        return False
    if count < 3:
        return True
    sample = np.unique(np.linspace(0, count - 1, min(count, SAMPLE_SIZE)).astype(np.int64))
    appearance = [_appearance(splats.select(sample)) for splats in (previous, current)]
    difference = np.median(np.abs(appearance[0] - appearance[1]).sum(axis=1))
    random_difference = np.median(np.abs(appearance[0] - np.roll(appearance[1], len(sample) // 2, axis=0)).sum(axis=1))
    if random_difference > 0.1 and difference < 0.1 * random_difference:
        return True
    before, motion = _positions(previous), _positions(current) - _positions(previous)
    finite = np.isfinite(before).all(axis=1) & np.isfinite(motion).all(axis=1)
    tree = build_kd_tree(before[finite])
    sample = sample[finite[sample]]
    distance, neighbors = tree.query(before[sample], k=min(9, int(finite.sum())))
    neighbor_motion = motion[finite][neighbors[:, 1:]]
    spacing = float(np.median(distance[:, 1]))
    deviation = np.linalg.norm(motion[sample] - np.median(neighbor_motion, axis=1), axis=1)
    return bool(np.median(deviation) <= 0.3 * spacing)


def match(previous: Splats, current: Splats, previous_match: Match | None = None) -> Match:
    """Finds for each Gaussian of a frame the same Gaussian in the previous frame.

    Args:
        previous: Previous frame.
        current: Current frame, with any order and number of Gaussians.
        previous_match: Match of `previous` to its predecessor, for motion prediction.

    Raises:
        InvalidValueError: If the degrees of harmonics differ.
    """
    if previous.degree != current.degree:
        raise InvalidValueError(
            f"frames have harmonics of degree {previous.degree} and {current.degree}: they must have the same"
        )
    positions, current_positions = _positions(previous), _positions(current)
    if not len(positions) or not len(current_positions):
        return Match(np.full(len(current_positions), -1, np.int64), np.zeros_like(current_positions))
    extrapolated = positions + (previous_match.velocity if previous_match is not None else 0.0)
    expected = _move_affinely(extrapolated, current_positions)
    appearance = [_appearance(splats) for splats in (previous, current)]
    appearance_scale = np.maximum(np.median(np.abs(appearance[0] - np.median(appearance[0], axis=0)), axis=0), 1e-3)
    # A colour change of the whole scene is no difference.
    shift = np.median(appearance[1], axis=0) - np.median(appearance[0], axis=0)
    appearance = [(appearance[0] + shift) / appearance_scale, appearance[1] / appearance_scale]
    partner = np.full(len(current_positions), -1, np.int64)
    for candidates, weight in ROUNDS:
        partner, is_confident = _match_one_to_one(
            expected, current_positions, appearance[0], appearance[1], candidates, weight
        )
        expected = _correct_expected(positions, current_positions, partner, is_confident, expected)
    partner, _ = _match_one_to_one(expected, current_positions, appearance[0], appearance[1], ROUNDS[-1][0], 1.0)
    partner[_implausible_matches(expected, current_positions, appearance[0], appearance[1], partner)] = -1
    if (partner >= 0).sum() < MIN_MATCHED_SHARE * min(len(positions), len(current_positions)):
        return Match(np.full(len(current_positions), -1, np.int64), np.zeros_like(current_positions))
    return Match(partner, _velocity(positions, current_positions, partner, expected))


def aligned(previous: Splats, current: Splats, partner: np.ndarray) -> Splats:
    """Returns the Gaussians of a frame, with the order and signs of axes that are closest to the previous frame.

    A Gaussian has several equivalent descriptions, with different orders and signs of its axes. The choice changes the
    description, but not the Gaussian.

    Args:
        previous: Previous frame.
        current: Current frame with M Gaussians.
        partner: For each Gaussian of the current frame, index of its match in the previous frame, int64 (M); -1 for new
            Gaussians.
    """
    quats, scales = continue_axes(previous, current, partner)
    return Splats(current.means, quats, scales, current.opacities, current.sh)


def _positions(splats: Splats) -> np.ndarray:
    return splats.means.astype(np.float64)


def _appearance(splats: Splats) -> np.ndarray:
    """Returns size, opacity and colour of each Gaussian, scaled for comparison with other frames, float64 (N, 7).

    The values do not depend on the Gaussian's position and rotation.
    """
    logs = np.log(np.sort(np.maximum(splats.scales.astype(np.float64), 1e-12), axis=1))
    opacities = np.clip(splats.opacities.astype(np.float64), 1e-4, 1 - 1e-4)
    logits = np.log(opacities / (1 - opacities))
    return np.concatenate([logs, logits[:, None] / 2, splats.sh[:, 0].astype(np.float64) * 2], axis=1)


def _move_affinely(positions: np.ndarray, current_positions: np.ndarray) -> np.ndarray:
    """Fits an affine motion between two frames and applies the motion to the previous positions.

    Args:
        positions: Positions in the previous frame, (N, 3).
        current_positions: Positions in the current frame, (M, 3).

    Returns:
        Positions of the previous frame after the motion, (N, 3).
    """
    sample = positions[np.unique(np.linspace(0, len(positions) - 1, min(len(positions), SAMPLE_SIZE)).astype(np.int64))]
    # Trimmed iterative closest points: distant pairs are ignored.
    tree, matrix = build_kd_tree(current_positions), np.concatenate([np.eye(3), np.zeros((1, 3))])
    if len(sample) < 8:
        return positions
    best, last = matrix, np.inf
    padded = np.concatenate([sample, np.ones((len(sample), 1))], axis=1)
    for _ in range(_AFFINE_STEPS):
        distance, nearest = tree.query(padded @ matrix, workers=-1)
        error = float(np.median(distance))
        if error >= last * 0.999:
            break
        best, last = matrix, error
        kept = distance <= np.quantile(distance, _KEPT_SHARE)
        matrix = np.linalg.lstsq(padded[kept], current_positions[nearest[kept]], rcond=None)[0]
    return np.concatenate([positions, np.ones((len(positions), 1))], axis=1) @ best


def _match_one_to_one(
    expected: np.ndarray,
    current_positions: np.ndarray,
    appearance: np.ndarray,
    current_appearance: np.ndarray,
    candidates: int,
    weight: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Matches the Gaussians of two frames one to one, by position and appearance.

    Args:
        expected: For the previous frame's Gaussians, their predicted positions in the current frame, (N, 3).
        current_positions: Positions of the current frame's Gaussians, (M, 3).
        appearance: Appearance of the previous frame's Gaussians, from `_appearance`.
        current_appearance: Appearance of the current frame's Gaussians.
        candidates: Number of nearest previous Gaussians that are compared with each current one.
        weight: Weight of the distance between positions, relative to the difference in appearance.

    Returns:
        Index of the match of each current Gaussian, -1 for none; and the mask of confident matches.
    """
    count = min(candidates, len(expected))
    distance, nearest = build_kd_tree(expected).query(current_positions, k=count, workers=-1)
    distance, nearest = distance.reshape(len(current_positions), count), nearest.reshape(len(current_positions), count)
    appearance_distance = ((current_appearance[:, None, :] - appearance[nearest]) ** 2).sum(axis=2)
    best = np.argmin(appearance_distance + (distance / _distance_scale(distance[:, 0])) ** 2 * weight, axis=1)
    all_rows = np.arange(len(current_positions))
    # Where most Gaussians do not move or change, the medians are zero; bound the units by a share of the candidates'.
    far_off, typical_difference = float(np.median(distance[:, -1])), float(np.median(np.sqrt(appearance_distance)))
    distance_unit = max(_distance_scale(distance[all_rows, best]), MIN_DIFFERENCE * far_off)
    appearance_unit = (
        max(_distance_scale(np.sqrt(appearance_distance[all_rows, best])), MIN_DIFFERENCE * typical_difference) ** 2
    )
    score = (distance / distance_unit) ** 2 * weight + appearance_distance / appearance_unit
    partner = _one_to_one(score, nearest, len(expected))
    has_partner, is_partner = partner >= 0, nearest == partner[:, None]

    def own(values: np.ndarray) -> np.ndarray:
        return np.where(has_partner, np.where(is_partner, values, np.inf).min(axis=1), np.inf)

    matched_difference, matched_score = own(appearance_distance), own(score)
    second = np.partition(score, 1, axis=1)[:, 1] if count > 1 else np.full(len(current_positions), np.inf)
    # A confident match scores clearly better than the second candidate, and is among the 80 % with the smallest
    # differences in appearance. The latter ignores distances: fast Gaussians are far from their prediction, and matter
    # most.
    is_confident = has_partner & (matched_score < 0.7 * second)
    return partner, is_confident & (
        matched_difference <= np.quantile(matched_difference[has_partner], 0.8)
    ) if has_partner.any() else is_confident


def _implausible_matches(
    expected: np.ndarray,
    current_positions: np.ndarray,
    appearance: np.ndarray,
    current_appearance: np.ndarray,
    partner: np.ndarray,
) -> np.ndarray:
    """Finds matches with a large difference in both position and appearance.

    Args:
        expected: For the previous frame's Gaussians, their predicted positions in the current frame, (N, 3).
        current_positions: Positions of the current frame's Gaussians, (M, 3).
        appearance: Appearance of the previous frame's Gaussians, from `_appearance`.
        current_appearance: Appearance of the current frame's Gaussians.
        partner: Index of the match of each current Gaussian in the previous frame, (M); -1 for none.

    Returns:
        Indices of the current frame's Gaussians whose matches are implausible, int64.
    """
    matched = np.flatnonzero(partner >= 0)
    partners = partner[matched]
    typical_difference = max(
        np.median(
            np.linalg.norm(
                current_appearance - np.roll(current_appearance, len(current_positions) // 2, axis=0), axis=1
            )
        ),
        1.0,
    )
    difference = np.linalg.norm(current_appearance[matched] - appearance[partners], axis=1)
    distance, _ = build_kd_tree(expected).query(
        expected[partners], k=[min(SCORE_NEIGHBOR + 1, len(expected))], workers=-1
    )
    motion_error = np.linalg.norm(current_positions[matched] - expected[partners], axis=1)
    implausible: np.ndarray = matched[motion_error * difference > MAX_SCORE * distance[:, 0] * typical_difference]
    return implausible


def _distance_scale(values: np.ndarray) -> float:
    """Returns 1.5 times the median of distances, always above 0. Distances are divided by this value."""
    return max(float(np.median(values)) * 1.5, float(values.mean()) * 1e-3, 1e-12)


def _one_to_one(score: np.ndarray, candidates: np.ndarray, count: int) -> np.ndarray:
    """Matches Gaussians one to one by repeatedly matching mutual best candidates.

    Args:
        score: Cost of matching each Gaussian with each of its candidates, (N, candidates); a low cost is good.
        candidates: Indices of the candidates in the other frame, (N, candidates).
        count: Number of Gaussians in the other frame.

    Returns:
        For each Gaussian, index of its match in the other frame, int64 (N); -1 for none.
    """
    partner, taken, score = np.full(len(score), -1, np.int64), np.zeros(count, bool), score.copy()
    unmatched = np.arange(len(score))
    for _ in range(score.shape[1] * 2):
        score[unmatched[:, None], np.arange(score.shape[1])] = np.where(
            taken[candidates[unmatched]], np.inf, score[unmatched]
        )
        best = score[unmatched].argmin(axis=1)
        value, best_candidate = score[unmatched, best], candidates[unmatched, best]
        possible = np.isfinite(value)
        unmatched, value, best_candidate = unmatched[possible], value[possible], best_candidate[possible]
        if not len(unmatched):
            break
        order = np.lexsort((value, best_candidate))
        first = order[np.concatenate([[True], best_candidate[order][1:] != best_candidate[order][:-1]])]
        partner[unmatched[first]], taken[best_candidate[first]] = best_candidate[first], True
        unmatched = np.delete(unmatched, first)
    return partner


def _correct_expected(
    positions: np.ndarray,
    current_positions: np.ndarray,
    partner: np.ndarray,
    confident: np.ndarray,
    expected: np.ndarray,
) -> np.ndarray:
    """Corrects predicted positions by the median prediction error of nearby confident matches.

    Args:
        positions: Positions of N Gaussians in the previous frame, (N, 3).
        current_positions: Positions of M Gaussians in the current frame, (M, 3).
        partner: Index of the match of each current Gaussian in the previous frame, (M).
        confident: Mask of confident matches, (M).
        expected: For the N Gaussians, their predicted positions in the current frame, (N, 3).

    Returns:
        Corrected positions, (N, 3).
    """
    confident_rows = np.flatnonzero(confident)
    if len(confident_rows) < NUM_PREDICTING:
        return expected
    rows = partner[confident_rows]
    errors = current_positions[confident_rows] - expected[rows]
    _, nearest = build_kd_tree(positions[rows]).query(positions, k=NUM_PREDICTING, workers=-1)
    return expected + np.median(errors[nearest], axis=1)


def _velocity(
    positions: np.ndarray, current_positions: np.ndarray, partner: np.ndarray, expected: np.ndarray
) -> np.ndarray:
    """Returns the motion of each Gaussian since the previous frame, (M, 3).

    Args:
        positions: Positions in the previous frame, (N, 3).
        current_positions: Positions in the current frame, (M, 3).
        partner: Index of the match of each current Gaussian in the previous frame, (M); -1 for none.
        expected: For the Gaussians of the previous frame, their predicted positions in the current frame, (N, 3).
    """
    has_partner = partner >= 0
    velocity = np.zeros_like(current_positions)
    velocity[has_partner] = current_positions[has_partner] - positions[partner[has_partner]]
    # A Gaussian without a match gets the predicted motion of the nearest one.
    if not has_partner.all():
        _, nearest = build_kd_tree(expected).query(current_positions[~has_partner])
        velocity[~has_partner] = (expected - positions)[nearest]
    return velocity
