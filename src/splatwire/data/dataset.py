"""Posed photos of a scene, in any supported dataset layout."""

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import CheckedFields, checked, checked_except
from splatwire.data import bungee
from splatwire.data._checks import check_distinct, child, is_file, make_cameras, view_names
from splatwire.data.colmap import (
    ColmapView,
    find_reconstruction,
    read_points,
    read_views,
    warn_of_other_reconstructions,
)
from splatwire.data.copies import warn_of_copies
from splatwire.data.lens import Undistortion, undistortion_of
from splatwire.data.orientation import needs_exif_rotation, shape_fits
from splatwire.data.photos import limited_size, load_mask, load_photo, photo_size
from splatwire.data.point_cloud import SparsePoints, read_point_cloud
from splatwire.data.transforms_json import PosedPhoto, Transforms, listed_photos, names_masks, read_transforms
from splatwire.errors import DatasetError, InvalidValueError, NoViewsError, UnknownNameError, whole_number
from splatwire.files.kinds import DATASET, PHOTOS, contains_photos, file_kind, folder_nearby, format_error
from splatwire.files.names import path_of
from splatwire.types import Cameras
from splatwire.types.background import BLACK, Background
from splatwire.types.shapes import indices_of

LOG = logging.getLogger(__name__)
SPLITS = ("test", "train", "all")
TEST_VIEWS = ("every_8th", "first_31")
_RULE_TEXTS = {"every_8th": "every eighth", "first_31": "the first 31"}
"""Test views by rule, for messages."""
LAYOUTS = ("colmap", "bungeenerf", "blender", "nerfstudio")
DEFAULT_MAX_WIDTH = 1600
_POSE_FILES = {
    "bungeenerf": (bungee.FILE,),
    "blender": ("transforms_train.json", "transforms_test.json"),
    "nerfstudio": ("transforms.json",),
}
"""Names of the JSON files with the poses, by layout."""
_SPLIT_LISTS = (
    *("test.txt", "test_list.txt", "list_test.txt", "test_images.txt", "test_filenames.txt"),
    *("train_test_lists.json", "train_test_split.json", "split.json", "splits.json"),
)
"""Names of files in which other programs list the test views of a COLMAP dataset; 3DGS has `sparse/0/test.txt`."""


@dataclass(frozen=True, eq=False)
class Dataset(CheckedFields):
    """Photos of a scene with the camera of each.

    Attributes:
        cameras: The cameras, for images of `cameras.width` x `cameras.height`.
        image_paths: Photo of each view; larger photos are reduced to the size of the cameras when loaded.
        points: Sparse points of the reconstruction, if there are any, relative to `points.origin`.
        background: RGB visible where a photo's alpha is below 1.
        mask_paths: Mask file of each view, or None for a view without mask; empty if no view has a mask.
        undistortions: Undistortion of each view, or None for a pinhole view; empty if all views are pinhole views.
        applies_exif_rotation: True if photos must be rotated by their EXIF orientation to fit the cameras.
    """

    cameras: Cameras
    image_paths: tuple[Path, ...]
    points: SparsePoints | None = None
    background: Background = BLACK
    mask_paths: tuple[Path | None, ...] = ()
    undistortions: tuple[Undistortion | None, ...] = ()
    applies_exif_rotation: bool = False

    @property
    def num_views(self) -> int:
        """Number of views."""
        return self.cameras.num_views

    def image(self, view: int) -> Float[np.ndarray, "H W 3"]:
        """Loads the photo of a view as RGB in [0, 1], undistorted if its lens has distortion.

        Raises:
            DatasetError: If the file is missing or damaged.
            InvalidValueError: If there is no such view.
        """
        view = whole_number(view, "view", 0, self.num_views - 1)
        size = (self.cameras.width, self.cameras.height)
        photo = load_photo(self.image_paths[view], size, self.background, apply_exif=self.applies_exif_rotation)
        undistortion = self.undistortions[view] if self.undistortions else None
        return photo if undistortion is None else undistortion.image(photo)

    def mask(self, view: int) -> Bool[np.ndarray, "H W"] | None:
        """Loads the mask of a view; None if the view has no mask.

        The mask is True for pixels that are compared, in the training loss and in evaluation.

        Raises:
            DatasetError: If the file is missing or damaged, or the mask is empty.
            InvalidValueError: If there is no such view.
        """
        view = whole_number(view, "view", 0, self.num_views - 1)
        path = self.mask_paths[view] if self.mask_paths else None
        if path is None:
            return None
        mask = load_mask(path, (self.cameras.width, self.cameras.height))
        undistortion = self.undistortions[view] if self.undistortions else None
        mask = mask if undistortion is None else undistortion.mask(mask)
        if not bool(mask.any()):
            name = self.cameras.names[view]
            raise DatasetError(f"{path}: the mask of view '{name}' leaves nothing of its photo: remove the view")
        return mask

    def select(self, views: Any) -> "Dataset":
        """Returns a dataset with the views at the given indices (integers, a mask or a slice), in that order.

        Raises:
            InvalidValueError: If an index is out of range, or a mask has another length.
        """
        views = indices_of(views, self.cameras.num_views).tolist()
        paths = tuple(self.image_paths[view] for view in views)
        masks = tuple(self.mask_paths[view] for view in views) if self.mask_paths else ()
        undistortions = tuple(self.undistortions[view] for view in views) if self.undistortions else ()
        cameras = self.cameras.select(views)
        return replace(self, cameras=cameras, image_paths=paths, mask_paths=masks, undistortions=undistortions)


@checked_except("max_width")
def open_dataset(
    path: str | os.PathLike[str],
    *,
    split: str = "test",
    images: str | None = None,
    max_width: int | None = DEFAULT_MAX_WIDTH,
    test_views: str | None = None,
    background: Background = BLACK,
) -> Dataset:
    """Opens a folder of posed photos.

    Photos are loaded on demand. Four layouts are supported:

    * COLMAP: `sparse/0` (or `sparse`, `colmap/sparse/0`, the folder itself, or a numbered folder in `sparse`,
      `colmap/sparse` or the folder itself) and `images`, as in Mip-NeRF 360, Tanks & Temples and Deep Blending. Of
      several reconstructions, the first one in this order is read, with a warning.
    * BungeeNeRF: `poses_enu.json` and `images`.
    * Blender: `transforms_train.json` and `transforms_test.json`.
    * nerfstudio: one `transforms.json`, optionally with masks, points and splits.

    If a folder has several layouts, COLMAP is preferred, with a warning if a `transforms.json` is not read. To choose
    the layout of a JSON file, pass the path of the file in place of the folder.

    Lens distortion is removed. Photos are rotated by their EXIF orientation if the cameras have the aspect ratio of the
    rotated photos.

    Args:
        path: The folder; or the JSON file in it with the poses, such as `transforms.json`.
        split: Split to read, one of `SPLITS`.
        images: Folder of photos to read instead of the folder `images`, such as `images_4`. Intrinsics are scaled to
            the size of the photos in this folder. None to read the photos that the dataset names.
        max_width: Wider photos are reduced to this width, as in the training of HAC++; None for no limit.
        test_views: Choice of test views, one of `TEST_VIEWS`: every eighth, or the first 31. None for the default of
            the layout.
        background: RGB visible where a photo's alpha is below 1.

    Raises:
        DatasetError: If the folder has none of these layouts, a file is missing or damaged, images and poses do not
            match, or a photo has two views.
        NoViewsError: If the split has no views.
        UnknownNameError: If `split` or `test_views` is not a known name.
        InvalidValueError: If `max_width` is not positive.
    """
    path = _checked_path(path, split, max_width, test_views)
    layout = _layout_of_file(path)
    path = path if layout is None else path.parent
    if not path.is_dir():
        raise DatasetError(format_error(path, "a dataset folder") + _dataset_nearby(path))
    chosen = test_views or ("first_31" if (path / bungee.FILE).is_file() else "every_8th")
    views: Sequence[ColmapView | PosedPhoto]
    folder = find_reconstruction(path) if layout is None else None
    if folder is not None:
        warn_of_other_reconstructions(path, folder)
        _warn_of_unread_transforms(path, folder)
        _warn_of_unread_splits(path, folder, chosen)
        in_root = images is None and not (path / "images").is_dir() and _expects_photos_in_root(path, folder)
        views, image_paths = _colmap_views(folder, path if in_root else path / (images or "images"), split, chosen)
        cloud, source = None, folder
    else:
        views, source, cloud = _transforms_views(path, split, images, test_views, layout or dataset_layout(path))
        image_paths = [view.image_path for view in views]
    if not views:
        raise NoViewsError(f"{source}: has no views in the split '{split}': there are too few in all")
    apply_exif = needs_exif_rotation(views, image_paths)
    cameras, undistortions = _cameras(source, views, image_paths, max_width, apply_exif)
    points: SparsePoints | None = None
    if folder is not None:
        points = read_points(folder, cameras.origin)
    elif cloud is not None:
        points = read_point_cloud(cloud, cameras.origin)
    masks = _masks(views, image_paths, apply_exif)
    if not masks:
        _warn_of_unread_masks(path, layout or dataset_layout(path))
    return Dataset(cameras, tuple(image_paths), points, background, masks, undistortions, apply_exif)


def _layout_of_file(path: Path) -> str | None:
    """Returns the layout of a dataset whose JSON file with the poses is at `path`; None for any other path."""
    layout = next((name for name, files in _POSE_FILES.items() if path.name in files), None)
    return layout if layout is not None and path.is_file() else None


def _warn_of_unread_transforms(path: Path, folder: Path) -> None:
    """Logs a warning if a dataset has a COLMAP reconstruction, which is read, and a transforms file, which is not.

    Args:
        path: Folder of the dataset.
        folder: Folder of the reconstruction.
    """
    names = [name for layout in ("blender", "nerfstudio") for name in _POSE_FILES[layout] if (path / name).is_file()]
    if names:
        LOG.warning(
            "%s: the poses of the COLMAP reconstruction %s are read, those of %s are not: to read these, name the file "
            "%s in place of the folder",
            path, folder, " and ".join(names), path / names[0],
        )  # fmt: skip


def _warn_of_unread_splits(path: Path, folder: Path, test_views: str) -> None:
    """Logs a warning if a dataset has a list of test views, which is not read.

    Args:
        path: Folder of the dataset.
        folder: Folder of the reconstruction.
        test_views: Rule that selects the test views, one of `TEST_VIEWS`.
    """
    lists = [
        place / name for place in dict.fromkeys((folder, path)) for name in _SPLIT_LISTS if (place / name).is_file()
    ]
    if lists:
        LOG.warning(
            "%s: its list of views %s is not read: of the photos in the order of their names, %s are test views",
            path, lists[0], _RULE_TEXTS[test_views],
        )  # fmt: skip


def _warn_of_unread_masks(path: Path, layout: str | None) -> None:
    """Logs a warning if a dataset has a folder of masks, but no view of any split names a mask."""
    try:
        folders = [name for name in ("masks", "mask") if (path / name).is_dir() and any((path / name).iterdir())]
    except OSError as error:
        LOG.warning("%s: its folder of masks cannot be listed: %s", path, error.strerror)
        return
    # The views of another split may name masks of the folder.
    files = _POSE_FILES[layout] if layout in ("blender", "nerfstudio") else ()
    views = [path / name for name in files if (path / name).is_file()]
    if folders and not any(map(names_masks, views)):
        LOG.warning(
            "%s: its folder %s is not read: masks are those that a transforms.json names as mask_path; whole photos "
            "are trained on and compared", path, folders[0],
        )  # fmt: skip


def _checked_path(path: str | os.PathLike[str], split: str, max_width: int | None, test_views: str | None) -> Path:
    """Checks the options of `open_dataset`; returns the path of the dataset as `Path`."""
    for kind, name, allowed in (("split", split, SPLITS), ("choice of test views", test_views, (None, *TEST_VIEWS))):
        if name not in allowed:
            raise UnknownNameError(kind, str(name), filter(None, allowed))
    if max_width is not None and (isinstance(max_width, bool) or not isinstance(max_width, int) or max_width < 1):
        raise InvalidValueError(f"max_width must be positive, not {max_width}")
    return path_of(path, "a dataset folder")


@checked
def dataset_layout(path: Path) -> str | None:
    """Returns the layout of a dataset folder, one of `LAYOUTS`; None for a folder without any of these layouts.

    A BungeeNeRF dataset with a COLMAP reconstruction is `bungeenerf`, because this layout determines preset and test
    views. `open_dataset` reads the poses of the reconstruction.

    Args:
        path: The folder; or the JSON file in it with the poses, which chooses the layout.
    """
    if (layout := _layout_of_file(path)) is not None:
        return layout
    if (path / bungee.FILE).is_file():
        return "bungeenerf"
    if find_reconstruction(path) is not None:
        return "colmap"
    if any((path / f"transforms_{half}.json").is_file() for half in ("train", "test")):
        return "blender"
    return "nerfstudio" if (path / "transforms.json").is_file() else None


def _split_indices(count: int, split: str, test_views: str) -> list[int]:
    is_test = [i % 8 == 0 if test_views == "every_8th" else i < 31 for i in range(count)]
    return [i for i in range(count) if split == "all" or is_test[i] == (split == "test")]


def _colmap_views(folder: Path, image_folder: Path, split: str, test_views: str) -> tuple[list[ColmapView], list[Path]]:
    """Returns the views of a split of a COLMAP reconstruction, and their photos.

    Args:
        folder: Folder of the reconstruction.
        image_folder: Folder of the photos.
        split: `train`, `test` or `all`.
        test_views: Rule that selects the test views.
    """
    views = read_views(folder)
    photo_paths = _find_images(image_folder, views)
    check_distinct(folder, [view.name for view in views], photo_paths)
    _warn_of_copies(
        folder, views, photo_paths, split, [views[i] for i in _split_indices(len(views), "test", test_views)]
    )
    chosen = _split_indices(len(views), split, test_views)
    views, photo_paths = [views[i] for i in chosen], [photo_paths[i] for i in chosen]
    photos = [file for file in photo_paths if file is not None]
    if missing := [view.name for view, file in zip(views, photo_paths, strict=True) if file is None]:
        hint = _dataset_nearby(image_folder) if image_folder in (folder, folder.parent) else ""
        raise DatasetError(
            f"{image_folder}: {len(missing)} of {len(views)} posed images are missing, first '{missing[0]}'{hint}"
        )
    return views, photos


def _transforms_views(
    path: Path, split: str, images: str | None, test_views: str | None, layout: str | None
) -> tuple[list[PosedPhoto], Path, Path | None]:
    """Reads the views (photos with cameras) of one split of a dataset with BungeeNeRF, Blender or nerfstudio layout.

    Args:
        path: Folder of the dataset.
        split: Split to read: `train`, `test`, or `all` for both.
        images: Folder that replaces `images` in the paths of the photos, such as `images_4`; None to keep the paths.
        test_views: Rule that selects the test views, one of `TEST_VIEWS`; None for the default rule of the layout.
        layout: Layout of the dataset; None if it has none.

    Returns:
        Three items:

        * Views of the split.
        * Path of the JSON file that lists the views. If two files list the views, path of the first file.
        * Path of the point cloud that the JSON files name; None if they name none.
    """
    if layout == "bungeenerf":
        views, rule = bungee.read_bungee(path / bungee.FILE, images), test_views or "first_31"
        photos, tests = [view.image_path for view in views], _split_indices(len(views), "test", rule)
        _warn_of_copies(path / bungee.FILE, views, photos, split, [views[i] for i in tests])
        return [views[i] for i in _split_indices(len(views), split, rule)], path / bungee.FILE, None
    halves = {half: path / f"transforms_{half}.json" for half in ("train", "test")}
    if layout == "blender":
        if split != "all" and not halves[split].is_file():
            raise NoViewsError(f"{halves[split]}: no such file, so the split '{split}' has no views")
        wanted = [half for half in ("train", "test") if split in (half, "all")]
        parts = [read_transforms(halves[half], images) for half in wanted]
        _check_disjoint_splits(halves, images, split)
        cloud = next((part.points for part in parts if part.points is not None), None)
        return [view for part in parts for view in part.views], halves[wanted[0]], cloud
    transforms_path = path / "transforms.json"
    if layout == "nerfstudio":
        transforms = read_transforms(transforms_path, images)
        views = sorted(transforms.views, key=lambda view: (Path(view.name).stem, view.name))
        uses_splits = test_views is None and bool(transforms.splits)

        def chosen_for(split: str) -> list[PosedPhoto]:
            if uses_splits:
                return _views_of_split(views, transforms, split)
            return [views[i] for i in _split_indices(len(views), split, test_views or "every_8th")]

        _warn_of_copies(transforms_path, views, [view.image_path for view in views], split, chosen_for("test"))
        if not (chosen := chosen_for(split)) and uses_splits:
            why = f"has no views in the split '{split}': its lists, such as '{split}_filenames', leave none"
            raise NoViewsError(f"{transforms_path}: {why}")
        return chosen, transforms_path, transforms.points
    why = (
        "it has neither a COLMAP reconstruction (images.bin or images.txt in sparse, in the folder itself or in a "
        "numbered folder of sparse, colmap/sparse or the folder itself) nor poses_enu.json, transforms_train.json, "
        "transforms_test.json or transforms.json"
    )
    kind, hint = file_kind(path), _dataset_nearby(path)
    if kind == DATASET:
        raise DatasetError(f"{path}: not a dataset: {why}{hint}")
    if kind == PHOTOS and hint:  # no need for poses
        raise DatasetError(f"{path}: not a dataset; it looks like {PHOTOS.description}{hint}")
    raise DatasetError(format_error(path, "a dataset", "" if kind == PHOTOS or hint else why) + hint)


def _dataset_nearby(path: Path) -> str:
    """Returns a hint for an error message: the path of a dataset in a folder above or below.

    The hint is empty if no dataset is found.
    """
    nearby = folder_nearby(path, lambda folder: folder != path and _has_photos(folder))
    return "" if nearby is None else f"; {nearby} looks like a dataset (layout: {dataset_layout(nearby)})"


def _expects_photos_in_root(folder: Path, reconstruction: Path) -> bool:
    """True if photos may be in the dataset folder itself: its reconstruction is in it or in a direct subfolder."""
    return folder in (reconstruction, reconstruction.parent)


def _has_photos(folder: Path) -> bool:
    """True if a dataset folder contains photos in the folder that its layout prescribes."""
    layout = dataset_layout(folder)
    reconstruction = find_reconstruction(folder) if layout == "colmap" else None
    if reconstruction is not None and _expects_photos_in_root(folder, reconstruction) and contains_photos(folder):
        return True
    return layout is not None and ((folder / "images").is_dir() or layout in ("blender", "nerfstudio"))


def _warn_of_copies(
    source: Path,
    views: Sequence[ColmapView | PosedPhoto],
    photos: Sequence[Path | None],
    split: str,
    tests: Sequence[ColmapView | PosedPhoto],
) -> None:
    """Logs a warning if test photos are copies of training photos; does nothing if `split` is `train`.

    Args:
        source: File or folder with the list of views, for messages.
        views: Views of all splits.
        photos: Photo of each view; None if the file is missing.
        split: Split that the caller reads: `train`, `test` or `all`.
        tests: Views of the test split.
    """
    if split != "train":
        chosen = set(map(id, tests))
        warn_of_copies(source, [view.name for view in views], photos, [id(view) in chosen for view in views])


def _check_disjoint_splits(halves: dict[str, Path], images: str | None, split: str) -> None:
    """Checks that each photo is listed once in the two files `transforms_train.json` and `transforms_test.json`.

    Also compares the bytes of the photos, unless `split` is `train`: logs a warning if a test photo is a copy of a
    training photo.

    Args:
        halves: Paths of the two files, with the keys `train` and `test`.
        images: Folder that replaces `images` in the paths of the photos, such as `images_4`; None to keep the paths.
        split: Split that the caller reads: `train`, `test` or `all`.

    Raises:
        DatasetError: If a photo is listed twice, so that it could be used for training and for testing.
    """
    listed = [(file, name, photo) for file in halves.values() for name, photo in listed_photos(file, images).items()]
    names = [f"{name} of {file.name}" for file, name, _ in listed]
    photos = [photo for _, _, photo in listed]
    check_distinct(halves["test"], names, photos)
    if split != "train":
        warn_of_copies(halves["test"], names, photos, [file == halves["test"] for file, _, _ in listed])


def _views_of_split(views: list[PosedPhoto], transforms: Transforms, split: str) -> list[PosedPhoto]:
    """Selects the views of a split, by the lists of training and test views in a transforms file.

    Args:
        views: All views of the file.
        transforms: Content of the file.
        split: `train`, `test` or `all`.
    """
    train, test = transforms.splits.get("train"), transforms.splits.get("test") or transforms.splits.get("val")
    if split == "all":
        return views
    wanted, others = (train, test) if split == "train" else (test, train)
    return [view for view in views if (view.name in wanted if wanted is not None else view.name not in (others or ()))]


def _find_images(folder: Path, views: list[ColmapView]) -> list[Path | None]:
    """Finds the photo file of each view; None for a view without a photo.

    The search accepts, in this order: the relative path of the view, its file name in `folder`, and its file name with
    another suffix or another letter case.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: the image folder is missing")
    by_stem: dict[Path, dict[str, Path]] = {}
    paths: list[Path | None] = []
    for view in views:
        exact = child(folder, view.name, folder)
        photo = next((file for file in (exact, folder / exact.name) if is_file(file, folder)), None)
        for parent in (exact.parent, folder) if photo is None else ():
            if parent not in by_stem:
                by_stem[parent] = _by_stem(parent)
            photo = photo or by_stem[parent].get(exact.stem) or by_stem[parent].get(exact.stem.casefold())
        paths.append(photo)
    return paths


def _by_stem(folder: Path) -> dict[str, Path]:
    """Returns the paths of the files in a folder, by file name without suffix.

    Each file is listed twice: under its exact name, and under its name in lower case.
    """
    files = [file for file in sorted(folder.iterdir()) if file.is_file()] if folder.is_dir() else []
    return {file.stem.casefold(): file for file in files} | {file.stem: file for file in files}


def _masks(
    views: Sequence[ColmapView | PosedPhoto], image_paths: list[Path], apply_exif: bool
) -> tuple[Path | None, ...]:
    """Returns the mask file of each view, None for a view without mask; an empty tuple if no view has a mask.

    Args:
        views: The views.
        image_paths: Photo of each view.
        apply_exif: True if photos are rotated by their EXIF orientation.

    Raises:
        DatasetError: If a mask and its photo have different sizes.
    """
    masks = tuple(view.mask_path if isinstance(view, PosedPhoto) else None for view in views)
    for mask, file in zip(masks, image_paths, strict=True):
        if mask is not None and (mask_size := photo_size(mask)) != (size := photo_size(file, apply_exif=apply_exif)):
            raise DatasetError(
                f"{mask}: the mask is {mask_size[0]} x {mask_size[1]} pixels, its photo {file.name} {size[0]} x "
                f"{size[1]}"
            )
    return masks if any(mask is not None for mask in masks) else ()


def _cameras(
    source: Path,
    views: Sequence[ColmapView | PosedPhoto],
    image_paths: list[Path],
    max_width: int | None,
    apply_exif: bool,
) -> tuple[Cameras, tuple[Undistortion | None, ...]]:
    """Returns the cameras, scaled to the size of the loaded photos, and the lens undistortion of each view.

    The undistortion of a pinhole view is None.

    Args:
        source: File or folder with the views, for messages.
        views: The views.
        image_paths: Photo of each view.
        max_width: Maximum width of loaded photos, pixels; None for no maximum.
        apply_exif: True if photos are rotated by their EXIF orientation.

    Raises:
        DatasetError: If the photos have different sizes, or an aspect ratio that differs from that of their cameras.
    """
    first = photo_size(image_paths[0], apply_exif=apply_exif)
    width, height = limited_size(*first, max_width)
    intrinsics, undistortions = [], []
    for view, file in zip(views, image_paths, strict=True):
        size = photo_size(file, apply_exif=apply_exif)
        if size != first:
            raise DatasetError(
                f"{file}: is {size[0]} x {size[1]} pixels, {image_paths[0].name} {first[0]} x {first[1]}; "
                "all images of a dataset must have one size: resize the photos, or train on those of one size only"
            )
        if not shape_fits(size, (view.width, view.height)):
            raise DatasetError(
                f"{file}: is {size[0]} x {size[1]} pixels, which is not the shape of its camera, "
                f"{view.width} x {view.height}"
            )
        K = np.array([[width / view.width], [height / view.height], [1.0]]) * view.K
        undistortions.append(_undistortion(source, view, K, width, height))
        intrinsics.append(K if undistortions[-1] is None else undistortions[-1].K)
    names = view_names([view.name for view in views])
    viewmats = np.stack([view.viewmat for view in views])
    cameras = make_cameras(source, names, viewmats, np.stack(intrinsics), width, height)
    return cameras, tuple(undistortions) if any(undistortions) else ()


def _undistortion(
    source: Path, view: ColmapView | PosedPhoto, K: np.ndarray, width: int, height: int
) -> Undistortion | None:  # fmt: skip
    if (
        not view.lens.has_distortion or not min(K[0, 0], K[1, 1]) > 0
    ):  # invalid focal lengths are reported with the cameras
        return None
    try:
        return undistortion_of(view.lens, K, width, height)
    except DatasetError as error:
        raise DatasetError(f"{source}: view '{view.name}': {error}") from error
