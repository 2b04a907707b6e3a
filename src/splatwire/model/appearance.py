"""What a view sees of a scene, whatever its elements are: the one place above the codec that asks for their kind.

Each kind of scene registers here (`functools.singledispatch`), others may do so from outside.
"""

from dataclasses import replace
from functools import singledispatch

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.model.anchor_scene import AnchorScene
from splatwire.model.compiled_heads import SpawnedGaussians, drawn_gaussians, drawn_with_anchors
from splatwire.model.partial import Partial
from splatwire.model.scene import Scene
from splatwire.model.splat_scene import SplatScene
from splatwire.ops.arrays import to_numpy
from splatwire.packets import SceneStream
from splatwire.scene import Cameras, Gaussians
from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.origin import NO_ORIGIN, Origin
from splatwire.scene.splats import Splats


def scene_of(loaded: Scene | Partial) -> Scene:
    """The scene itself, whatever is known of its gaps."""
    return loaded.scene if isinstance(loaded, Partial) else loaded


def as_scene(value: Scene | Partial | Splats) -> Scene:
    """Returns the scene that a caller means.

    Args:
        value: A scene; the result of a decoder if nothing was lost; or explicit Gaussians, which become a scene on
            black.

    Raises:
        InvalidValueError: If it is something else, or elements were lost; the message says what makes a scene of it.
    """
    if isinstance(value, Partial):
        if value.erasures.num_lost:
            lost = f"{value.erasures.num_lost:,} of {value.scene.num_elements:,} {value.scene.ELEMENTS} were lost"
            raise InvalidValueError(
                f"{lost}: `splatwire.conceal.conceal(partial, 'drop')` makes a scene of what arrived"
            )
        return value.scene
    if isinstance(value, Splats):
        return SplatScene(value)
    if gaussians_of_view.dispatch(type(value)) is gaussians_of_view.dispatch(object):
        raise InvalidValueError(f"expected a scene {_way_to_scene(value)}, not {type(value).__name__}")
    return value


def _way_to_scene(value: object) -> str:
    """Returns in brackets what makes a scene of a value."""
    if isinstance(value, SceneStream):
        return "(`decode_stream` decodes a stream)"
    if isinstance(value, Gaussians):
        return "(`create_renderer(name)` draws the Gaussians of one view; a scene has `Splats`)"
    return "(`open_scene` reads one from a file)"


@singledispatch
def gaussians_of_view(scene: Scene, cameras: Cameras, view: int) -> Gaussians:
    """What camera `view` sees of a scene, as its hints say; for drawing, without gradients.

    Gaussians are relative to the scene's origin, as `cameras.relative_to(origin_of(scene))` are.

    Raises:
        InvalidValueError: If it is no scene.
    """
    raise InvalidValueError(f"expected a scene (`load_scene` reads one from a file), not {type(scene).__name__}")


@gaussians_of_view.register
def _(scene: SplatScene, cameras: Cameras, view: int) -> Gaussians:
    splats, cameras = scene.drawn(), cameras.relative_to(scene.origin)
    return splats.seen_from(to_numpy(cameras.centers[view]))


@gaussians_of_view.register
def _(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    return drawn_gaussians(scene, cameras, view)


@singledispatch
def spawned_gaussians(scene: Scene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """What camera `view` sees of a complete scene, each Gaussian with its element, without hints.

    Without a registration of its own, an element is one Gaussian.
    """
    own = np.arange(scene.num_elements)
    return SpawnedGaussians(gaussians_of_view(scene, cameras, view), own, np.zeros_like(own))


@spawned_gaussians.register
def _(scene: SplatScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    own = np.arange(scene.num_elements)
    cameras = cameras.relative_to(scene.origin)
    seen = scene.splats.seen_from(to_numpy(cameras.centers[view]))
    return SpawnedGaussians(seen, own, np.zeros_like(own))


@spawned_gaussians.register
def _(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    return drawn_with_anchors(replace(scene, hints=None), cameras, view)


@singledispatch
def antialiased(scene: Scene) -> bool:
    """Whether Gaussians lose opacity as they are widened to a pixel."""
    return False


@antialiased.register
def _(scene: SplatScene) -> bool:
    return scene.antialiased


@singledispatch
def origin_of(scene: Scene) -> Origin:
    """World coordinates that the positions of a scene are relative to."""
    return NO_ORIGIN


@origin_of.register
def _(scene: SplatScene) -> Origin:
    return scene.origin


@singledispatch
def metadata_of(scene: Scene) -> SceneMetadata:
    """Title, author and license of a scene, and how it is looked at first."""
    return NO_METADATA


@metadata_of.register
def _(scene: SplatScene) -> SceneMetadata:
    return scene.metadata


@metadata_of.register
def _(scene: AnchorScene) -> SceneMetadata:
    return scene.metadata


@singledispatch
def explicit_gaussians(scene: Scene) -> Splats | None:
    """The Gaussians, as the hints say, if every view sees the same ones; None if they depend on the view."""
    return None


@explicit_gaussians.register
def _(scene: SplatScene) -> Splats | None:
    return scene.drawn()
