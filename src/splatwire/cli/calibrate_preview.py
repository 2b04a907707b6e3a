"""`splatwire calibrate preview`: what a receiver sees of a scene from the first datagram on, in the stream."""

from dataclasses import dataclass
from typing import Any

from splatwire.cli._calibration import StreamCalibration, complete_stream, stream_output, write_with_section
from splatwire.cli._output import print_json, progress_bars
from splatwire.errors import InvalidValueError


@dataclass(frozen=True)
class CalibratePreview(StreamCalibration):
    """Put a preview into the stream: a hundred Gaussians to look at before anything else has arrived."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.calibrate.preview import PreviewConfig, preview_for_scene
        from splatwire.codec import decode_stream, without_concealment
        from splatwire.codec.preview import SECTION

        output, config = stream_output(self.output, "preview"), PreviewConfig(seed=self.seed)
        self.look.check()
        with progress_bars() as show:
            stream = complete_stream(self.source, show)
            partial = decode_stream(stream, progress=lambda share: show("decoding", share))
            if partial.erasures.num_lost:
                raise InvalidValueError("a preview is made of the complete scene, and of this one packets were lost")
            views, where = self.look.views(partial.scene)
            test = self.look.photos("test", partial.scene)
            result = preview_for_scene(partial.scene, views, config, test=test, progress=show)
        sizes = write_with_section(without_concealment(stream, SECTION), SECTION, result.section, output)
        report = {
            "output": str(self.output),
            "views": where,
            "scored": "test photos" if test is not None else "the views it was fitted to",
            **sizes,
            "preview_bytes": len(result.section),
            "num_gaussians": result.num_gaussians,
            "psnr": result.psnr,
            "seconds": result.seconds,
        }
        print_json(report) if self.json else _print(report)


def _print(report: dict[str, Any]) -> None:
    print(f"fitted {report['views']}; PSNR in {report['scored']}")
    for name, value in report["psnr"].items():
        print(f"  {name:<10} {value:6.2f} dB")
    size, total = report["preview_bytes"], report["stream_bytes"]
    print(f"{report['num_gaussians']} Gaussians in {size:,} bytes, {report['seconds']:,.0f} s")
    print(f"{report['num_bytes']:,} bytes more in a stream of {total:,} -> {report['output']}")
