"""Partners of Gaussians from frame to frame, where rows do not say: a smooth motion, then one to one within it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from splatwire.errors import InvalidValueError
from splatwire.scene.splats import Splats

SAMPLE = 4000
"""Gaussians that decide whether rows are tracked, and to which the overall motion is fitted."""
ROUNDS = ((32, 0.25), (16, 1.0), (8, 1.0))
"""Candidates in each round, and how much their places count beside their looks."""
SMOOTHED = 12
"""A Gaussian is expected to move as so many of its neighbours whose partners are sure."""
ALIKE = 0.03
"""Share of how far candidates are, and of how much they differ: less tells little about who is whose partner."""
AROUND, ANOTHER = 8, 0.06
"""How far a Gaussian is from where its partner is expected, as a share of the way from there to its eighth neighbour,
times how they differ, as a share of how any two do: from `ANOTHER` on it is another one. As motion of the partner it
would take more bytes than one that is born, and show less well (measured: frames that draw other Gaussians of one
capture, or the same ones disturbed)."""
FEWEST = 0.2
"""Where fewer find a partner, those few did by chance: the frame shows another scene."""
_AFFINE_STEPS, _TRIMMED = 20, 0.7


@dataclass(frozen=True, eq=False)
class Match:
    """Which Gaussian of a frame is which of the one before.

    Attributes:
        partner: Row of the frame before, one to one; -1 for those without: they are born. int64 (M).
        velocity: How each moved since, float64 (M, 3); of those without a partner, what is expected at their place.
    """

    partner: np.ndarray
    velocity: np.ndarray

    @property
    def share(self) -> float:
        """Share that found a partner."""
        return float((self.partner >= 0).mean()) if len(self.partner) else 1.0


def tracked(previous: Splats, current: Splats) -> bool:
    """Whether rows keep their Gaussian.

    They do where looks of rows agree far better than by chance, or where a row moves as the rows near it do.

    Args:
        previous: A frame.
        current: The next one, of as many Gaussians.
    """
    count = previous.num_gaussians
    if count != current.num_gaussians:
        return False
    if count < 3:
        return True
    some = np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).astype(np.int64))
    looks = [_looks(splats.select(some)) for splats in (previous, current)]
    own = np.median(np.abs(looks[0] - looks[1]).sum(axis=1))
    other = np.median(np.abs(looks[0] - np.roll(looks[1], len(some) // 2, axis=0)).sum(axis=1))
    if other > 0.1 and own < 0.1 * other:
        return True
    before, moved = _places(previous), _places(current) - _places(previous)
    finite = np.isfinite(before).all(axis=1) & np.isfinite(moved).all(axis=1)
    tree = cKDTree(before[finite])
    some = some[finite[some]]
    distance, near = tree.query(before[some], k=min(9, int(finite.sum())))
    around = moved[finite][near[:, 1:]]
    spacing = float(np.median(distance[:, 1]))
    rest = np.linalg.norm(moved[some] - np.median(around, axis=1), axis=1)
    return bool(np.median(rest) <= 0.3 * spacing)


def match(previous: Splats, current: Splats, before: Match | None = None) -> Match:
    """Finds partners.

    Args:
        previous: A frame.
        current: The next one, in any order, of as many Gaussians or not.
        before: How those of `previous` were matched: they are expected to move on.

    Raises:
        InvalidValueError: If degrees of the harmonics differ.
    """
    if previous.degree != current.degree:
        raise InvalidValueError(
            f"frames have harmonics of degree {previous.degree} and {current.degree}: they must have the same"
        )
    places, now = _places(previous), _places(current)
    if not len(places) or not len(now):
        return Match(np.full(len(now), -1, np.int64), np.zeros_like(now))
    guess = places + (before.velocity if before is not None else 0.0)
    expected = _affine(guess, now)
    looks = [_looks(splats) for splats in (previous, current)]
    spread = np.maximum(np.median(np.abs(looks[0] - np.median(looks[0], axis=0)), axis=0), 1e-3)
    shift = np.median(looks[1], axis=0) - np.median(looks[0], axis=0)  # one colour for all is no reason to differ
    looks = [(looks[0] + shift) / spread, looks[1] / spread]
    partner = np.full(len(now), -1, np.int64)
    for candidates, weight in ROUNDS:
        partner, sure = _partners(expected, now, looks[0], looks[1], candidates, weight)
        expected = _smooth(places, now, partner, sure, expected)
    partner, _ = _partners(expected, now, looks[0], looks[1], ROUNDS[-1][0], 1.0)
    partner[_another(expected, now, looks[0], looks[1], partner)] = -1
    if (partner >= 0).sum() < FEWEST * min(len(places), len(now)):
        return Match(np.full(len(now), -1, np.int64), np.zeros_like(now))
    return Match(partner, _velocity(places, now, partner, expected))


def aligned(previous: Splats, current: Splats, partner: np.ndarray) -> Splats:
    """The same Gaussians, written so that axes go on from those of their partners.

    A Gaussian has 24 names: its axes in any order, each either way round.

    Args:
        previous: A frame.
        current: The next one.
        partner: See `Match`.
    """
    from splatwire.clips.axes import continued

    quats, scales = continued(previous, current, partner)
    return Splats(current.means, quats, scales, current.opacities, current.sh)


def _places(splats: Splats) -> np.ndarray:
    return splats.means.astype(np.float64)


def _looks(splats: Splats) -> np.ndarray:
    """What a Gaussian looks like, whichever way it is turned, float64 (N, 7)."""
    logs = np.log(np.sort(np.maximum(splats.scales.astype(np.float64), 1e-12), axis=1))
    opacities = np.clip(splats.opacities.astype(np.float64), 1e-4, 1 - 1e-4)
    logits = np.log(opacities / (1 - opacities))
    return np.concatenate([logs, logits[:, None] / 2, splats.sh[:, 0].astype(np.float64) * 2], axis=1)


def _affine(places: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Places after the affine motion that brings them nearest to others (iterated closest points, trimmed)."""
    some = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), SAMPLE)).astype(np.int64))]
    tree, matrix = cKDTree(now), np.concatenate([np.eye(3), np.zeros((1, 3))])
    if len(some) < 8:
        return places
    best, last = matrix, np.inf
    padded = np.concatenate([some, np.ones((len(some), 1))], axis=1)
    for _ in range(_AFFINE_STEPS):
        distance, near = tree.query(padded @ matrix, workers=-1)
        error = float(np.median(distance))
        if error >= last * 0.999:
            break
        best, last = matrix, error
        kept = distance <= np.quantile(distance, _TRIMMED)
        matrix = np.linalg.lstsq(padded[kept], now[near[kept]], rcond=None)[0]
    return np.concatenate([places, np.ones((len(places), 1))], axis=1) @ best


def _partners(
    expected: np.ndarray, now: np.ndarray, looks: np.ndarray, looks_now: np.ndarray, candidates: int, weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """One partner at most for each, and which are sure."""
    count = min(candidates, len(expected))
    distance, near = cKDTree(expected).query(now, k=count, workers=-1)
    distance, near = distance.reshape(len(now), count), near.reshape(len(now), count)
    differ = ((looks_now[:, None, :] - looks[near]) ** 2).sum(axis=2)
    best = np.argmin(differ + (distance / _typical(distance[:, 0])) ** 2 * weight, axis=1)
    here = np.arange(len(now))
    # Where most stand still or look as before, what is usual is nothing: a share of what others differ by, then.
    far_off, unlike = float(np.median(distance[:, -1])), float(np.median(np.sqrt(differ)))
    unit = max(_typical(distance[here, best]), ALIKE * far_off)
    look = max(_typical(np.sqrt(differ[here, best])), ALIKE * unlike) ** 2
    score = (distance / unit) ** 2 * weight + differ / look
    partner = _one_to_one(score, near, len(expected))
    found, mine = partner >= 0, near == partner[:, None]

    def own(values: np.ndarray) -> np.ndarray:
        return np.where(found, np.where(mine, values, np.inf).min(axis=1), np.inf)

    alike, chosen = own(differ), own(score)
    second = np.partition(score, 1, axis=1)[:, 1] if count > 1 else np.full(len(now), np.inf)
    # Looks alone say who is most alike: what moves most is farthest from where it is expected, and tells most.
    sure = found & (chosen < 0.7 * second)
    return partner, sure & (alike <= np.quantile(alike[found], 0.8)) if found.any() else sure


def _another(
    expected: np.ndarray, now: np.ndarray, looks: np.ndarray, looks_now: np.ndarray, partner: np.ndarray
) -> np.ndarray:
    """Rows of those whose partners are others: neither where they are expected, nor alike.

    Looks are in units of their spread: where all look the same, less than one of these is rounding.
    """
    found = np.flatnonzero(partner >= 0)
    theirs = partner[found]
    usual = max(np.median(np.linalg.norm(looks_now - np.roll(looks_now, len(now) // 2, axis=0), axis=1)), 1.0)
    unlike = np.linalg.norm(looks_now[found] - looks[theirs], axis=1)
    distance, _ = cKDTree(expected).query(expected[theirs], k=[min(AROUND + 1, len(expected))], workers=-1)
    apart = np.linalg.norm(now[found] - expected[theirs], axis=1)
    other: np.ndarray = found[apart * unlike > ANOTHER * distance[:, 0] * usual]
    return other


def _typical(values: np.ndarray) -> float:
    """The usual size of a distance; never 0."""
    return max(float(np.median(values)) * 1.5, float(values.mean()) * 1e-3, 1e-12)


def _one_to_one(score: np.ndarray, near: np.ndarray, count: int) -> np.ndarray:
    """Partners such that nobody has two: again and again those that choose each other, int64 (M)."""
    partner, taken, score = np.full(len(score), -1, np.int64), np.zeros(count, bool), score.copy()
    left = np.arange(len(score))
    for _ in range(score.shape[1] * 2):
        score[left[:, None], np.arange(score.shape[1])] = np.where(taken[near[left]], np.inf, score[left])
        best = score[left].argmin(axis=1)
        value, wanted = score[left, best], near[left, best]
        possible = np.isfinite(value)
        left, value, wanted = left[possible], value[possible], wanted[possible]
        if not len(left):
            break
        order = np.lexsort((value, wanted))
        first = order[np.concatenate([[True], wanted[order][1:] != wanted[order][:-1]])]
        partner[left[first]], taken[wanted[first]] = wanted[first], True
        left = np.delete(left, first)
    return partner


def _smooth(
    places: np.ndarray, now: np.ndarray, partner: np.ndarray, sure: np.ndarray, expected: np.ndarray
) -> np.ndarray:
    """Where each is expected: moved as the sure ones around it, by their median."""
    some = np.flatnonzero(sure)
    if len(some) < SMOOTHED:
        return expected
    rows = partner[some]
    rest = now[some] - expected[rows]
    _, near = cKDTree(places[rows]).query(places, k=SMOOTHED, workers=-1)
    return expected + np.median(rest[near], axis=1)


def _velocity(places: np.ndarray, now: np.ndarray, partner: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """How each moved; those without a partner as what is expected nearest to them."""
    found = partner >= 0
    velocity = np.zeros_like(now)
    velocity[found] = now[found] - places[partner[found]]
    if not found.all():
        _, near = cKDTree(expected).query(now[~found])
        velocity[~found] = (expected - places)[near]
    return velocity
