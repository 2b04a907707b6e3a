"""`splatwire plan`: where redundancy pays for a given channel and budget."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from splatwire.cli._files import input_path
from splatwire.cli._output import JsonFlag, print_json, progress_bars
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Callable

    from splatwire.channel import LossModel
    from splatwire.model import PartialScene
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.transport.damage import Offer
    from splatwire.transport.planner import Plan


@dataclass(frozen=True)
class PlanCommand:
    """Split a budget of bytes between side information, tiers of importance and nothing; prints options for serve."""

    streams: tyro.conf.Positional[list[str]]
    """Complete stream of the preset datagram, best encoded with --tiers; - for standard input. Several streams of one
    scene compete: without tiers, with tiers, with a sketch."""
    loss: str = "bernoulli:0.2"
    """Channel, in datagrams: bernoulli:RATE, gilbert:RATE,BURST, ..."""
    budget: float = 1.3
    """Bytes that may be sent, as a multiple of the stream without any protection."""
    deadline: float | None = None
    """Instead of --budget: seconds until nothing more counts; needs --rate."""
    rate: float | None = None
    """With --deadline: megabits per second."""
    most_protection: float = 1.0
    """Most protection as a share of all bytes: 0.08 for 8 %."""
    way_back: bool = False
    """The receiver can ask for what it lacks: nothing is sent ahead, and the plan says which packets are sent again."""
    conceal: str = "grow"
    """What the receiver does about gaps; a stream that carries a sketch is concealed by it."""
    data: Path | None = None
    """Photos whose training cameras say what is seen; cameras around the scene if not given."""
    views: int = 7
    """Views that the damage is measured in; few tell too little of what is seen from elsewhere."""
    trials: int = 100
    """Simulated transfers of each candidate."""
    drawn: int = 6
    """Simulated transfers whose pictures decide between the best candidates."""
    seed: int = 0
    """Of the simulated losses."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.channel import parse_loss
        from splatwire.transport.outline import outline_transfer
        from splatwire.transport.protection import Protection

        if not self.streams:
            raise InvalidValueError("name at least one stream to plan for")
        loss = parse_loss(self.loss)
        streams = [_read(path) for path in self.streams]
        with progress_bars() as report:
            offers = [self._offer(stream, lambda share: report("measuring damage", share)) for stream in streams]
            bare = [outline_transfer(offer.load, Protection(side_repair=0.0)) for offer in offers]
            plain = min(int(outline.num_bytes.sum()) for outline in bare)
            budget = self._budget_bytes(plain)
            plan = self._plan(offers, loss, budget, lambda share: report("planning", share))
        content = {**asdict(plan), "protection_share": plan.protection_share, "loss": loss.name,
                   "budget_bytes": budget, "plain_bytes": plain, "stream": self.streams[plan.offer],
                   "options": _options(plan)}  # fmt: skip
        if self.json:
            print_json(content)
        else:
            _print_plan(plan, content)

    def _plan(
        self, offers: "list[Offer]", loss: "LossModel", budget: float, progress: "Callable[[float], None]"
    ) -> "Plan":
        from splatwire.transport.planner import plan_protection
        from splatwire.transport.way_back import plan_resending

        if self.way_back:
            return plan_resending(
                offers, loss, budget_bytes=budget, most_protection=self.most_protection, drawn=self.drawn,
                seed=self.seed, progress=progress,
            )  # fmt: skip
        return plan_protection(
            offers, loss, budget_bytes=budget, trials=self.trials, drawn=self.drawn, seed=self.seed,
            most_protection=self.most_protection, progress=progress,
        )  # fmt: skip

    def _budget_bytes(self, plain: int) -> float:
        if self.deadline is None:
            return self.budget * plain
        if self.rate is None or not (self.rate > 0 and self.deadline > 0):
            raise InvalidValueError("--deadline needs --rate, and both must be above 0")
        return self.deadline * self.rate * 1e6 / 8

    def _offer(self, stream: "SceneStream", progress: "Callable[[float], None]") -> "Offer":
        from splatwire.codec import decode_stream
        from splatwire.codec.sections import split_sections
        from splatwire.conceal.sketch import SECTION
        from splatwire.evaluate.damage import LossyPictures, offer_of

        complete, sketch = decode_stream(stream), split_sections(stream.side_info)[1].get(SECTION, b"")
        pictures = LossyPictures(complete, self._cameras(complete), "sketch" if sketch else self.conceal)
        return offer_of(stream, pictures, concealment_bytes=len(sketch), seed=self.seed, progress=progress)

    def _cameras(self, complete: "PartialScene") -> "Cameras":
        from splatwire.evaluate.views import spread
        from splatwire.render.importance import surrounding_cameras

        if self.data is None:
            cameras = surrounding_cameras(complete.scene.anchors)
        else:
            from splatwire.data import open_dataset

            cameras = open_dataset(self.data, split="train").cameras
        return cameras.select(spread(cameras.num_views, self.views))


def _read(path: str) -> "SceneStream":
    from splatwire.packets import read_stream

    with input_path(path) as file:
        stream, _ = read_stream(file)
    if not stream.manifest.packetization.hashed:
        raise InvalidValueError("a plan is for datagrams: encode the scene with --preset datagram")
    if len(stream.packets) != stream.manifest.num_packets:
        raise InvalidValueError(f"only {len(stream.packets)} of {stream.manifest.num_packets} packets are there")
    return stream


def _options(plan: "Plan") -> str:
    """The plan as options of `splatwire serve`."""
    protection = plan.protection
    words = [f"--side-repair {protection.side_repair:.3f}", f"--side-lead {protection.side_lead:.3g}"]
    if protection.side_symbol_bytes is not None:
        words.append(f"--side-symbol {protection.side_symbol_bytes}")
    if protection.head_share:
        words.append(f"--head-share {protection.head_share:.6g}")
    if protection.tier_spread:
        words.append(f"--tier-spread {protection.tier_spread:.3f}")
    if protection.parity_until < 1:
        words.append(f"--parity-until {protection.parity_until:.3f}")
    if protection.resend is not None:
        words.append(f"--resend {protection.resend:.6g}")
    if protection.resend_until < 1:
        words.append(f"--resend-until {protection.resend_until:.6g}")
    tiers = [f"tier{tier}={repair:.3f}" for tier, repair in enumerate(protection.tier_repair) if repair]
    return " ".join(words + (["--protect", *tiers] if tiers else []))


def _print_plan(plan: "Plan", content: dict[str, Any]) -> None:
    lost = ", ".join(f"{share:.1%}" for share in plan.lost)
    print(f"expected {plan.psnr:.2f} dB; side information arrives in {plan.head_arrives:.1%} of transfers")
    print(f"anchors lost, tier by tier: {lost}")
    print(f"protection {plan.protection_share:.1%} of all bytes; {plan.sent_bytes:,} bytes sent within the budget")
    print(f"splatwire serve {content['stream']} {content['options']}")
