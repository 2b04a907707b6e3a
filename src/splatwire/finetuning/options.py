"""Options of fine-tuning."""

from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.bitstream import PRESETS, Packetization
from splatwire.channel import LossModel
from splatwire.codec.gaussians.quality import QUALITIES, Quality
from splatwire.errors import InvalidValueError


@dataclass(frozen=True)
class FineTuning:
    """Options of fine-tuning explicit Gaussians.

    Attributes:
        quality: Quality setting, which determines the quantisation steps.
        iterations: Number of iterations, each with one view, at least 1.
        rounding_interval: Number of iterations between two computations of the rounding errors.
        packet_loss: Loss model of the channel, used in every second iteration; None for no packet losses.
        packetization: Rule that divides Gaussians into packets, for `packet_loss`.
        rate: Factor on all learning rates, above 0.
        seed: Random seed for the order of the views and for the packet losses, at least 0.

    Raises:
        InvalidValueError: If a value is out of range.
    """

    quality: Quality = QUALITIES["default"]
    iterations: int = 1000
    rounding_interval: int = 10
    packet_loss: LossModel | None = None
    packetization: Packetization = PRESETS["paper"]
    rate: float = 0.4
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("iterations", "rounding_interval"):
            if getattr(self, name) < 1:
                raise InvalidValueError(f"fine-tuning: {name} is at least 1, not {getattr(self, name)}")
        if self.seed < 0 or not 0 < self.rate < 100:
            raise InvalidValueError(f"fine-tuning: seed {self.seed} or rate {self.rate:g} is out of range")
