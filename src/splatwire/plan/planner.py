"""Where redundancy pays: splits a budget of bytes between side information, tiers of importance and nothing at all.

The sender knows what each tier is worth (`Damage`, measured by drawing the scene without it) and what the channel does
(a loss model). The planner tries protections, simulates transfers of each, and keeps the one with the best picture; the
best few, and those that anybody would try first, are compared by the pictures of simulated transfers themselves.
What leaves after the budget is spent is never sent: the same cut stands for a deadline at a given rate.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.channel import LossModel
from splatwire.errors import InvalidValueError
from splatwire.plan.candidates import (
    FINE_SYMBOL_BYTES,
    Search,
    arrival_within,
    candidates,
    largest_head,
    plain_candidates,
)
from splatwire.plan.damage import Offer, lost_shares
from splatwire.plan.outline import Deliveries, draw_losses, outline_transfer
from splatwire.transport.protection import Protection

HEAD_TRIALS = 1000
FINAL_TRIALS = 4000
"""Other transfers that the finalists are compared by: what fails twice in a thousand costs 0.04 dB, and a thousand
transfers do not tell it from what fails six times."""
MOST_FATES = 200_000_000
"""Simulated datagrams that are held at once, a byte each; long streams get fewer final transfers."""
SHORT_LIST = 16
"""Plans that are judged again by all simulated transfers: side information that fails once in a hundred costs a quarter
of a decibel, and a hundred transfers do not tell."""
FINALISTS = 4
NEAR_DB = 4.0
"""Plain plans are drawn as long as the damage curves hold them to be this close to the best. Where the end of a pass is
cut off, curves put a stream without tiers up to 3 dB too low: half of it is lost there, and it is concealed well."""
ALIKE_DB = 0.002
"""Plans closer than that are equals: then the one that protects more wins, since the budget is there to be spent and
simulated transfers know little of rare losses."""
PRUDENT_DB = 0.05
"""What anybody would try first wins unless a plan is better by more than that (and by more than a standard error of the
pictures), if all transfers lose something: a few views and transfers do not tell less apart. Transfers that deliver
everything or nothing are counted, and need no such margin."""
PRUDENT_SHARE = 0.06
"""The same as a share of what is lost: a scene shows losses more in the views that it was fitted to than in others, and
what seems to mend a little of much may mend nothing there."""


@dataclass(frozen=True)
class Plan:
    """A protection and what is expected of it.

    Attributes:
        protection: Where redundancy goes.
        offer: Number of the stream.
        psnr: Mean over simulated transfers, decibels.
        head_arrives: Share of the transfers in which the side information arrives.
        lost: Mean share of each tier's anchors that is lost.
        sizes: Bytes of a whole pass by what they are for.
        sent_bytes: Bytes that are sent within the budget, a preview in the welcome included.
        concealment_bytes: Bytes of the side information that only concealers need, and of previews.
    """

    protection: Protection
    offer: int
    psnr: float
    head_arrives: float
    lost: tuple[float, ...]
    sizes: dict[str, int]
    sent_bytes: int
    concealment_bytes: int = 0

    @property
    def protection_bytes(self) -> int:
        """Bytes that would not be there without losses."""
        return self.sizes["side_protection"] + self.sizes["packet_protection"] + self.concealment_bytes

    @property
    def protection_share(self) -> float:
        """Protection as a share of all bytes."""
        return self.protection_bytes / max(sum(self.sizes.values()), 1)


def plan_protection(
    offers: Sequence[Offer],
    loss: LossModel,
    *,
    budget_bytes: float | int,
    trials: int = 100,
    drawn: int = 6,
    seed: int = 0,
    most_protection: float = 1.0,
    head_target: float = 0.999,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Chooses the protection with the best expected picture.

    Args:
        offers: The stream; or several of the same scene, such as one with tiers and one without.
        loss: The channel, in datagrams.
        budget_bytes: Bytes that may be sent, datagram headers included; a deadline is its time times the rate.
        trials: Simulated transfers of each protection of the packets.
        drawn: Simulated transfers, out of a thousand others, whose pictures decide between the best (`Offer.picture`).
        seed: Of the simulated losses, which all candidates share.
        most_protection: Most protection as a share of all bytes.
        head_target: Share of transfers in which the side information must arrive, if any candidate gets there.
        progress: Called with the share of the work that is done.

    Raises:
        InvalidValueError: If a number is out of range, or nothing keeps to the limit on protection.
    """
    check_request(offers, budget_bytes, most_protection, trials, drawn)
    report = progress or (lambda _: None)
    traces = losses(offers, loss, max(HEAD_TRIALS, trials), seed)
    plans, plain = list[Plan](), list[Plan]()
    for number, offer in enumerate(offers):
        spent = offer.concealment_bytes + offer.preview_bytes
        search = Search(offer.left(budget_bytes), most_protection, head_target, spent)
        first = [] if traces.all() else list(plain_candidates(offer.load, traces, search).values())
        tried = candidates(offer.load, traces, search)
        for done, candidate in enumerate([*tried, *first]):
            plan = _judge(offer, number, candidate, traces[:trials], budget_bytes)
            if search.allows(plan.sizes):
                (plans if done < len(tried) else plain).append(plan)
            report(0.7 * (number + (done + 1) / (len(tried) + len(first))) / len(offers))
    if not plans and not plain:
        raise InvalidValueError(f"no plan keeps protection below {most_protection:.1%} of all bytes")
    plans, plain = (
        [_judge(offers[plan.offer], plan.offer, plan.protection, traces, budget_bytes) for plan in chosen]
        for chosen in (_leaders(plans, SHORT_LIST), plain)
    )
    finalists = _finalists(plans, plain, head_target)
    fresh = losses(offers, loss, min(FINAL_TRIALS, max(MOST_FATES // traces.shape[1], trials)), seed + 1)
    scored = []
    for plan in finalists:
        found = _scored(offers[plan.offer], plan, fresh, budget_bytes, drawn)
        scored.append(replace(found, plain=plan in plain))
        report(0.7 + 0.3 * len(scored) / len(finalists))
    whole = max(float(offer.damage.psnr(np.zeros((1, offer.load.num_tiers)))[0]) for offer in offers)
    return _best(scored, whole)


def check_request(offers: Sequence[Offer], budget_bytes: float | int, most_protection: float, *trials: int) -> None:
    """Refuses to plan nothing, for nothing, or by no trials.

    Raises:
        InvalidValueError: If a number is out of range.
    """
    if not (offers and budget_bytes > 0 and min(trials) > 0 and 0 < most_protection <= 1):
        raise InvalidValueError(
            f"no plan for {len(offers)} streams, {budget_bytes} bytes, {' and '.join(map(str, trials))} trials and at "
            f"most {most_protection:.1%} of protection"
        )


def losses(offers: Sequence[Offer], loss: LossModel, trials: int, seed: int) -> np.ndarray:
    """Simulated fates of more datagrams than any pass has, bool (trials, n)."""
    bare = [len(outline_transfer(offer.load, Protection(side_repair=0.0)).kind) for offer in offers]
    head = max(largest_head(offer.load) for offer in offers)
    return draw_losses(loss, trials, 3 * max(bare) + 3 * head // FINE_SYMBOL_BYTES, seed)


def _judge(offer: Offer, number: int, protection: Protection, traces: np.ndarray, budget_bytes: float | int) -> Plan:
    """What the damage curves say of a protection."""
    outline, budget = outline_transfer(offer.load, protection), offer.left(budget_bytes)
    arrival = arrival_within(outline, traces, budget)
    lost = lost_shares(offer.load, arrival.packets)
    psnr = np.where(arrival.head, offer.damage.psnr(lost), offer.blank_psnr)
    sent = int(outline.num_bytes[: outline.sent_within(budget)].sum()) + offer.preview_bytes
    mean_lost = tuple(float(share) for share in lost.mean(axis=0))
    return Plan(
        protection, number, float(psnr.mean()), float(arrival.head.mean()), mean_lost, outline.bytes_by_kind(), sent,
        offer.concealment_bytes + offer.preview_bytes,
    )  # fmt: skip


def _leaders(plans: Sequence[Plan], count: int) -> list[Plan]:
    return sorted(plans, key=lambda plan: (-plan.psnr, -plan.protection_bytes))[:count]


def _finalists(plans: Sequence[Plan], plain: Sequence[Plan], head_target: float) -> list[Plan]:
    """The best, and plain ones near them; among those whose side information arrives often enough, if there are any.

    Often enough as far as simulated transfers tell: within a standard error of the target.
    """
    enough = head_target - math.sqrt(head_target * (1 - head_target) / HEAD_TRIALS)
    everything = [*plans, *plain]
    safe = [plan for plan in everything if plan.head_arrives >= enough] or everything
    best = _leaders(safe, FINALISTS)
    return best + [plan for plan in plain if plan in safe and plan not in best and plan.psnr > best[0].psnr - NEAR_DB]


@dataclass(frozen=True)
class _Scored:
    """A plan that pictures have judged.

    Attributes:
        plan: It, with what is expected now.
        partly: Share of its transfers that deliver neither everything nor nothing.
        error: Standard error of what is expected, as far as it is due to the few transfers that were drawn, decibels.
        plain: Whether it is what anybody would try first.
    """

    plan: Plan
    partly: float
    error: float = 0.0
    plain: bool = False


def _scored(offer: Offer, plan: Plan, traces: np.ndarray, budget_bytes: float | int, drawn: int) -> _Scored:
    """Judges a plan by other transfers than those that it was chosen by."""
    arrival = arrival_within(outline_transfer(offer.load, plan.protection), traces, offer.left(budget_bytes))
    found = expected(offer, arrival, drawn)
    judged = replace(plan, psnr=found.psnr, head_arrives=float(arrival.head.mean()), lost=found.lost)
    return _Scored(judged, found.partly, found.error)


@dataclass(frozen=True)
class Expected:
    """What is expected of transfers.

    Attributes:
        psnr: Mean, decibels.
        lost: Mean share of each tier's anchors that is lost.
        partly: Share of the transfers that deliver neither everything nor nothing.
        error: Standard error of `psnr` as far as it is due to the few transfers that were drawn, decibels.
    """

    psnr: float
    lost: tuple[float, ...]
    partly: float
    error: float


def expected(offer: Offer, arrival: Deliveries, drawn: int) -> Expected:
    """Judges what transfers deliver by damage curves, and corrects what these say by pictures.

    Transfers that deliver everything or nothing are counted. The curves judge the others, pictures a few of them,
    spread evenly from the worst to the best: what these show beyond what the curves say of the same transfers is added
    to the curves' mean. Drawn blindly, a rare failure of a code among the few would weigh as if it were frequent.

    Args:
        offer: The stream.
        arrival: What arrives.
        drawn: Transfers that are drawn, if the offer has pictures.
    """
    everything, lost = arrival.head & arrival.packets.all(axis=1), lost_shares(offer.load, arrival.packets)
    curves = np.where(arrival.head, offer.damage.psnr(lost), offer.blank_psnr)
    parts, error = np.flatnonzero(arrival.head & ~everything), 0.0
    partly = len(parts) / len(curves)
    if offer.picture is not None and everything.any():
        curves[everything] = offer.picture(np.ones_like(arrival.packets[0]))
    if offer.picture is not None and len(parts):
        ranked = parts[np.argsort(curves[parts], kind="stable")]
        chosen = ranked[((np.arange(drawn) + 0.5) / drawn * len(ranked)).astype(np.int64)]
        beyond = np.array([offer.picture(arrival.packets[trial]) - curves[trial] for trial in chosen])
        curves[parts] += beyond.mean()
        error = float(beyond.std()) / math.sqrt(len(chosen)) * partly
    return Expected(float(curves.mean()), tuple(float(share) for share in lost.mean(axis=0)), partly, error)


def _best(scored: Sequence[_Scored], whole_psnr: float) -> Plan:
    """The best; a plain way instead where it is nearly as good, of the first stream that has one."""
    top = max(scored, key=lambda found: found.plan.psnr)
    lost = max(whole_psnr - top.plan.psnr, 0.0)
    plain = [found for found in scored if found.plain and found.plan.psnr >= top.plan.psnr - _margin(found, top, lost)]
    if plain:
        first = min(found.plan.offer for found in plain)
        scored = [found for found in plain if found.plan.offer == first]
    least = max(found.plan.psnr for found in scored) - ALIKE_DB
    return max((found.plan for found in scored if found.plan.psnr >= least), key=lambda plan: plan.protection_bytes)


def _margin(one: _Scored, other: _Scored, lost_db: float) -> float:
    prudent = max(PRUDENT_DB, PRUDENT_SHARE * lost_db) * max(one.partly, other.partly)
    return ALIKE_DB + max(prudent, math.hypot(one.error, other.error))
