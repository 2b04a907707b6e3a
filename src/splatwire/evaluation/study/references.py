"""Reference images of an evaluation: photos of a dataset, or stored renders."""

import hashlib
import io
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.data import load_cameras, open_dataset
from splatwire.data.dataset import Dataset
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.evaluation.study.definition import SceneEntry, Study, canonical
from splatwire.evaluation.study.records import CODE
from splatwire.evaluation.study.sequences import reference_pictures
from splatwire.evaluation.study.store import Store, read_json
from splatwire.evaluation.views import ReferenceViews, photo_source, photo_views, spread
from splatwire.files.read_limited import open_regular
from splatwire.render import iterate_views
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import Cameras
from splatwire.types.background import BLACK, Background
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.scene import Scene

Progress = Callable[[str, float], None]
RENDERS = "renders of the complete scene"


@dataclass(frozen=True)
class References:
    """Description of a scene's reference images.

    Attributes:
        entry: Definition of the scene with its photos or cameras.
        chosen: Indices of the evaluated views.
        background: RGB of the background.
        renders: Folder of rendered references within the store; empty for photos.
        source: Description of the references for reports, such as `photos` or `renders of the complete scene`.
        masked: True if the references have masks.
        digest: Digest of cameras, images and masks.
        frames: True if each view is a frame of a sequence.
        names: Names of the evaluated views.
        num_views: Number of views of the scene, including those that are not evaluated.
        size: Width and height of the views in pixels.
    """

    entry: SceneEntry
    chosen: tuple[int, ...]
    background: Background
    renders: str
    source: str
    masked: bool
    digest: str
    frames: bool = False
    names: tuple[str, ...] = ()
    num_views: int = 0
    size: tuple[int, int] = (0, 0)

    @property
    def kind(self) -> str:
        """Kind of the references: `photos`, `reference scenes` or `renders` of the scene itself."""
        return "photos" if not self.renders else "renders" if self.entry.reference is None else "reference scenes"

    def open(self, root: Path) -> ReferenceViews:
        """Opens the reference images, which are loaded on demand.

        Args:
            root: Folder of the store.

        Raises:
            DatasetError: If photos or cameras cannot be read.
        """
        cameras, dataset = _cameras_of(self.entry, self.background)
        if dataset is not None:
            return photo_views(dataset.select(list(self.chosen)))

        def load(view: int) -> Float[np.ndarray, "H W 3"]:
            path = _picture(root, self.renders, view)
            try:
                return np.load(path, allow_pickle=False)
            except (OSError, EOFError, ValueError) as error:
                raise SplatwireError(f"{path} is damaged: {error}; remove its folder and start again") from error

        return ReferenceViews(cameras.select(list(self.chosen)), load, self.source, self.background)


def prepare_references(
    study: Study, entry: SceneEntry, background: Background, load_scene: Callable[[], Scene], scene_digest: str,
    store: Store, progress: Progress, *, frames: bool = False,
) -> References:  # fmt: skip
    """Returns the description of a scene's reference images: photos of a dataset, or renders.

    Missing renders are computed and written into the store.

    Args:
        study: The evaluation.
        entry: The scene.
        background: RGB of the background.
        load_scene: Function that loads the scene to render. It is called only if renders are missing.
        scene_digest: Digest of the scene to render; part of the folder name of the renders.
        store: Store for the renders.
        progress: Called with the name of the current task and its finished share, 0 to 1.
        frames: True if the references are the frames of a sequence, one for each camera.

    Raises:
        SplatwireError: If photos or cameras cannot be read.
    """
    cameras, dataset = _cameras_of(entry, background)
    num_views = cameras.num_views
    chosen = spread(num_views, study.views)
    cameras = cameras.select(chosen)
    content = [canonical(_camera_content(cameras)), str(background)]
    if dataset is not None:
        dataset = dataset.select(chosen)
        masks = dataset.mask_paths or (None,) * len(chosen)
        masked = any(masks)
        content += [str(dataset.undistortions)] if dataset.undistortions else []
        files = [digest_of_files(path) if path else "" for path in (*dataset.image_paths, *masks)]
        source, folder, digest = photo_source(masked=masked), "", digest_of(*content, *files)
    else:
        masked, source = False, RENDERS if entry.reference is None else f"renders of {entry.reference.name}"
        folder = f"inputs/views_{digest_of(scene_digest, study.renderer, CODE, *content)}"

        def pictures() -> Iterable[Any]:
            if frames and entry.reference is not None:
                return reference_pictures(entry.reference, cameras, chosen, study.renderer, background)
            scene = load_scene()
            warn_of_near_plane(scene, cameras)
            return iterate_views(scene, cameras, renderer=study.renderer, background=background)

        digest = _render_missing(entry.name, cameras, background, pictures, store, folder, progress)
    return References(
        entry,
        tuple(chosen),
        background,
        folder,
        source,
        masked,
        digest,
        frames,
        cameras.names,
        num_views,
        (cameras.width, cameras.height),
    )


def _render_missing(
    name: str, cameras: Cameras, background: Background, pictures: Callable[[], Iterable[Any]],
    store: Store, folder: str, progress: Progress,
) -> str:  # fmt: skip
    """Renders the reference images into the store, unless they are already there.

    Args:
        name: Name of the scene, for progress reports.
        cameras: Cameras of the images.
        background: RGB of the background.
        pictures: Function that yields the rendered images; called only if images are missing.
        store: Store for the images.
        folder: Folder of the images within the store.
        progress: Called with the name of the task and its finished share, 0 to 1.

    Returns:
        Digest of cameras, background and images.
    """
    about = store.root / folder / "views.json"
    if (stored := read_json(about)) is None:
        digests = []
        for view, image in enumerate(pictures()):
            buffer = io.BytesIO()
            np.save(buffer, image)
            digests.append(hashlib.sha256(buffer.getvalue()).hexdigest())
            store.write(str(_picture(Path(), folder, view)), buffer.getvalue())
            progress(f"{name}: drawing references", (view + 1) / cameras.num_views)
        stored = {"digest": digest_of(canonical(_camera_content(cameras)), str(background), *digests)}
        store.write(f"{folder}/views.json", json.dumps(stored).encode())  # last: marks the entry as complete
    return str(stored["digest"])


def _picture(root: Path, folder: str, view: int) -> Path:
    return root / folder / f"{view:05d}.npy"


def _cameras_of(entry: SceneEntry, background: Background) -> tuple[Cameras, Dataset | None]:
    """Returns the cameras of a scene and, if the references are photos, the dataset with the photos.

    Args:
        entry: The scene.
        background: RGB visible where a photo's alpha is below 1.
    """
    if entry.photos is not None:
        dataset = open_dataset(
            entry.photos, split=entry.split, images=entry.images, max_width=entry.max_width,
            test_views=entry.test_views, background=background,
        )  # fmt: skip
        return dataset.cameras, dataset if entry.reference is None else None
    if entry.cameras is None:
        raise InvalidValueError(f"scene '{entry.name}' has neither photos nor cameras")
    return load_cameras(entry.cameras), None


def check_views(entry: SceneEntry) -> None:
    """Reads the photos or cameras that define the views of a scene; pixels of photos are not decoded.

    Raises:
        SplatwireError: If they cannot be read.
    """
    if entry.photos is not None or entry.cameras is not None:
        _cameras_of(entry, BLACK)


def _camera_content(cameras: Cameras) -> dict[str, Any]:
    poses, intrinsics = cameras.viewmats.tolist(), cameras.Ks.tolist()
    content = {"w": cameras.width, "h": cameras.height, "names": list(cameras.names), "poses": poses, "Ks": intrinsics}
    # The default is left out, so that stored references keep their digests.
    return content if cameras.near_depth == NEAR_DEPTH else content | {"near": cameras.near_depth}


def digest_of(*texts: str) -> str:
    """Returns a hash of one or more texts, 24 hexadecimal digits, for use in file names."""
    return hashlib.sha256("\0".join(texts).encode(errors="surrogateescape")).hexdigest()[:24]


def digest_of_files(path: Path) -> str:
    """Returns a hash of a file, or of all files of a folder."""
    digest = hashlib.sha256()
    for file in [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()):
        digest.update(f"{file.relative_to(path)}\0".encode(errors="surrogateescape"))
        with open_regular(file, SplatwireError) as data:
            digest.update(hashlib.file_digest(data, "sha256").digest())
    return digest.hexdigest()
