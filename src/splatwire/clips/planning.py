"""Where parity pays in a clip: splits bytes between finer quantisation and the motion of each group of frames.

A group's motion is of use until its time has passed, so that each group has a code of its own. What a lost packet costs
after concealment differs from group to group (`ClipDamage`) and from packet to packet (`splatwire.clips.worth`). For
each group, parities are tried on simulated transfers; bytes then go where they buy most decibels.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.channel import LossModel
from splatwire.clips.damage import ClipDamage
from splatwire.clips.delivery import ClipLoad, passage
from splatwire.errors import InvalidValueError
from splatwire.transport.protection import Protection

PARTS = (0.25, 0.5, 0.75, 1.0)
"""Shares of a group's motion that share a code."""
REPAIRS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.25, 1.5, 2.0)
SIDE_REPAIR = 0.6
"""Of manifest and side information, which are small."""
PRUDENT_DB = 0.02
"""No parity, or another stream without it, wins unless a plan is better by more: simulations tell less not apart."""


@dataclass(frozen=True, eq=False)
class ClipOffer:
    """A clip that may be sent, and what losses do to it; several qualities of one clip may compete.

    Attributes:
        load: Its packets.
        damage: What losing motion costs.
    """

    load: ClipLoad
    damage: ClipDamage


@dataclass(frozen=True)
class ClipPlan:
    """Parity for each group of frames, and what is expected of it.

    Attributes:
        protection: Where parity goes.
        offer: Number of the stream.
        psnr: Mean over frames and simulated transfers, decibels.
        unprotected: The same without parity, of the stream that is best then.
        lost: Share of the motion of each group that is lost, by what it is worth.
        sent_bytes: Bytes on the wire, bases once.
        parity_bytes: Those of parity for motion.
    """

    protection: Protection
    offer: int
    psnr: float
    unprotected: float
    lost: tuple[float, ...]
    sent_bytes: int
    parity_bytes: int


@dataclass(frozen=True)
class _Choice:
    """A way to protect a group: share and repair (`Protection.motion`), its bytes, decibels, share lost; its frames."""

    pair: tuple[float, float]
    num_bytes: int
    psnr: float
    lost: float
    frames: int


def plan_clip(
    offers: Sequence[ClipOffer], loss: LossModel, *, budget_bytes: float | int,
    group_bytes: Sequence[float] | None = None, trials: int = 200, seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> ClipPlan:  # fmt: skip
    """Chooses a stream, and parity for each of its groups.

    Args:
        offers: The clip; or several qualities of it.
        loss: The channel, in datagrams.
        budget_bytes: Bytes that may be sent in all, bases once.
        group_bytes: Most bytes of each group, its bases apart: what leaves until its deadline. None: no such limit.
        trials: Simulated transfers of each group.
        seed: Of the simulated losses.
        progress: Called with the share of the work that is done.

    Raises:
        InvalidValueError: If no stream fits the budget.
    """
    plans = []
    for number, offer in enumerate(offers):
        choices = []
        for group in range(len(offer.load.groups)):
            most = None if group_bytes is None else group_bytes[group]
            choices.append(_choices(offer, group, loss, most, trials, seed))
            if progress:
                progress((number + (group + 1) / len(offer.load.groups)) / len(offers))
        room = budget_bytes - offer.load.num_bytes
        if room >= 0 and all(choices):
            plans += [_plan(offer, number, [some[0] for some in choices]), _plan(offer, number, _spent(choices, room))]
    if not plans:
        raise InvalidValueError(
            f"{budget_bytes:,.0f} bytes are fewer than the smallest clip has, or a deadline is too short for its motion"
        )
    plain = max(plans[::2], key=lambda plan: plan.psnr)
    best = max(plans, key=lambda plan: plan.psnr)
    chosen = best if best.psnr > plain.psnr + PRUDENT_DB else plain
    return ClipPlan(**{**vars(chosen), "unprotected": plain.psnr})


def _choices(
    offer: ClipOffer, group: int, loss: LossModel, most: float | int | None, trials: int, seed: int
) -> list[_Choice]:
    """Ways to protect a group, from none on, that buy more for each byte than those that cost more."""
    load, motion = offer.load, list(offer.load.groups[group].motion)
    plain = int(load.packet_bytes[motion].sum())
    if most is not None and plain > most:
        return []
    pairs = [(0.0, 0.0), *(itertools.product(PARTS, REPAIRS) if motion else ())]
    longest = len(motion) + len(load.groups[group].bases) + int(2.0 * len(motion)) + 1
    rngs = (np.random.Generator(np.random.PCG64([seed, group, trial])) for trial in range(trials))
    traces = np.stack([loss.received(longest, rng) for rng in rngs])
    found = dict[int, _Choice]()
    for pair in pairs:
        way = passage(load, Protection(motion=(pair,)), group)
        extra = way.num_parity * load.parity_bytes
        if most is not None and plain + extra > most:
            continue
        worth = load.worth[way.order]
        lost = ~way.arrived(traces) @ worth / max(worth.sum(), 1e-30)
        psnr = float(offer.damage.psnr(group, lost).mean())
        if extra not in found or psnr > found[extra].psnr:
            found[extra] = _Choice(pair, extra, psnr, float(lost.mean()), offer.damage.frames[group])
    return _hull([found[extra] for extra in sorted(found)])


def _hull(choices: Sequence[_Choice]) -> list[_Choice]:
    """Those on the upper convex hull of decibels over bytes, rising."""
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


def _spent(choices: Sequence[Sequence[_Choice]], room: float | int) -> list[_Choice]:
    """Spends bytes step by step where they buy most."""
    at, left = [0] * len(choices), room
    steps = [
        (-_slope(a, b) * a.frames, group, n)
        for group, some in enumerate(choices) for n, (a, b) in enumerate(itertools.pairwise(some))
    ]  # fmt: skip
    for _, group, number in sorted(steps):
        cost = choices[group][number + 1].num_bytes - choices[group][number].num_bytes
        if at[group] == number and cost <= left:
            at[group], left = number + 1, left - cost
    return [some[n] for some, n in zip(choices, at, strict=True)]


def _plan(offer: ClipOffer, number: int, chosen: Sequence[_Choice]) -> ClipPlan:
    parity = sum(choice.num_bytes for choice in chosen)
    protection = Protection(side_repair=SIDE_REPAIR, motion=tuple(choice.pair for choice in chosen))
    psnr = float(np.average([choice.psnr for choice in chosen], weights=[choice.frames for choice in chosen]))
    return ClipPlan(
        protection, number, psnr, psnr, tuple(choice.lost for choice in chosen), offer.load.num_bytes + parity, parity
    )
