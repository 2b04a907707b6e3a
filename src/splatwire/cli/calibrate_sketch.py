"""`splatwire calibrate sketch`: coarse copies of important elements, chosen on pictures, in the stream."""

from dataclasses import dataclass
from typing import Any

from splatwire.cli._calibration import StreamCalibration, complete_stream, stream_output, write_with_section
from splatwire.cli._output import print_json, progress_bars


@dataclass(frozen=True)
class CalibrateSketch(StreamCalibration):
    """Put coarse copies of what matters most in the picture into the stream (--conceal sketch)."""

    share: float = 0.04
    """Bytes of the sketch over those of the stream."""
    drop_rate: float = 0.2
    """Share of packets that is dropped where the growth is chosen."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.calibrate.sketch import sketch_of
        from splatwire.calibrate.sketch_config import SketchConfig
        from splatwire.codec import decode_stream, without_concealment
        from splatwire.conceal.sketch import SECTION

        output = stream_output(self.output, "sketch")
        config = SketchConfig(share=self.share, drop_rate=self.drop_rate, seed=self.seed)
        self.look.check()
        with progress_bars() as show:
            stream = complete_stream(self.source, show)
            complete = decode_stream(stream, progress=lambda share: show("decoding", share))
            views, where = self.look.views(complete.scene)
            bare = without_concealment(stream, SECTION)
            result = sketch_of(bare, complete, views, config, progress=show)
        sizes = write_with_section(bare, SECTION, result.section, output)
        report = {
            "output": str(self.output),
            "views": where,
            **sizes,
            "elements": bare.manifest.elements,
            "num_elements": bare.manifest.num_elements,
            "num_sketched": result.num_sketched,
            "growth_exponent": result.exponent,
            "growth_trust": result.trust,
            "psnr_held_out": result.psnr,
            "seconds": result.seconds,
        }
        print_json(report) if self.json else _print(report)


def _print(report: dict[str, Any]) -> None:
    print(f"PSNR on held-out losses, {report['views']}")
    for name, value in report["psnr_held_out"].items():
        print(f"  {name:<8} {value:6.2f} dB")
    sketched, number, elements = report["num_sketched"], report["num_elements"], report["elements"]
    print(f"{sketched:,} of {number:,} {elements} sketched, {report['seconds']:,.0f} s")
    size, total, share = report["num_bytes"], report["stream_bytes"], 100 * report["share_of_stream"]
    print(f"{size:,} bytes in a stream of {total:,} ({share:.2f} %) -> {report['output']}")
