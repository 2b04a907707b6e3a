"""Planner for sequences: chooses the encoding quality, and the parity of the motion of each group of pictures."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.channel import LossModel
from splatwire.channel.loss_models import draw_checked
from splatwire.errors import InvalidValueError
from splatwire.planning.plan_file import Plan
from splatwire.planning.sequence.delivery import SequenceLoad, model_motion_transfer
from splatwire.planning.sequence.distortion import SequenceDistortion
from splatwire.transport.protocol.protection import Protection

PARTS = (0.25, 0.5, 0.75, 1.0)
"""Candidate fractions of a group's motion packets that parity protects, most important packets first."""
REPAIRS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.25, 1.5, 2.0)
INIT_REPAIR = 0.6
"""Repair symbols per source symbol of the init segment, which is small."""
MIN_GAIN_DB = 0.02
"""Minimum gain in dB over a plan without parity, below which no parity is used, because simulations cannot resolve
less."""


@dataclass(frozen=True, eq=False)
class SequenceVariant:
    """One of several encodings of a sequence, with different qualities, among which the planner chooses.

    Attributes:
        load: Sizes and importance of the packets.
        distortion: Predicts the picture error from the lost share of each group's motion.
    """

    load: SequenceLoad
    distortion: SequenceDistortion


@dataclass(frozen=True)
class SequencePlan(Plan):
    """Encoding and redundancy of a sequence as chosen by the planner, with the expected quality.

    Attributes:
        unprotected: For comparison: mean PSNR after losses if the best plan without parity is used, decibels.
        parity_bytes: Bytes of parity for motion.
    """

    unprotected: float
    parity_bytes: int


@dataclass(frozen=True)
class _Choice:
    """A possible amount of parity for the motion of one group of pictures, with the quality expected from it.

    Attributes:
        pair: Share of the motion packets that get parity; and number of repair symbols divided by the number of packets
            that get parity.
        num_bytes: Size of the parity in bytes.
        psnr: Mean PSNR of the group over simulated transfers, decibels.
        lost: Mean lost share of the group's motion, 0 to 1; packets are weighted by importance.
        frames: Number of frames of the group.
    """

    pair: tuple[float, float]
    num_bytes: int
    psnr: float
    lost: float
    frames: int


def plan_sequence(
    variants: Sequence[SequenceVariant], loss: LossModel, *, budget_bytes: float | int,
    group_bytes: Sequence[float] | None = None, trials: int = 200, seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> SequencePlan:  # fmt: skip
    """Chooses a variant of a sequence, and the amount of parity for each group of pictures.

    Args:
        variants: Variants of the sequence in several qualities.
        loss: Loss model of the channel, in datagrams.
        budget_bytes: Maximum bytes sent, without retransmissions.
        group_bytes: Maximum bytes of motion and parity of each group; None for no limit.
        trials: Number of simulated transfers per group.
        seed: Seed of the simulated losses.
        progress: Called with the completed fraction.

    Raises:
        InvalidValueError: If no variant fits the budget.
    """
    plans = []
    for number, variant in enumerate(variants):
        choices = []
        for group in range(len(variant.load.groups)):
            most = None if group_bytes is None else group_bytes[group]
            choices.append(_efficient_choices(variant, group, loss, most, trials, seed))
            if progress:
                progress((number + (group + 1) / len(variant.load.groups)) / len(variants))
        room = budget_bytes - variant.load.num_bytes
        if room >= 0 and all(choices):
            plans += [
                _plan(variant, number, [choices_of_group[0] for choices_of_group in choices]),
                _plan(variant, number, _distribute_bytes(choices, room)),
            ]
    if not plans:
        raise InvalidValueError(
            f"{budget_bytes:,.0f} bytes are fewer than the smallest clip has, or a deadline is too short for its motion"
        )
    plain = max(plans[::2], key=lambda plan: plan.psnr)
    best = max(plans, key=lambda plan: plan.psnr)
    chosen = best if best.psnr > plain.psnr + MIN_GAIN_DB else plain
    return SequencePlan(**{**vars(chosen), "unprotected": plain.psnr})


def _efficient_choices(
    variant: SequenceVariant, group: int, loss: LossModel, max_bytes: float | int | None, trials: int, seed: int
) -> list[_Choice]:
    """Returns the efficient amounts of parity for a group of pictures: the upper convex hull of PSNR over bytes.

    Args:
        variant: Encoded variant of the sequence.
        group: Index of the group of pictures.
        loss: Loss model of the channel, in datagrams.
        max_bytes: Maximum bytes of motion and parity of the group; None for no limit.
        trials: Number of simulated transfers.
        seed: Seed of the simulated losses.

    Returns:
        The possible amounts, ascending by bytes; empty if the motion alone exceeds `max_bytes`.
    """
    load, motion = variant.load, list(variant.load.groups[group].motion)
    plain = int(load.packet_bytes[motion].sum())
    if max_bytes is not None and plain > max_bytes:
        return []
    pairs = [(0.0, 0.0), *(itertools.product(PARTS, REPAIRS) if motion else ())]
    longest = len(motion) + len(load.groups[group].keyframes) + int(2.0 * len(motion)) + 1
    rngs = (np.random.Generator(np.random.PCG64([seed, group, trial])) for trial in range(trials))
    traces = np.stack([draw_checked(loss, longest, rng) for rng in rngs])
    by_bytes = dict[int, _Choice]()
    for pair in pairs:
        transfer = model_motion_transfer(load, Protection(motion=(pair,)), group)
        extra = transfer.parity_bytes
        if max_bytes is not None and plain + extra > max_bytes:
            continue
        importance = load.importance[transfer.order]
        lost = ~transfer.received_packets(traces) @ importance / max(importance.sum(), 1e-30)
        psnr = float(variant.distortion.psnr(group, lost).mean())
        if extra not in by_bytes or psnr > by_bytes[extra].psnr:
            by_bytes[extra] = _Choice(pair, extra, psnr, float(lost.mean()), variant.distortion.frames[group])
    return _hull([by_bytes[extra] for extra in sorted(by_bytes)])


def _hull(choices: Sequence[_Choice]) -> list[_Choice]:
    """Returns the parity choices on the upper convex hull of PSNR over bytes, ascending by bytes."""
    hull: list[_Choice] = []
    for choice in choices:
        if hull and choice.psnr <= hull[-1].psnr:
            continue
        while len(hull) > 1 and _slope(hull[-2], choice) >= _slope(hull[-2], hull[-1]):
            hull.pop()
        hull.append(choice)
    return hull


def _slope(one: _Choice, other: _Choice) -> float:
    return (other.psnr - one.psnr) / (other.num_bytes - one.num_bytes)


def _distribute_bytes(choices: Sequence[Sequence[_Choice]], room: float | int) -> list[_Choice]:
    """Spends a budget of parity bytes on groups of pictures, beginning where a byte increases the PSNR most.

    Args:
        choices: Possible amounts of parity for each group, ascending by bytes.
        room: Number of bytes to spend.

    Returns:
        The chosen amount of parity for each group.
    """
    chosen, bytes_left = [0] * len(choices), room
    steps = [
        (-_slope(a, b) * a.frames, group, n)
        for group, choices_of_group in enumerate(choices)
        for n, (a, b) in enumerate(itertools.pairwise(choices_of_group))
    ]  # fmt: skip
    for _, group, number in sorted(steps):
        cost = choices[group][number + 1].num_bytes - choices[group][number].num_bytes
        if chosen[group] == number and cost <= bytes_left:
            chosen[group], bytes_left = number + 1, bytes_left - cost
    return [choices_of_group[n] for choices_of_group, n in zip(choices, chosen, strict=True)]


def _plan(variant: SequenceVariant, number: int, chosen: Sequence[_Choice]) -> SequencePlan:
    parity = sum(choice.num_bytes for choice in chosen)
    protection = Protection(init_repair=INIT_REPAIR, motion=tuple(choice.pair for choice in chosen))
    psnr = float(np.average([choice.psnr for choice in chosen], weights=[choice.frames for choice in chosen]))
    return SequencePlan(
        protection, number, psnr, tuple(choice.lost for choice in chosen), variant.load.num_bytes + parity, psnr, parity
    )
