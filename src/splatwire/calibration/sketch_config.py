"""Settings for computing a sketch."""

from dataclasses import dataclass, field

from splatwire.arguments import check_fields
from splatwire.calibration.checks import check_settings
from splatwire.calibration.sketch_fit import SketchFit

MAX_WIDTH = 400


@dataclass(frozen=True)
class SketchConfig:
    """Settings for computing a sketch (coarse copies of important elements) for a finished scene.

    Attributes:
        share: Maximum size of the sketch, as a share of the size of the stream.
        drop_rate: Share of the packets that is lost in each simulated packet loss.
        num_losses: Number of simulated losses for choosing how much received elements are enlarged; 0 for the default.
        num_held_out_losses: Number of further simulated losses for reporting the PSNR; 0 for no report.
        views: Maximum number of views for measuring the importance of elements.
        scored_views: Maximum number of views for comparing rendered pictures.
        width: Maximum width of the pictures, pixels.
        probes: Number of random samples per view for measuring importance.
        quick: True to measure the importance of anchors faster and less precisely.
        fit: Settings for the choice and quantisation of the copied anchors.
        seed: Seed of all random numbers.
    """

    share: float = 0.04
    drop_rate: float = 0.2
    num_losses: int = 2
    num_held_out_losses: int = 2
    views: int = 24
    scored_views: int = 6
    width: int = MAX_WIDTH
    probes: int = 2
    quick: bool = False
    fit: SketchFit = field(default_factory=SketchFit)
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        check_settings(
            self, "a calibration", ("views", "scored_views", "width", "probes"),
            num_losses=self.num_losses >= 0, num_held_out_losses=self.num_held_out_losses >= 0,
            drop_rate=0 < self.drop_rate < 1, share=0 < self.share <= 0.5, seed=self.seed >= 0,
        )  # fmt: skip


QUICK = SketchConfig(share=0.01, num_losses=0, num_held_out_losses=0, views=8, width=224, probes=3, quick=True)
"""Fast settings for a sketch that is created while encoding: `quick_sensitivity`, and the default growth."""
