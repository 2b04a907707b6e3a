"""What pictures are compared with: photos where they lie, or renders that are drawn once, a file for each view."""

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.data import load_cameras, open_dataset
from splatwire.data.dataset import Dataset
from splatwire.errors import InvalidValueError
from splatwire.evaluate.study.definition import SceneEntry, Study, canonical
from splatwire.evaluate.study.records import CODE
from splatwire.evaluate.study.store import Store, read_json
from splatwire.evaluate.views import ReferenceViews, photo_source, photo_views, spread, views_of
from splatwire.model.appearance import Scene
from splatwire.scene import Cameras
from splatwire.scene.background import Background

Progress = Callable[[str, float], None]
RENDERS = "renders of the complete scene"


@dataclass(frozen=True)
class References:
    """Which pictures a scene is compared with; a worker opens them.

    Attributes:
        entry: The scene, which names photos or cameras.
        chosen: Indices of its views.
        background: RGB behind everything.
        renders: Folder of the pictures within the store; empty for photos.
        source: What they are, for reports.
        masked: Whether masks say which of their pixels count.
        digest: Digest of cameras, pictures and masks.
    """

    entry: SceneEntry
    chosen: tuple[int, ...]
    background: Background
    renders: str
    source: str
    masked: bool
    digest: str

    def open(self, root: Path) -> ReferenceViews:
        """Opens them; pictures are loaded when they are asked for.

        Args:
            root: Folder of the store.

        Raises:
            DatasetError: If photos or cameras cannot be read.
        """
        cameras, dataset = _cameras_of(self.entry, self.background)
        if dataset is not None:
            return photo_views(dataset.select(list(self.chosen)))

        def load(view: int) -> Float[np.ndarray, "H W 3"]:
            return np.load(_picture(root, self.renders, view), allow_pickle=False)

        return ReferenceViews(cameras.select(list(self.chosen)), load, self.source, self.background)


def prepare_references(
    study: Study, entry: SceneEntry, background: Background, drawn: Callable[[], Scene], stamp: str,
    store: Store, progress: Progress,
) -> References:  # fmt: skip
    """Finds the photos, or draws pictures unless the store has them.

    Args:
        study: The evaluation.
        entry: The scene.
        background: RGB behind everything.
        drawn: Gives the scene that is drawn where there are no photos.
        stamp: Digest of that scene.
        store: Where to.
        progress: Called with what is being done and the share of it that is done.

    Raises:
        SplatwireError: If photos or cameras cannot be read.
    """
    cameras, dataset = _cameras_of(entry, background)
    chosen = spread(cameras.num_views, study.views)
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
        folder = f"inputs/views_{digest_of(stamp, study.renderer, CODE, *content)}"
        digest = _draw(study, entry.name, cameras, background, drawn, store, folder, progress)
    return References(entry, tuple(chosen), background, folder, source, masked, digest)


def _draw(
    study: Study, name: str, cameras: Cameras, background: Background, drawn: Callable[[], Scene],
    store: Store, folder: str, progress: Progress,
) -> str:  # fmt: skip
    """Draws pictures into the store, unless they are there; returns the digest of cameras and pictures."""
    about = store.root / folder / "views.json"
    if (known := read_json(about)) is None:
        digests = []
        for view, image in enumerate(views_of(drawn(), cameras, study.renderer, background)):
            buffer = io.BytesIO()
            np.save(buffer, image)
            digests.append(hashlib.sha256(buffer.getvalue()).hexdigest())
            store.write(str(_picture(Path(), folder, view)), buffer.getvalue())
            progress(f"{name}: drawing references", (view + 1) / cameras.num_views)
        known = {"digest": digest_of(canonical(_camera_content(cameras)), str(background), *digests)}
        store.write(f"{folder}/views.json", json.dumps(known).encode())  # last: it says that all is there
    return str(known["digest"])


def _picture(root: Path, folder: str, view: int) -> Path:
    return root / folder / f"{view:05d}.npy"


def _cameras_of(entry: SceneEntry, background: Background) -> tuple[Cameras, Dataset | None]:
    """The cameras of a scene, and the dataset whose photos are the references; None where pictures are drawn."""
    if entry.photos is not None:
        dataset = open_dataset(
            entry.photos, split=entry.split, images=entry.images, max_width=entry.max_width,
            test_views=entry.test_views, background=background,
        )  # fmt: skip
        return dataset.cameras, dataset if entry.reference is None else None
    if entry.cameras is None:
        raise InvalidValueError(f"scene '{entry.name}' has neither photos nor cameras")
    return load_cameras(entry.cameras), None


def _camera_content(cameras: Cameras) -> dict[str, Any]:
    poses, intrinsics = cameras.viewmats.tolist(), cameras.Ks.tolist()
    return {"w": cameras.width, "h": cameras.height, "names": list(cameras.names), "poses": poses, "Ks": intrinsics}


def digest_of(*texts: str) -> str:
    """Name for something that depends on these texts."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:24]


def digest_of_files(path: Path) -> str:
    """Digest of a file, or of all files of a folder, one file at a time in memory."""
    digest = hashlib.sha256()
    for file in [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()):
        digest.update(f"{file.relative_to(path)}\0".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
