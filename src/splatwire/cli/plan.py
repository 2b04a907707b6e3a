"""`splatwire plan`: where redundancy pays for a given channel and budget."""

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from splatwire.cli._datagrams import in_datagrams
from splatwire.cli._files import input_path
from splatwire.cli._output import print_json, progress_bars
from splatwire.cli._plan_options import PlanOptions
from splatwire.errors import InvalidValueError
from splatwire.files.whole import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from splatwire.channel import LossModel
    from splatwire.model.appearance import Partial
    from splatwire.packets import SceneStream
    from splatwire.plan.damage import Offer
    from splatwire.plan.planner import Plan
    from splatwire.scene import Cameras


@dataclass(frozen=True)
class PlanCommand(PlanOptions):
    """Split a budget of bytes between side information, tiers of importance and nothing, for `serve --plan`."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.channel import parse_loss
        from splatwire.plan.outline import outline_transfer
        from splatwire.plan.plan_file import plan_content
        from splatwire.transport.protection import Protection

        self.check()
        loss = parse_loss(self.loss)
        streams = [_read(path) for path in self.streams]
        if any(stream.manifest.schema.timed for stream in streams):
            self._plan_clips(streams, loss)
            return
        if self.reference is not None:
            raise InvalidValueError("--reference is for clips: a still scene is compared with --data")
        with progress_bars() as report:
            offers = [self._offer(stream, lambda share: report("measuring damage", share)) for stream in streams]
            bare = [outline_transfer(offer.load, Protection(side_repair=0.0)) for offer in offers]
            plain = min(int(outline.num_bytes.sum()) for outline in bare)
            budget = self.budget_bytes(plain)
            plan = self._plan(offers, loss, budget, lambda share: report("planning", share))
        path, stream = self.streams[plan.offer], streams[plan.offer]
        facts = {**asdict(plan), "protection_share": plan.protection_share, "loss": loss.name,
                 "budget_bytes": budget, "plain_bytes": plain, "stream": path}  # fmt: skip
        content = plan_content(plan.protection, stream.manifest.stream_id, facts)
        self._tell(content, path, lambda how: _print_plan(plan, stream.manifest.elements, how))

    def _plan_clips(self, streams: "Sequence[SceneStream]", loss: "LossModel") -> None:
        from splatwire.cli._clip_plan import facts_of, plan_clips, print_clip_plan
        from splatwire.plan.plan_file import plan_content

        if not all(stream.manifest.schema.timed for stream in streams):
            raise InvalidValueError("a clip and a still scene do not compete: plan for one of them")
        with progress_bars() as report:
            plan = plan_clips(self, streams, loss, report)
        path, stream = self.streams[plan.offer], streams[plan.offer]
        content = plan_content(plan.protection, stream.manifest.stream_id, facts_of(plan, loss, path))
        self._tell(content, path, lambda how: print_clip_plan(plan, how))

    def _tell(self, content: "dict[str, Any]", path: str, show: "Callable[[str], None]") -> None:
        """Writes and prints a plan for a stream."""
        if self.output is not None:
            write_whole(self.output, (json.dumps(content, indent=1) + "\n").encode())
        if self.json:
            print_json(content)
        else:
            show(f"splatwire serve {path} --plan {self.output or 'FILE (-o FILE writes it)'}")

    def _plan(
        self, offers: "list[Offer]", loss: "LossModel", budget: float, progress: "Callable[[float], None]"
    ) -> "Plan":
        from splatwire.plan.planner import plan_protection
        from splatwire.plan.way_back import plan_resending

        if self.way_back:
            return plan_resending(
                offers, loss, budget_bytes=budget, most_protection=self.most_protection, drawn=self.drawn,
                seed=self.seed, progress=progress,
            )  # fmt: skip
        return plan_protection(
            offers, loss, budget_bytes=budget, trials=self.num_trials, drawn=self.drawn, seed=self.seed,
            most_protection=self.most_protection, progress=progress,
        )  # fmt: skip

    def _offer(self, stream: "SceneStream", progress: "Callable[[float], None]") -> "Offer":
        from splatwire.codec import decode_stream
        from splatwire.conceal.sketch import SECTION
        from splatwire.packets.sections import sections_of
        from splatwire.plan.measure import LossyPictures, offer_of

        complete, sketch = (
            decode_stream(stream),
            sections_of(stream).get(SECTION, b""),
        )
        pictures = LossyPictures(complete, self._cameras(complete), "sketch" if sketch else self.conceal or "grow")
        return offer_of(stream, pictures, concealment_bytes=len(sketch), seed=self.seed, progress=progress)

    def _cameras(self, complete: "Partial") -> "Cameras":
        from splatwire.evaluate.views import spread
        from splatwire.render.importance import surrounding_cameras

        if self.data is None:
            cameras = surrounding_cameras(complete.scene)
        else:
            from splatwire.data import open_dataset

            cameras = open_dataset(self.data, split="train").cameras
        return cameras.select(spread(cameras.num_views, self.num_views))


def _read(path: str) -> "SceneStream":
    from splatwire.packets import read_stream

    with input_path(path) as file:
        stream = read_stream(file)[0]
    if len(stream.packets) != stream.manifest.num_packets:
        raise InvalidValueError(f"only {len(stream.packets)} of {stream.manifest.num_packets} packets are there")
    return in_datagrams(stream, path)


def _print_plan(plan: "Plan", elements: str, how: str) -> None:
    lost = ", ".join(f"{share:.1%}" for share in plan.lost)
    print(f"expected {plan.psnr:.2f} dB; side information arrives in {plan.head_arrives:.1%} of transfers")
    print(f"{elements} lost, tier by tier: {lost}")
    print(f"protection {plan.protection_share:.1%} of all bytes; {plan.sent_bytes:,} bytes sent within the budget")
    print(how)
