"""What a sketch is calibrated with."""

from dataclasses import dataclass, field

from splatwire.calibrate.checks import check_settings
from splatwire.calibrate.sketch_fit import SketchFit

MAX_WIDTH = 400


@dataclass(frozen=True)
class SketchConfig:
    """A calibration for the picture.

    Attributes:
        share: Bytes of the sketch over those of the stream.
        drop_rate: Share of packets that a pseudo-loss takes.
        masks: Pseudo-losses that choose the growth; 0 for the growth that is usual.
        held_out_masks: Pseudo-losses that choose nothing: the gain is reported on them. 0 for no report.
        views: Most views that tell what elements are worth, and
        scored_views: most views that pictures are compared in.
        width: Pictures are drawn at most this wide.
        probes: Random sign patterns per view (`render_sensitivity`).
        quick: Whether a glance at anchors suffices (`quick_sensitivity`).
        fit: How anchors are chosen and rounded.
        seed: Seed of everything random.
    """

    share: float = 0.04
    drop_rate: float = 0.2
    masks: int = 2
    held_out_masks: int = 2
    views: int = 24
    scored_views: int = 6
    width: int = MAX_WIDTH
    probes: int = 2
    quick: bool = False
    fit: SketchFit = field(default_factory=SketchFit)
    seed: int = 0

    def __post_init__(self) -> None:
        check_settings(
            self, "a calibration", ("views", "scored_views", "width", "probes"),
            masks=self.masks >= 0, held_out_masks=self.held_out_masks >= 0,
            drop_rate=0 < self.drop_rate < 1, share=0 < self.share <= 0.5, seed=self.seed >= 0,
        )  # fmt: skip


QUICK = SketchConfig(share=0.01, masks=0, held_out_masks=0, views=8, width=224, probes=3, quick=True)
"""What encoding has time for: one look at the scene, and the growth that is usual."""
