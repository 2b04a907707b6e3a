"""`splatwire plan` of clips."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.cli._output import refuse_options
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.channel import LossModel
    from splatwire.cli._plan_options import PlanOptions
    from splatwire.clips.damage import Pictures
    from splatwire.clips.planning import ClipOffer, ClipPlan
    from splatwire.codec.schemas.tracks.side_info import Timeline
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras

Report = Callable[[str, float], None]
VIEWS, VIEW_SIZE = 3, 256
ASSUMED_PSNR = 45.0
"""Of the finest stream where nobody has the frames that it was made of."""
_STILL = ("data", "way_back", "most_protection", "drawn")
"""Options that a clip has no use for."""


def plan_clips(
    options: "PlanOptions", streams: "Sequence[SceneStream]", loss: "LossModel", report: Report
) -> "ClipPlan":
    """Plans parity for the motion of clips.

    Raises:
        InvalidValueError: If an option is for still scenes, the clips are not of the same frames, or none fits.
    """
    from splatwire.clips.planning import plan_clip
    from splatwire.codec.schemas.tracks.side_info import open_side_info

    refuse_options(options, _STILL, "is for a still scene, not for a clip")
    times = [open_side_info(stream.manifest, stream.side_info).timeline for stream in streams]
    if any(time != times[0] for time in times):
        raise InvalidValueError("clips that compete have the same frames, in the same groups")
    offers = _offers(options, streams, report)
    smallest = min(offer.load.num_bytes for offer in offers)
    return plan_clip(
        offers, loss, budget_bytes=math.inf if options.deadline else options.budget_bytes(smallest),
        group_bytes=_of_groups(options, times[0]), trials=options.num_trials, seed=options.seed,
        progress=lambda share: report("planning", share),
    )  # fmt: skip


def facts_of(plan: "ClipPlan", loss: "LossModel", path: str) -> dict[str, Any]:
    """What a person may want to know of a plan."""
    return {**asdict(plan), "loss": loss.name, "stream": path}


def print_clip_plan(plan: "ClipPlan", how: str) -> None:
    """Prints a plan on standard output."""
    print(f"expected {plan.psnr:.2f} dB, without parity {plan.unprotected:.2f} dB")
    for group, ((share, repair), lost) in enumerate(zip(plan.protection.motion, plan.lost, strict=True)):
        print(f"group {group}: parity {repair:.0%} for {share:.0%} of the motion, of which {lost:.1%} is lost")
    print(f"parity {plan.parity_bytes / plan.sent_bytes:.1%} of {plan.sent_bytes:,} bytes")
    print(how)


def _of_groups(options: "PlanOptions", timeline: "Timeline") -> list[float] | None:
    """Bytes that leave until the deadline of each group; a deadline is none for the whole clip."""
    if options.deadline is None or options.rate is None:
        return None
    return [options.deadline * options.rate * 1e6 / 8] * timeline.num_groups


def _offers(options: "PlanOptions", streams: "Sequence[SceneStream]", report: Report) -> "list[ClipOffer]":
    from splatwire.clips import frame_files
    from splatwire.clips.concealers import DEFAULT, clip_concealer
    from splatwire.clips.damage import draw, measure_clip_damage, pooled
    from splatwire.clips.delivery import ClipLoad
    from splatwire.clips.planning import ClipOffer
    from splatwire.clips.worth import worth_of_stream
    from splatwire.codec import decode_stream

    method = clip_concealer(options.conceal or DEFAULT)
    finest = decode_stream(max(streams, key=lambda stream: stream.num_bytes)).scene
    cameras = _cameras(finest.bases(), options.views)
    if options.reference is not None:
        references, floor = frames_of(frame_files(options.reference), finest.timeline, cameras), 0.0
    else:
        references, floor = draw(finest, method, cameras), 10 ** (-ASSUMED_PSNR / 10)
    loads, damages = [], []
    for number, stream in enumerate(streams):

        def told(share: float, number: int = number) -> None:
            report("measuring damage", (number + share) / len(streams))

        load = ClipLoad.of(stream, worth_of_stream(stream))
        loads.append(load)
        damages.append(
            measure_clip_damage(stream, load, method, cameras, references, floor, seed=options.seed, progress=told)
        )
    return [ClipOffer(load, damage) for load, damage in zip(loads, pooled(damages), strict=True)]


def _cameras(bases: Any, views: int | None) -> "Cameras":
    from splatwire.render.importance import surrounding_cameras

    return surrounding_cameras(bases, VIEWS if views is None else views, VIEW_SIZE)


def frames_of(files: list[Path], timeline: "Timeline", cameras: "Cameras") -> "Pictures":
    """Pictures of the sampled ones of the frames that a clip was made of.

    Raises:
        InvalidValueError: If there are not as many as the clip has.
    """
    import numpy as np

    from splatwire.clips import read_frames
    from splatwire.clips.damage import sampled
    from splatwire.render import iterate_views

    if len(files) != timeline.num_frames:
        raise InvalidValueError(f"the clip has {timeline.num_frames} frames, its reference has {len(files)}")
    wanted = [timeline.frames_of(group)[n] for group, some in enumerate(sampled(timeline)) for n in some]
    found = []
    for frame in read_frames([files[number] for number in wanted]):
        scene = frame.scene()
        found.append(np.stack(list(iterate_views(scene, cameras))))
    return found
