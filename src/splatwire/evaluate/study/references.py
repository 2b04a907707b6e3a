"""What pictures of a protocol are compared with: cameras, reference pictures and their masks, made once."""

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatwire.codec import decode_stream
from splatwire.codec.background import background_of
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.data.dataset import Dataset
from splatwire.errors import InvalidValueError
from splatwire.evaluate.study.definition import SceneEntry, Study, canonical
from splatwire.evaluate.study.store import Store, read_json
from splatwire.evaluate.views import ReferenceViews, photo_source, spread, views_of
from splatwire.packets import read_stream
from splatwire.scene import Cameras
from splatwire.scene.background import Background

Progress = Callable[[str, float], None]
RENDERS = "renders of the complete scene"


def prepare_references(
    study: Study, entry: SceneEntry, stream: Path, stamps: Mapping[str, str], store: Store, progress: Progress
) -> tuple[str, dict[str, Any]]:
    """Writes cameras, reference pictures and their masks; what the store has is taken from there.

    Args:
        study: The protocol.
        entry: The scene.
        stream: Its complete stream, for its background and, without photos, for the references.
        stamps: Digests of `scene` and `code`.
        store: Where to.
        progress: Called with what is being done and the share of it that is done.

    Returns:
        Their folder within the store, and what `views.json` there says: `digest` of all of it, `background`, `source`
        (what the references are) and `masked` (whether only a part of them counts).

    Raises:
        SplatwireError: If photos or cameras cannot be read.
    """
    background = entry.background
    if background is None:
        background = background_of(read_stream(stream)[0])
    entry = replace(entry, background=background)
    dataset = None if entry.photos is None else _photos(entry, entry.photos, background)
    cameras = dataset.cameras if dataset is not None else load_cameras(_camera_file(entry))
    chosen = spread(cameras.num_views, study.views)
    stamp = _stamp(dataset, chosen) if dataset is not None else f"{stamps['scene']} {study.renderer}"
    content = canonical(_camera_content(cameras.select(chosen)))
    folder = f"inputs/views_{digest_of(stamp, stamps['code'], content, str(background), entry.name)}"
    if (known := read_json(store.root / folder / "views.json")) is not None:
        return folder, known
    pictures = _pictures(dataset, chosen, cameras, study, entry, stream, progress)
    digests = [_save_array(store, f"{folder}/references.npy", pictures)]
    masked = dataset is not None and any(dataset.select(chosen).mask_paths)
    if dataset is not None and masked:
        digests.append(_save_array(store, f"{folder}/masks.npy", _masks(dataset, chosen)))
    save_cameras(cameras.select(chosen), store.root / folder / "cameras.json")
    about = {
        "digest": digest_of(*digests, content, str(background)), "background": list(background),
        "source": RENDERS if dataset is None else photo_source(masked=masked), "masked": masked,
    }  # fmt: skip
    store.write(f"{folder}/views.json", json.dumps(about).encode())
    return folder, about


def _photos(entry: SceneEntry, folder: Path, background: Background) -> Dataset:
    return open_dataset(
        folder, split=entry.split, images=entry.images, max_width=entry.max_width, test_views=entry.test_views,
        background=background,
    )  # fmt: skip


def _save_array(store: Store, path: str, array: np.ndarray) -> str:
    """Writes an array; returns the digest of the file."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    store.write(path, buffer.getvalue())
    return hashlib.sha256(buffer.getvalue()).hexdigest()


def _masks(dataset: Dataset, chosen: list[int]) -> np.ndarray:
    """Where photos count, bool (views, H, W); views without a mask count everywhere."""
    masks = np.ones((len(chosen), dataset.cameras.height, dataset.cameras.width), np.bool_)
    for i, view in enumerate(chosen):
        if (mask := dataset.mask(view)) is not None:
            masks[i] = mask.numpy()
    return masks


def _pictures(
    dataset: Dataset | None, chosen: list[int], cameras: Cameras, study: Study, entry: SceneEntry,
    stream: Path, progress: Progress,
) -> np.ndarray:  # fmt: skip
    pictures = np.empty((len(chosen), cameras.height, cameras.width, 3), np.float32)
    if dataset is not None:
        for i, view in enumerate(chosen):
            pictures[i] = dataset.image(view).numpy()
            progress(f"{entry.name}: loading photos", (i + 1) / len(chosen))
        return pictures
    scene = decode_stream(read_stream(stream)[0]).scene
    for i, image in enumerate(views_of(scene, cameras.select(chosen), study.renderer, entry.background)):
        pictures[i] = image.numpy()
        progress(f"{entry.name}: drawing references", (i + 1) / len(chosen))
    return pictures


def load_views(store: Store, folder: str) -> ReferenceViews:
    """Opens the references of a prepared scene; pictures are mapped, not read."""
    about = read_json(store.root / folder / "views.json")
    if about is None:
        raise InvalidValueError(f"{store.root / folder} has no references: the store is not complete")
    cameras = load_cameras(store.root / folder / "cameras.json")
    pictures = np.load(store.root / folder / "references.npy", mmap_mode="r", allow_pickle=False)
    red, green, blue = about["background"]
    load_mask = None
    if about["masked"]:
        masks = np.load(store.root / folder / "masks.npy", mmap_mode="r", allow_pickle=False)
        load_mask = lambda view: torch.from_numpy(masks[view].copy())  # noqa: E731
    return ReferenceViews(
        cameras, lambda view: torch.from_numpy(pictures[view].copy()), str(about["source"]), (red, green, blue),
        load_mask,
    )  # fmt: skip


def _camera_file(entry: SceneEntry) -> Path:
    if entry.cameras is None:
        raise InvalidValueError(f"scene '{entry.name}' has neither photos nor cameras")
    return entry.cameras


def _camera_content(cameras: Cameras) -> dict[str, Any]:
    poses, intrinsics = cameras.viewmats.tolist(), cameras.Ks.tolist()
    return {"w": cameras.width, "h": cameras.height, "names": list(cameras.names), "poses": poses, "Ks": intrinsics}


def _stamp(dataset: Dataset, chosen: list[int]) -> str:
    """Changes when a photo or mask does."""
    masks = [dataset.mask_paths[view] for view in chosen] if dataset.mask_paths else []
    stats = [path.stat() for path in [*(dataset.image_paths[view] for view in chosen), *filter(None, masks)]]
    return canonical({"files": [[stat.st_size, stat.st_mtime_ns] for stat in stats]})


def digest_of(*texts: str) -> str:
    """Name for something that depends on these texts."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:24]
