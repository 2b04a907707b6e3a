"""Functions for all types of scenes: the Gaussians that a scene shows in a view, its origin, and its metadata.

Other packages may register scene types (`functools.singledispatch`).
"""

from dataclasses import replace
from functools import singledispatch

import numpy as np
from jaxtyping import Float64

from splatwire.anchors.compiled_heads import SpawnedGaussians, drawn_gaussians, drawn_with_anchors
from splatwire.bitstream import SceneStream
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_numpy
from splatwire.types import Cameras, Gaussians
from splatwire.types.anchor_scene import AnchorScene
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.scene import Scene
from splatwire.types.sequence_scene import SequenceScene
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from splatwire.types.validity import validity_of_splats


def scene_of(loaded: Scene | ReceivedScene) -> Scene:
    """Returns the scene that a decoder's result contains. An argument that already is a scene is returned unchanged."""
    return loaded.scene if isinstance(loaded, ReceivedScene) else loaded


def as_scene(value: Scene | ReceivedScene | Splats) -> Scene:
    """Converts a supported value to a scene.

    Args:
        value: A scene, a decoder's result in which no element was lost, or explicit Gaussians.

    Returns:
        The scene. A scene of explicit Gaussians has quaternions of length 1. If `value` has no background, the
        background is black.

    Raises:
        InvalidValueError: If the value has another type, or elements were lost.
    """
    if isinstance(value, ReceivedScene):
        check_drawable(value.scene)
        if value.loss_mask.num_lost:
            lost = f"{value.loss_mask.num_lost:,} of {value.scene.num_elements:,} {value.scene.ELEMENTS} were lost"
            raise InvalidValueError(
                f"{lost}: `splatwire.concealment.conceal(received, 'drop')` makes a scene of what arrived"
            )
        return value.scene
    if isinstance(value, Splats):
        return SplatScene(value.with_unit_quats())
    if isinstance(value, SplatScene):
        unit = value.splats.with_unit_quats()
        return value if unit is value.splats else replace(value, splats=unit)
    check_drawable(value)
    return value


def check_drawable(scene: object) -> None:
    """Checks that `gaussians_of_view` draws a scene. It does not draw clips, only their frames.

    Raises:
        InvalidValueError: If it does not; the message says how to get a scene.
    """
    if gaussians_of_view.dispatch(type(scene)) is gaussians_of_view.dispatch(object):
        raise InvalidValueError(f"expected a scene {_conversion_hint(scene)}, not {type(scene).__name__}")


def _conversion_hint(value: object) -> str:
    """Returns a hint, in brackets, on how to convert a value to a scene, for an error message."""
    if isinstance(value, SceneStream):
        return "(`decode_stream` decodes a stream)"
    if isinstance(value, Gaussians):
        return "(`create_renderer(name)` draws the Gaussians of one view; a scene has `Splats`)"
    if isinstance(value, SequenceScene):
        return "(`splatwire.sequence.decode_frames` conceals a clip and yields its frames, each with a `scene`)"
    return "(`open_scene` reads one from a file)"


@singledispatch
def gaussians_of_view(scene: Scene, cameras: Cameras, view: int) -> Gaussians:
    """Returns the Gaussians that camera `view` draws. Not differentiable.

    Positions of the result are relative to the scene's origin, whatever the origin of the cameras. To draw it, use
    `cameras.relative_to(origin_of(scene))`.

    Raises:
        InvalidValueError: If `scene` is not a scene.
    """
    raise InvalidValueError(f"expected a scene (`open_scene` reads one from a file), not {type(scene).__name__}")


@gaussians_of_view.register
def _(scene: SplatScene, cameras: Cameras, view: int) -> Gaussians:
    splats, cameras = scene.drawn(), cameras.relative_to(scene.origin)
    return splats.seen_from(to_numpy(cameras.centers[view]))


@gaussians_of_view.register
def _(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    return drawn_gaussians(scene, cameras.relative_to(scene.origin), view)


@singledispatch
def spawned_gaussians(scene: Scene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """Returns the Gaussians of camera `view`, and for each Gaussian the anchor and the offset that generated it.

    For a scene of explicit Gaussians, all Gaussians are returned; `anchor_index` is then the index of the Gaussian, and
    `offset_index` is 0. The rendering hints of loss concealment (`scene.hints`) are ignored: no element is enlarged or
    hidden.
    """
    all_rows = np.arange(scene.num_elements)
    return SpawnedGaussians(gaussians_of_view(scene, cameras, view), all_rows, np.zeros_like(all_rows))


@spawned_gaussians.register
def _(scene: SplatScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    all_rows = np.arange(scene.num_elements)
    cameras = cameras.relative_to(scene.origin)
    seen = scene.splats.seen_from(to_numpy(cameras.centers[view]))
    return SpawnedGaussians(seen, all_rows, np.zeros_like(all_rows))


@spawned_gaussians.register
def _(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    return drawn_with_anchors(replace(scene, hints=None), cameras.relative_to(scene.origin), view)


@singledispatch
def antialiased(scene: Scene) -> bool:
    """Returns True if the scene was trained with antialiased rendering (Mip-Splatting); always False for anchors."""
    return False


@antialiased.register
def _(scene: SplatScene) -> bool:
    return scene.antialiased


@singledispatch
def origin_of(scene: Scene) -> Origin:
    """Returns the world coordinates of the point that the positions of a scene are relative to."""
    return NO_ORIGIN


@origin_of.register
def _(scene: SplatScene) -> Origin:
    return scene.origin


@origin_of.register
def _(scene: AnchorScene) -> Origin:
    return scene.origin


@singledispatch
def metadata_of(scene: Scene) -> SceneMetadata:
    """Returns title, author, license, up axis, initial view and orbit limits of a scene."""
    return NO_METADATA


@metadata_of.register
def _(scene: SplatScene) -> SceneMetadata:
    return scene.metadata


@metadata_of.register
def _(scene: AnchorScene) -> SceneMetadata:
    return scene.metadata


@singledispatch
def explicit_gaussians(scene: Scene) -> Splats | None:
    """Returns the Gaussians of a scene of explicit Gaussians as drawn; None for a scene of anchors.

    Render hints are applied: sizes and opacities have their factors, and hidden Gaussians are left out.
    """
    return None


@explicit_gaussians.register
def _(scene: SplatScene) -> Splats | None:
    return scene.drawn()


@singledispatch
def largest_sizes(scene: Scene) -> Float64[np.ndarray, "N"]:
    """Returns the largest size of each element (anchor or Gaussian), world units.

    For a Gaussian, this is the largest scale. For an anchor, it is the largest value of its `scalings`.
    """
    return np.exp(to_numpy(scene.elements.log_sizes).astype(np.float64))


@largest_sizes.register
def _(scene: SplatScene) -> Float64[np.ndarray, "N"]:
    return scene.splats.scales.max(axis=1).astype(np.float64)


@largest_sizes.register
def _(scene: AnchorScene) -> Float64[np.ndarray, "N"]:
    return to_numpy(scene.anchors.scalings).max(axis=1).astype(np.float64)


@singledispatch
def without_invalid(scene: Scene) -> Scene:
    """Removes Gaussians that cannot be drawn, such as those with an opacity above 1, and warns if there are any.

    Decoded scenes and scenes of anchors are returned unchanged.
    """
    return scene


@without_invalid.register
def _(scene: SplatScene) -> SplatScene:
    if scene.coding is not None or scene.hints is not None or _is_surely_valid(scene.splats):
        return scene
    validity = validity_of_splats(scene.splats)
    validity.log_removed("rendering", scene.ELEMENTS)
    return scene.select(validity.kept) if validity.num_invalid else scene


def _is_surely_valid(splats: Splats) -> bool:
    """True if a quick check shows that all Gaussians are valid; False if the check is inconclusive.

    If the result is False, `validity_of_splats` determines which Gaussians are invalid.
    """
    if not splats.num_gaussians:
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        values = (splats.means, splats.quats, splats.scales, splats.opacities, splats.sh)
        total = sum(float(value.sum(dtype=np.float32)) for value in values)
    if not (np.isfinite(total) and splats.opacities.max() <= 1 and splats.scales.min() > 0):
        return False
    return bool(splats.quats.any(axis=1).all())
