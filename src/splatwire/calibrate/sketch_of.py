"""A sketch for a stream, whatever its elements are."""

from splatwire.calibrate.pseudo_loss import calibration_data
from splatwire.calibrate.sketch import SketchConfig, SketchResult, sketch_for_stream
from splatwire.calibrate.sketch_gaussians import sketch_of_gaussians
from splatwire.calibrate.views import CalibrationViews, Progress
from splatwire.model import Partial, Prior
from splatwire.packets import SceneStream


def sketch_of(
    stream: SceneStream,
    complete: Partial,
    views: CalibrationViews,
    config: SketchConfig,
    *,
    progress: Progress | None = None,
) -> SketchResult:
    """Makes the section `sketch` for a stream that has none yet.

    Args:
        stream: The complete stream.
        complete: What a decoder made of it.
        views: Where it is looked at from.
        config: The run.
        progress: Called with what is done and the share of it that is done.

    Raises:
        InvalidValueError: If something was lost, a sketch of that size holds nothing, or no view shows anything.
    """
    if complete.find(Prior) is None:
        return sketch_of_gaussians(stream, complete, views, config, progress=progress)
    data = calibration_data(stream, complete)
    return sketch_for_stream(data, views, stream.num_bytes, config, progress=progress)
