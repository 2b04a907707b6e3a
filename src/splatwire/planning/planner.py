"""Planner for static scenes: distributes a budget of redundancy over side information and importance tiers.

It simulates transfers with many settings and keeps the one with the best pictures. A transfer ends when the budget of
bytes is spent, so a budget can also express a deadline at a given rate.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.arguments import checked
from splatwire.channel import LossModel
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.planning.candidates import (
    FINE_SYMBOL_BYTES,
    PlanConstraints,
    arrival_within,
    baseline_candidates,
    candidates,
    max_init_segment_bytes,
)
from splatwire.planning.distortion import StreamVariant, lost_fractions
from splatwire.planning.plan_file import Plan
from splatwire.planning.transfer_model import SimulatedTransfers, draw_losses, model_transfer
from splatwire.transport.protocol.protection import Protection

HEAD_TRIALS = 1000
MAX_TRIALS = 1_000_000
FINAL_TRIALS = 4000
"""Number of simulated transfers in the final comparison. A failure rate of 0.2 % costs 0.04 dB, and a thousand
transfers cannot distinguish it from 0.6 %.
"""
MAX_SIMULATED_DATAGRAMS = 200_000_000
"""Maximum number of simulated datagrams in memory, one byte each; for long streams, fewer final transfers are
simulated."""
SHORT_LIST = 16
"""Number of plans evaluated with all simulated transfers. Side information that fails in 1 % of transfers costs 0.25
dB, which a hundred transfers do not show.
"""
FINALISTS = 4
NEAR_DB = 4.0
"""Maximum gap in dB, by the distortion model, at which baselines are still rendered. If the budget truncates a
transfer, the PSNR of the model is up to 3 dB too low for a stream without tiers, in which half of the packets are lost
but concealed well.
"""
EQUAL_DB = 0.002
"""Difference in dB below which plans are considered equal, and the plan with more redundancy is chosen. The budget is
available anyway, and
simulations underestimate rare losses.
"""
MIN_GAIN_DB = 0.05
"""Minimum gain over a baseline in dB (and at least a standard error of the renderings) if all transfers have losses. A
few views and transfers cannot resolve less. The margin is proportional to the fraction of transfers with partial
losses, because the PSNR of transfers that deliver everything or nothing is exact.
"""
MIN_GAIN_SHARE = 0.06
"""Minimum gain over a baseline as a share of the loss. Losses are most visible in the views that a scene was fitted
to, so small gains there may not generalise.
"""


@dataclass(frozen=True)
class ScenePlan(Plan):
    """Redundancy for a static scene as chosen by the planner, with the expected result.

    Attributes:
        head_arrives: Fraction of transfers in which the side information arrives.
        sizes: Bytes of a complete transfer by purpose, such as packets and parity.
        concealment_bytes: Bytes that serve loss concealment only: part of the side information, and the preview.
    """

    head_arrives: float
    sizes: dict[str, int]
    concealment_bytes: int = 0

    @property
    def protection_bytes(self) -> int:
        """Number of bytes spent on protection from losses: redundancy, and additional data for loss concealment."""
        return self.sizes["init_protection"] + self.sizes["packet_protection"] + self.concealment_bytes

    @property
    def protection_share(self) -> float:
        """Bytes of redundancy as a fraction of all bytes, 0 to 1."""
        return self.protection_bytes / max(sum(self.sizes.values()), 1)


@checked
def plan_protection(
    variants: Sequence[StreamVariant],
    loss: LossModel,
    *,
    budget_bytes: float | int,
    trials: int = 100,
    rendered_trials: int = 6,
    seed: int = 0,
    max_protection: float = 1.0,
    init_segment_target: float = 0.999,
    progress: Callable[[float], None] | None = None,
) -> ScenePlan:
    """Chooses the stream variant and the redundancy with the best expected picture.

    Args:
        variants: Variants of the stream, such as one with importance tiers and one without.
        loss: Loss model of the channel, in datagrams.
        budget_bytes: Maximum bytes sent, datagram headers included. For a deadline: the time until the deadline,
            multiplied by the sending rate.
        trials: Number of transfers to simulate for each setting of redundancy.
        rendered_trials: Number of simulated transfers to render for the best settings.
        seed: Random seed of the simulated losses.
        max_protection: Maximum bytes of redundancy as a fraction of all bytes, 0 to 1.
        init_segment_target: Minimum fraction of transfers in which the side information must arrive.
        progress: Called with the completed fraction.

    Raises:
        InvalidValueError: If a number is out of range, or every setting exceeds `max_protection`.
    """
    check_request(variants, budget_bytes, max_protection, trials, rendered_trials)
    if not 0 < init_segment_target <= 1:
        raise InvalidValueError(f"init_segment_target must be above 0 and at most 1, not {shown(init_segment_target)}")
    report = progress or (lambda _: None)
    traces = draw_transfer_losses(variants, loss, max(HEAD_TRIALS, trials), seed)
    plans, plain = list[ScenePlan](), list[ScenePlan]()
    for number, variant in enumerate(variants):
        spent = variant.concealment_bytes + variant.preview_bytes
        constraints = PlanConstraints(
            variant.budget_after_preview(budget_bytes), max_protection, init_segment_target, spent
        )
        first = [] if traces.all() else list(baseline_candidates(variant.load, traces, constraints).values())
        tried = candidates(variant.load, traces, constraints)
        for done, candidate in enumerate([*tried, *first]):
            plan = _predict_plan(variant, number, candidate, traces[:trials], budget_bytes)
            if constraints.allows(plan.sizes):
                (plans if done < len(tried) else plain).append(plan)
            report(0.7 * (number + (done + 1) / (len(tried) + len(first))) / len(variants))
    if not plans and not plain:
        raise InvalidValueError(f"no plan keeps protection below {max_protection:.1%} of all bytes")
    plans, plain = (
        [_predict_plan(variants[plan.variant], plan.variant, plan.protection, traces, budget_bytes) for plan in chosen]
        for chosen in (_leaders(plans, SHORT_LIST), plain)
    )
    finalists = _finalists(plans, plain, init_segment_target)
    new_traces = draw_transfer_losses(
        variants, loss, min(FINAL_TRIALS, max(MAX_SIMULATED_DATAGRAMS // traces.shape[1], trials)), seed + 1
    )
    scored = []
    for plan in finalists:
        evaluated = _evaluate_plan(variants[plan.variant], plan, new_traces, budget_bytes, rendered_trials)
        scored.append(replace(evaluated, plain=plan in plain))
        report(0.7 + 0.3 * len(scored) / len(finalists))
    whole = max(float(variant.distortion.psnr(np.zeros((1, variant.load.num_tiers)))[0]) for variant in variants)
    return _choose_plan(scored, whole)


def check_request(
    variants: Sequence[StreamVariant], budget_bytes: float | int, max_protection: float, *trials: int
) -> None:
    """Checks the arguments of a planner.

    Args:
        variants: Variants of the stream.
        budget_bytes: Maximum bytes sent.
        max_protection: Maximum share of redundancy.
        *trials: Numbers of simulated or rendered transfers.

    Raises:
        InvalidValueError: If an argument is out of range.
    """
    if not len(variants):
        raise InvalidValueError("variants: there is none to plan for")
    if not 0 < budget_bytes < math.inf:
        raise InvalidValueError(f"budget_bytes must be positive, not {shown(budget_bytes)}")
    if not 0 < max_protection <= 1:
        raise InvalidValueError(f"max_protection must be above 0 and at most 1, not {shown(max_protection)}")
    for number in trials:
        whole_number(number, "trials", 1, MAX_TRIALS)


@checked
def draw_transfer_losses(variants: Sequence[StreamVariant], loss: LossModel, trials: int, seed: int) -> np.ndarray:
    """Draws at random which datagrams are lost in each transfer that a planner simulates.

    All variants of the stream are simulated with the same losses, so that they can be compared.

    Args:
        variants: Variants of the stream.
        loss: Loss model of the channel, in datagrams.
        trials: Number of simulated transfers.
        seed: Random seed.

    Returns:
        Mask of received datagrams for each transfer, bool (trials, n): column i is for the i-th datagram sent. The
        number n is large enough for the largest variant with its repair symbols; a variant that needs fewer datagrams
        uses the first columns.
    """
    if not len(variants):
        raise InvalidValueError("variants: there is none to simulate")
    bare = [len(model_transfer(variant.load, Protection(init_repair=0.0)).kind) for variant in variants]
    most_bytes = max(max_init_segment_bytes(variant.load) for variant in variants)
    return draw_losses(loss, trials, 3 * max(bare) + 3 * most_bytes // FINE_SYMBOL_BYTES, seed)


def _predict_plan(
    variant: StreamVariant, number: int, protection: Protection, traces: np.ndarray, budget_bytes: float | int
) -> ScenePlan:
    """Creates a plan with given redundancy, and predicts its picture quality with the variant's distortion model.

    Args:
        variant: Variant of the stream.
        number: Index of the variant, stored in the plan.
        protection: Redundancy of the plan.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        budget_bytes: Maximum bytes sent, datagram headers included.
    """
    model, budget = model_transfer(variant.load, protection), variant.budget_after_preview(budget_bytes)
    arrival = arrival_within(model, traces, budget)
    lost = lost_fractions(variant.load, arrival.packets)
    psnr = np.where(arrival.side_info, variant.distortion.psnr(lost), variant.blank_psnr)
    sent = int(model.num_bytes[: model.sent_within(budget)].sum()) + variant.preview_bytes
    mean_lost = tuple(float(share) for share in lost.mean(axis=0))
    return ScenePlan(
        protection, number, float(psnr.mean()), mean_lost, sent, float(arrival.side_info.mean()), model.bytes_by_kind(),
        variant.concealment_bytes + variant.preview_bytes,
    )  # fmt: skip


def _leaders(plans: Sequence[ScenePlan], count: int) -> list[ScenePlan]:
    return sorted(plans, key=lambda plan: (-plan.psnr, -plan.protection_bytes))[:count]


def _finalists(
    plans: Sequence[ScenePlan], baselines: Sequence[ScenePlan], init_segment_target: float
) -> list[ScenePlan]:
    """Selects the plans to check by rendering: the best plans, and baselines whose PSNR is nearly as high.

    Args:
        plans: Plans found by the search.
        baselines: Baseline plans with simple redundancy.
        init_segment_target: Minimum fraction of transfers in which the side information must arrive.
    """
    enough = init_segment_target - math.sqrt(init_segment_target * (1 - init_segment_target) / HEAD_TRIALS)
    everything = [*plans, *baselines]
    safe = [plan for plan in everything if plan.head_arrives >= enough] or everything
    best = _leaders(safe, FINALISTS)
    return best + [
        plan for plan in baselines if plan in safe and plan not in best and plan.psnr > best[0].psnr - NEAR_DB
    ]


@dataclass(frozen=True)
class _EvaluatedPlan:
    """A plan, and its quality measured in simulated transfers that were not used to choose the plan.

    Quality measured in the transfers that were used for the choice is too high, because the best of many plans is best
    partly by chance.

    Attributes:
        plan: The plan. Its fields for quality and losses were measured in the transfers that were not used for the
            choice.
        partly: Fraction of the transfers in which the side information arrives, but not all packets do.
        error: Standard error of the PSNR, decibels.
        plain: True if the plan is a simple baseline.
    """

    plan: ScenePlan
    partly: float
    error: float = 0.0
    plain: bool = False


def _evaluate_plan(
    variant: StreamVariant, plan: ScenePlan, traces: np.ndarray, budget_bytes: float | int, rendered_trials: int
) -> _EvaluatedPlan:
    """Measures the quality of a plan in simulated transfers that were not used to choose the plan.

    Args:
        variant: Variant of the stream that the plan uses.
        plan: The plan.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        budget_bytes: Maximum bytes sent, datagram headers included.
        rendered_trials: Number of transfers whose pictures are rendered; the distortion model predicts the others.
    """
    arrival = arrival_within(
        model_transfer(variant.load, plan.protection), traces, variant.budget_after_preview(budget_bytes)
    )
    result = expected_result(variant, arrival, rendered_trials)
    judged = replace(plan, psnr=result.psnr, head_arrives=float(arrival.side_info.mean()), lost=result.lost)
    return _EvaluatedPlan(judged, result.partly, result.error)


@dataclass(frozen=True)
class ExpectedResult:
    """Picture quality and losses, averaged over simulated transfers.

    Attributes:
        psnr: Mean PSNR, decibels.
        lost: Mean lost fraction of each importance tier.
        partly: Fraction of the transfers in which the side information arrives, but not all packets do.
        error: Standard error of `psnr`, decibels.
    """

    psnr: float
    lost: tuple[float, ...]
    partly: float
    error: float


@checked
def expected_result(variant: StreamVariant, arrival: SimulatedTransfers, rendered_trials: int) -> ExpectedResult:
    """Computes picture quality and losses, averaged over simulated transfers of a stream.

    Args:
        variant: The stream, with its distortion model.
        arrival: Received packets of each simulated transfer.
        rendered_trials: Number of transfers whose pictures are rendered; the distortion model predicts the others.
    """
    everything, lost = arrival.side_info & arrival.packets.all(axis=1), lost_fractions(variant.load, arrival.packets)
    curves = np.where(arrival.side_info, variant.distortion.psnr(lost), variant.blank_psnr)
    parts, error = np.flatnonzero(arrival.side_info & ~everything), 0.0
    partly = len(parts) / len(curves)
    if variant.picture is not None and everything.any():
        curves[everything] = variant.picture(np.ones_like(arrival.packets[0]))
    if variant.picture is not None and len(parts):
        # Evenly spaced in the order of PSNR: in a random selection, a rare failure could have too much weight.
        ranked = parts[np.argsort(curves[parts], kind="stable")]
        chosen = ranked[((np.arange(rendered_trials) + 0.5) / rendered_trials * len(ranked)).astype(np.int64)]
        # The mean error of their predictions corrects those of all transfers with partial loss.
        beyond = np.array([variant.picture(arrival.packets[trial]) - curves[trial] for trial in chosen])
        curves[parts] += beyond.mean()
        error = float(beyond.std()) / math.sqrt(len(chosen)) * partly
    return ExpectedResult(float(curves.mean()), tuple(float(share) for share in lost.mean(axis=0)), partly, error)


def _choose_plan(scored: Sequence[_EvaluatedPlan], whole_psnr: float) -> ScenePlan:
    """Selects the plan with the best pictures.

    If the PSNR of a simple baseline is nearly the highest, only baselines are considered. Of the considered plans whose
    PSNR is practically equal to the highest, the one with the most bytes of protection is selected.

    Args:
        scored: Plans with their results.
        whole_psnr: PSNR of a transfer without losses, decibels.
    """
    top = max(scored, key=lambda evaluated: evaluated.plan.psnr)
    lost = max(whole_psnr - top.plan.psnr, 0.0)
    plain = [
        evaluated
        for evaluated in scored
        if evaluated.plain and evaluated.plan.psnr >= top.plan.psnr - _margin(evaluated, top, lost)
    ]
    if plain:
        first = min(evaluated.plan.variant for evaluated in plain)
        scored = [evaluated for evaluated in plain if evaluated.plan.variant == first]
    least = max(evaluated.plan.psnr for evaluated in scored) - EQUAL_DB
    return max(
        (evaluated.plan for evaluated in scored if evaluated.plan.psnr >= least), key=lambda plan: plan.protection_bytes
    )


def _margin(one: _EvaluatedPlan, other: _EvaluatedPlan, lost_db: float) -> float:
    prudent = max(MIN_GAIN_DB, MIN_GAIN_SHARE * lost_db) * max(one.partly, other.partly)
    return EQUAL_DB + max(prudent, math.hypot(one.error, other.error))
