"""Implementation of `splatwire plan`: chooses redundancy for a given channel and byte budget."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from splatwire.bitstream import SceneStream, read_stream
from splatwire.channel import LossModel, parse_loss
from splatwire.cli._datagrams import in_datagrams
from splatwire.cli._files import STANDARD, check_inputs, input_path, prepared_output, refuse_own_input
from splatwire.cli._output import print_json, progress_bars, refuse_options
from splatwire.cli.plan import PlanCommand
from splatwire.data import open_dataset
from splatwire.errors import InvalidValueError
from splatwire.files.atomic_write import atomic_write
from splatwire.planning.distortion import StreamVariant
from splatwire.planning.feedback import plan_retransmission
from splatwire.planning.measure import ASSUMED_BASE_MSE, measured_variant
from splatwire.planning.plan_file import plan_content
from splatwire.planning.planner import ScenePlan, plan_protection
from splatwire.planning.sequence.planner import SequencePlan, plan_sequence
from splatwire.planning.sequence.variants import ASSUMED_PSNR, common_timeline, sequence_variants
from splatwire.planning.transfer_model import model_transfer
from splatwire.transport.protocol.protection import Protection

_BUDGET, _TRIALS, _VIEWS = 1.3, 100, 7
_STILL = ("data", "feedback", "most_protection", "drawn")
"""Options that apply only to static scenes."""


def run(command: PlanCommand) -> None:
    """Runs `splatwire plan`: chooses the redundancy for a transfer and writes the plan."""
    _check(command)
    loss = parse_loss(command.loss)
    streams = [_read(path) for path in command.streams]
    if any(stream.manifest.schema.timed for stream in streams):
        _plan_sequences(command, streams, loss)
        return
    if command.reference is not None:
        raise InvalidValueError("--reference is for clips: a still scene is compared with itself, without losses")
    cameras = None if command.data is None else open_dataset(command.data, split="train").cameras
    with progress_bars() as report:
        offers = [
            measured_variant(
                stream, cameras=cameras, num_views=_num_views(command), concealer=command.conceal, seed=command.seed,
                progress=lambda share: report("measuring damage", share),
            )
            for stream in streams
        ]  # fmt: skip
        bare = [model_transfer(offer.load, Protection(init_repair=0.0)) for offer in offers]
        plain = min(int(outline.num_bytes.sum()) for outline in bare)
        budget = _budget_bytes(command, plain)
        plan = _plan(command, offers, loss, budget, lambda share: report("planning", share))
    path, stream = command.streams[plan.variant], streams[plan.variant]
    facts = {**asdict(plan), "protection_share": plan.protection_share, "loss": loss.name,
             "budget_bytes": budget, "plain_bytes": plain, "stream": path}  # fmt: skip
    content = plan_content(plan.protection, stream.manifest.stream_id, facts)
    _print_result(command, content, path, lambda how: _print_plan(plan, stream.manifest.elements, how))


def _plan_sequences(command: PlanCommand, streams: Sequence[SceneStream], loss: LossModel) -> None:
    if not all(stream.manifest.schema.timed for stream in streams):
        raise InvalidValueError("a plan cannot compare a clip with a still scene: give streams of one kind")
    refuse_options(command, _STILL, "is for a still scene, not for a clip")
    timeline = common_timeline(streams)
    with progress_bars() as report:
        variants = sequence_variants(
            streams, command.reference, concealer=command.conceal, views=command.views, seed=command.seed,
            progress=lambda share: report("measuring damage", share),
        )  # fmt: skip
        smallest, limited = min(variant.load.num_bytes for variant in variants), command.deadline is not None
        budget = _budget_bytes(command, smallest)
        plan = plan_sequence(
            variants, loss, budget_bytes=math.inf if limited else budget,
            group_bytes=[budget] * timeline.num_groups if limited else None, trials=_num_trials(command),
            seed=command.seed, progress=lambda share: report("planning", share),
        )  # fmt: skip
    path, stream = command.streams[plan.variant], streams[plan.variant]
    facts = {**asdict(plan), "loss": loss.name, "stream": path}
    content = plan_content(plan.protection, stream.manifest.stream_id, facts)
    _print_result(command, content, path, lambda how: _print_sequence_plan(command, plan, how))


def _check(command: PlanCommand) -> None:
    """Checks the options of the subcommand `plan` before files are read."""
    if not command.streams:
        raise InvalidValueError("name at least one stream to plan for")
    if command.output is not None:
        if str(command.output) == STANDARD:
            raise InvalidValueError("a plan is a file: give -o a name, or --json without -o for standard output")
        prepared_output(command.output)
        refuse_own_input(command.output, *command.streams)
    check_inputs(command.data, command.reference)
    if (command.deadline is None) != (command.rate is None) or (
        command.deadline is not None and command.budget is not None
    ):
        raise InvalidValueError("give --budget, or --deadline and --rate together")
    above = {"--budget": command.budget, "--deadline": command.deadline, "--rate": command.rate}
    for name, value in above.items():
        if value is not None and not 0 < value < math.inf:
            raise InvalidValueError(f"{name} must be above 0, not {value:g}")
    if min(_num_views(command), command.drawn, _num_trials(command)) < 1:
        raise InvalidValueError("--views, --trials and --drawn are at least 1")
    if not 0 < command.most_protection <= 1:
        raise InvalidValueError(f"--most-protection is above 0 and at most 1, not {command.most_protection:g}")
    if command.feedback and command.trials is not None:
        raise InvalidValueError("--trials has no effect with --feedback, which simulates no transfers")
    if command.seed < 0:
        raise InvalidValueError(f"--seed is 0 or more, not {command.seed}")


def _num_trials(command: PlanCommand) -> int:
    return _TRIALS if command.trials is None else command.trials


def _num_views(command: PlanCommand) -> int:
    return _VIEWS if command.views is None else command.views


def _budget_bytes(command: PlanCommand, stream_bytes: int) -> float:
    """Returns the maximum number of bytes to send, given the stream size `stream_bytes` without protection."""
    if command.deadline is None or command.rate is None:
        return (_BUDGET if command.budget is None else command.budget) * stream_bytes
    return command.deadline * command.rate * 1e6 / 8


def _print_result(command: PlanCommand, content: dict[str, Any], path: str, show: Callable[[str], None]) -> None:
    """Writes the plan for a stream to a file and prints a summary."""
    if command.output is not None:
        atomic_write(command.output, (json.dumps(content, indent=1) + "\n").encode())
    if command.json:
        print_json(content)
    else:
        show(f"splatwire serve {path} --plan {command.output or 'FILE (-o FILE writes it)'}")


def _plan(
    command: PlanCommand,
    offers: list[StreamVariant],
    loss: LossModel,
    budget: float,
    progress: Callable[[float], None],
) -> ScenePlan:
    if command.feedback:
        return plan_retransmission(
            offers, loss, budget_bytes=budget, max_protection=command.most_protection, rendered_trials=command.drawn,
            seed=command.seed, progress=progress,
        )  # fmt: skip
    return plan_protection(
        offers, loss, budget_bytes=budget, trials=_num_trials(command), rendered_trials=command.drawn,
        seed=command.seed, max_protection=command.most_protection, progress=progress,
    )  # fmt: skip


def _read(path: str) -> SceneStream:
    with input_path(path) as file:
        stream = read_stream(file)[0]
    if len(stream.packets) != stream.manifest.num_packets:
        total = stream.manifest.num_packets
        raise InvalidValueError(f"{path}: only {len(stream.packets)} of {total} packets are there")
    if not stream.manifest.schema.timed:
        stream.require_static(path)
    return in_datagrams(stream, path)


def _print_plan(plan: ScenePlan, elements: str, how: str) -> None:
    lost = ", ".join(f"{share:.1%}" for share in plan.lost)
    complete = -10 * math.log10(ASSUMED_BASE_MSE)
    print(f"expected {plan.psnr:.2f} dB, if the complete scene has {complete:.0f} dB")
    print(f"side information arrives in {plan.head_arrives:.1%} of transfers")
    print(f"{elements} lost, tier by tier: {lost}")
    print(f"protection {plan.protection_share:.1%} of all bytes; {plan.sent_bytes:,} bytes sent within the budget")
    print(how)


def _print_sequence_plan(command: PlanCommand, plan: SequencePlan, how: str) -> None:
    assumed = f", if the finest stream has {ASSUMED_PSNR:.0f} dB" if command.reference is None else ""
    print(f"expected {plan.psnr:.2f} dB, without parity {plan.unprotected:.2f} dB{assumed}")
    for group, ((share, repair), lost) in enumerate(zip(plan.protection.motion, plan.lost, strict=True)):
        print(f"group {group}: parity {repair:.0%} for {share:.0%} of the motion, of which {lost:.1%} is lost")
    print(f"parity {plan.parity_bytes / plan.sent_bytes:.1%} of {plan.sent_bytes:,} bytes")
    print(how)
