"""`splatwire plan`: where redundancy pays for a given channel and budget."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from splatwire.cli._files import input_path
from splatwire.cli._output import JsonFlag, print_json, progress_bars
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.model import PartialScene
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.transport.planner import Damage, Plan


@dataclass(frozen=True)
class PlanCommand:
    """Split a budget of bytes between side information, tiers of importance and nothing; prints options for serve."""

    stream: tyro.conf.Positional[str]
    """Complete stream of the preset datagram, best encoded with --tiers; - for standard input."""
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
    conceal: str = "grow"
    """What the receiver does about gaps."""
    data: Path | None = None
    """Photos whose training cameras say what is seen; cameras around the scene if not given."""
    views: int = 4
    """Views that the damage is measured in."""
    trials: int = 100
    """Simulated transfers of each candidate."""
    seed: int = 0
    """Of the simulated losses."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.channel import parse_loss
        from splatwire.codec import decode_stream
        from splatwire.packets import read_stream
        from splatwire.transport.outline import StreamLoad, outline_transfer
        from splatwire.transport.planner import plan_protection
        from splatwire.transport.program import Protection

        loss = parse_loss(self.loss)
        with input_path(self.stream) as path:
            stream, _ = read_stream(path)
        _check(stream)
        load = StreamLoad.of_stream(stream)
        plain = int(outline_transfer(load, Protection(side_repair=0.0)).num_bytes.sum())
        budget = self._budget_bytes(plain)
        with progress_bars() as report:
            complete = decode_stream(stream)
            damage = self._damage(complete, stream, lambda share: report("measuring damage", share))
            plan = plan_protection(
                load, damage, loss, budget_bytes=budget, trials=self.trials, seed=self.seed,
                most_protection=self.most_protection, progress=lambda share: report("planning", share),
            )  # fmt: skip
        content = {**asdict(plan), "protection_share": plan.protection_share, "loss": loss.name,
                   "budget_bytes": budget, "plain_bytes": plain, "options": _options(plan)}  # fmt: skip
        if self.json:
            print_json(content)
        else:
            _print_plan(plan, content)

    def _budget_bytes(self, plain: int) -> float:
        if self.deadline is None:
            return self.budget * plain
        if self.rate is None or not (self.rate > 0 and self.deadline > 0):
            raise InvalidValueError("--deadline needs --rate, and both must be above 0")
        return self.deadline * self.rate * 1e6 / 8

    def _damage(self, complete: "PartialScene", stream: "SceneStream", progress: Any) -> "Damage":
        import torch

        from splatwire.codec.sections import split_sections
        from splatwire.codec.tiers import read_tiers
        from splatwire.evaluate.damage import measure_damage

        tiers = torch.from_numpy(read_tiers(split_sections(stream.side_info)[1], stream.manifest))
        return measure_damage(
            complete, tiers, self._cameras(complete), concealer=self.conceal, seed=self.seed, progress=progress
        )

    def _cameras(self, complete: "PartialScene") -> "Cameras":
        from splatwire.evaluate.views import spread
        from splatwire.render.importance import surrounding_cameras

        if self.data is None:
            cameras = surrounding_cameras(complete.scene.anchors)
        else:
            from splatwire.data import open_dataset

            cameras = open_dataset(self.data, split="train").cameras
        return cameras.select(spread(cameras.num_views, self.views))


def _check(stream: "SceneStream") -> None:
    if not stream.manifest.packetization.hashed:
        raise InvalidValueError("a plan is for datagrams: encode the scene with --preset datagram")
    if len(stream.packets) != stream.manifest.num_packets:
        raise InvalidValueError(f"only {len(stream.packets)} of {stream.manifest.num_packets} packets are there")


def _options(plan: "Plan") -> str:
    """The plan as options of `splatwire serve`."""
    protection = plan.protection
    words = [f"--side-repair {protection.side_repair:.3f}", f"--side-lead {protection.side_lead:g}"]
    if protection.side_symbol_bytes is not None:
        words.append(f"--side-symbol {protection.side_symbol_bytes}")
    tiers = [f"tier{tier}={repair:.3f}" for tier, repair in enumerate(protection.tier_repair) if repair]
    return " ".join(words + (["--protect", *tiers] if tiers else []))


def _print_plan(plan: "Plan", content: dict[str, Any]) -> None:
    lost = ", ".join(f"{share:.1%}" for share in plan.lost)
    print(f"expected {plan.psnr:.2f} dB; side information arrives in {plan.head_arrives:.1%} of transfers")
    print(f"anchors lost, tier by tier: {lost}")
    print(f"protection {plan.protection_share:.1%} of all bytes; {plan.sent_bytes:,} bytes sent within the budget")
    print(f"splatwire serve STREAM {content['options']}")
