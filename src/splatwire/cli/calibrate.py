"""`splatwire calibrate`: what is fitted to a finished scene and travels in its stream."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli.calibrate_gnn import CalibrateGnn
from splatwire.cli.calibrate_preview import CalibratePreview
from splatwire.cli.calibrate_sketch import CalibrateSketch


@dataclass(frozen=True)
class Calibrate:
    """Fit a network, a sketch or a preview to one scene and put it into the stream: calibrate gnn|sketch|preview."""

    what: (
        Annotated[CalibrateGnn, tyro.conf.subcommand("gnn")]
        | Annotated[CalibrateSketch, tyro.conf.subcommand("sketch")]
        | Annotated[CalibratePreview, tyro.conf.subcommand("preview")]
    )

    def run(self) -> None:
        """Runs the verb."""
        self.what.run()
