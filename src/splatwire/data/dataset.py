"""Posed photos of a scene, whatever layout they come in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from splatwire.data import bungee
from splatwire.data._checks import child, make_cameras, view_names
from splatwire.data.colmap import ColmapView, find_reconstruction, read_points, read_views
from splatwire.data.lens import Undistortion, undistortion
from splatwire.data.orientation import shape_fits, views_are_upright
from splatwire.data.photos import limited_size, load_mask, load_photo, photo_size
from splatwire.data.point_cloud import SparsePoints, read_point_cloud
from splatwire.data.transforms_json import Transforms, TransformsView, read_transforms
from splatwire.errors import DatasetError, InvalidValueError, UnknownNameError
from splatwire.files.kinds import PHOTOS, file_kind, is_not
from splatwire.scene import Cameras
from splatwire.scene.background import BLACK, Background

SPLITS = ("test", "train", "all")
TEST_VIEWS = ("every_8th", "first_31")
LAYOUTS = ("colmap", "bungeenerf", "blender", "nerfstudio")
DEFAULT_MAX_WIDTH = 1600


@dataclass(frozen=True, eq=False)
class Dataset:
    """Cameras and the photos they took.

    Attributes:
        cameras: The cameras, for images of `cameras.width` x `cameras.height`.
        image_paths: One file per view; it may be larger than that and is then reduced when it is loaded.
        points: Sparse points of the reconstruction, if there are any.
        background: RGB that shows where a photo's alpha is below 1.
        mask_paths: A mask or None for each view; empty if no view has one.
        undistortions: What makes a photo that of its camera, or None, for each view; empty if no lens bends rays.
        upright: True if photos are turned as their EXIF orientation demands, because their cameras are.
    """

    cameras: Cameras
    image_paths: tuple[Path, ...]
    points: SparsePoints | None = None
    background: Background = BLACK
    mask_paths: tuple[Path | None, ...] = ()
    undistortions: tuple[Undistortion | None, ...] = ()
    upright: bool = False

    @property
    def num_views(self) -> int:
        """Number of views."""
        return self.cameras.num_views

    def image(self, view: int) -> Float[np.ndarray, "H W 3"]:
        """Loads the photo of a view as RGB in [0, 1], undistorted where its lens bends rays.

        Raises:
            DatasetError: If the file is missing or damaged.
        """
        size = (self.cameras.width, self.cameras.height)
        photo = load_photo(self.image_paths[view], size, self.background, upright=self.upright)
        bent = self.undistortions[view] if self.undistortions else None
        return photo if bent is None else bent.image(photo)

    def mask(self, view: int) -> Bool[np.ndarray, "H W"] | None:
        """Loads the mask of a view, True where its photo counts; None where all of it does.

        Raises:
            DatasetError: If the file is missing or damaged, or leaves nothing.
        """
        path = self.mask_paths[view] if self.mask_paths else None
        if path is None:
            return None
        mask = load_mask(path, (self.cameras.width, self.cameras.height))
        bent = self.undistortions[view] if self.undistortions else None
        mask = mask if bent is None else bent.mask(mask)
        if not bool(mask.any()):
            name = self.cameras.names[view]
            raise DatasetError(f"{path}: the mask of view '{name}' leaves nothing of its photo: remove the view")
        return mask

    def select(self, views: list[int]) -> "Dataset":
        """Returns the views at the given indices, in that order."""
        paths = tuple(self.image_paths[view] for view in views)
        masks = tuple(self.mask_paths[view] for view in views) if self.mask_paths else ()
        bent = tuple(self.undistortions[view] for view in views) if self.undistortions else ()
        cameras = self.cameras.select(views)
        return replace(self, cameras=cameras, image_paths=paths, mask_paths=masks, undistortions=bent)


def open_dataset(
    path: Path,
    *,
    split: str = "test",
    images: str | None = None,
    max_width: int | None = DEFAULT_MAX_WIDTH,
    test_views: str | None = None,
    background: Background = BLACK,
) -> Dataset:
    """Opens a folder of posed photos; photos are loaded when they are asked for.

    Four layouts are read (`dataset_layout`). COLMAP: `sparse/0` (or `sparse`, `colmap/sparse/0`) and `images`, as in
    Mip-NeRF 360, Tanks & Temples and Deep Blending. BungeeNeRF: `poses_enu.json` and `images`, or that file beside a
    COLMAP reconstruction, which then gives the cameras. Blender: `transforms_train.json` and `transforms_test.json`,
    each its own split. nerfstudio: one `transforms.json`, with a `mask_path` for frames that have a mask, and its
    points (`ply_file_path`) and splits (`train_filenames`, `val_filenames`, `test_filenames`). A COLMAP text model may
    also lie in the folder itself. Where one list of views must be split, it is sorted by name first. Lenses
    (`splatwire.data.lens`, `fisheye`) are undistorted. Photos are turned by their EXIF orientation where the shape of
    their cameras demands it.

    Args:
        path: The folder.
        split: Which views, one of `SPLITS`.
        images: Image folder instead of `images` (`images_4`); the intrinsics follow the size of what is in it.
        max_width: Wider photos are reduced to this width (HAC++, training); None for no limit.
        test_views: Which views are for testing, one of `TEST_VIEWS`: every eighth, or the first 31 (as for
            BungeeNeRF). None chooses by the layout: a folder with a `poses_enu.json` is BungeeNeRF, and a
            `transforms.json` that lists its splits has those.
        background: RGB that shows where a photo's alpha is below 1.

    Raises:
        DatasetError: If the folder has none of these layouts, a file in it is missing or damaged, images and poses do
            not fit each other, or no view is left.
        UnknownNameError: If `split` or `test_views` is none of those.
        InvalidValueError: If `max_width` is not positive.
    """
    _check_options(split, max_width, test_views)
    if not path.is_dir():
        raise DatasetError(is_not(path, "a dataset folder"))
    chosen = test_views or ("first_31" if (path / bungee.FILE).is_file() else "every_8th")
    views: Sequence[ColmapView | TransformsView]
    if (folder := find_reconstruction(path)) is not None:
        colmap_views = read_views(folder)
        views = colmap_views = [colmap_views[i] for i in _chosen(len(colmap_views), split, chosen)]
        beside = folder == path and images is None and not (path / "images").is_dir()
        image_paths = _find_images(path if beside else path / (images or "images"), colmap_views)
        points, source = read_points(folder), folder
    else:
        views, source, cloud = _transforms_views(path, split, images, test_views)
        image_paths = [view.image_path for view in views]
        points = None if cloud is None else read_point_cloud(cloud)
    if not views:
        raise DatasetError(f"{source}: has no views in the split '{split}': there are too few in all")
    upright = views_are_upright(views, image_paths)
    cameras, bent = _cameras(source, views, image_paths, max_width, upright)
    masks = _masks(views, image_paths, upright)
    return Dataset(cameras, tuple(image_paths), points, background, masks, bent, upright)


def _check_options(split: str, max_width: int | None, test_views: str | None) -> None:
    for kind, name, known in (("split", split, SPLITS), ("choice of test views", test_views, (None, *TEST_VIEWS))):
        if name not in known:
            raise UnknownNameError(kind, str(name), filter(None, known))
    if max_width is not None and max_width < 1:
        raise InvalidValueError(f"max_width must be positive, not {max_width}")


def dataset_layout(path: Path) -> str | None:
    """Tells which of `LAYOUTS` a folder has; None if it has none of them. A file `poses_enu.json` means BungeeNeRF."""
    if (path / bungee.FILE).is_file():
        return "bungeenerf"
    if find_reconstruction(path) is not None:
        return "colmap"
    if any((path / f"transforms_{half}.json").is_file() for half in ("train", "test")):
        return "blender"
    return "nerfstudio" if (path / "transforms.json").is_file() else None


def _chosen(count: int, split: str, test_views: str) -> list[int]:
    is_test = [i % 8 == 0 if test_views == "every_8th" else i < 31 for i in range(count)]
    return [i for i in range(count) if split == "all" or is_test[i] == (split == "test")]


def _transforms_views(
    path: Path, split: str, images: str | None, test_views: str | None
) -> tuple[list[TransformsView], Path, Path | None]:
    """Views of a split, the file that they come from, and the point cloud that it names."""
    if (path / bungee.FILE).is_file():
        views = bungee.read_bungee(path / bungee.FILE, images)
        return [views[i] for i in _chosen(len(views), split, test_views or "first_31")], path / bungee.FILE, None
    halves = {half: path / f"transforms_{half}.json" for half in ("train", "test")}
    if any(file.is_file() for file in halves.values()):
        wanted = [half for half in ("train", "test") if split in (half, "all")]
        parts = [read_transforms(halves[half], images) for half in wanted]
        cloud = next((part.points for part in parts if part.points is not None), None)
        return [view for part in parts for view in part.views], halves[wanted[0]], cloud
    whole = path / "transforms.json"
    if whole.is_file():
        found = read_transforms(whole, images)
        views = sorted(found.views, key=lambda view: (Path(view.name).stem, view.name))
        if test_views is None and found.splits:
            return _listed(views, found, split), whole, found.points
        return [views[i] for i in _chosen(len(views), split, test_views or "every_8th")], whole, found.points
    why = (
        "it has neither a COLMAP reconstruction (sparse/0/images.bin or .txt) nor poses_enu.json, "
        "transforms_train.json, transforms_test.json or transforms.json"
    )
    raise DatasetError(is_not(path, "a dataset", "" if file_kind(path) == PHOTOS else why))


def _listed(views: list[TransformsView], found: Transforms, split: str) -> list[TransformsView]:
    """Views of a split as the file lists them.

    Views for testing are those of `test_filenames`, else of `val_filenames`. Where only one of the two halves is
    listed, the other one is the rest.
    """
    train, test = found.splits.get("train"), found.splits.get("test") or found.splits.get("val")
    if split == "all":
        return views
    wanted, others = (train, test) if split == "train" else (test, train)
    return [view for view in views if (view.name in wanted if wanted is not None else view.name not in (others or ()))]


def _find_images(folder: Path, views: list[ColmapView]) -> list[Path]:
    """Finds the file of each view: by its name, by its last part, or by its stem with another suffix."""
    if not folder.is_dir():
        raise DatasetError(f"{folder}: the image folder is missing")
    by_stem = {file.stem: file for file in sorted(folder.iterdir()) if file.is_file()}
    paths: list[Path | None] = []
    for view in views:
        exact = child(folder, view.name, folder)
        flat = folder / exact.name
        paths.append(next((file for file in (exact, flat) if file.is_file()), by_stem.get(exact.stem)))
    missing = [view.name for view, file in zip(views, paths, strict=True) if file is None]
    if missing:
        raise DatasetError(f"{folder}: {len(missing)} of {len(views)} posed images are missing, first '{missing[0]}'")
    return [file for file in paths if file is not None]


def _masks(
    views: Sequence[ColmapView | TransformsView], image_paths: list[Path], upright: bool
) -> tuple[Path | None, ...]:
    """The mask of each view, which must be of the size of its photo."""
    masks = tuple(view.mask_path if isinstance(view, TransformsView) else None for view in views)
    for mask, file in zip(masks, image_paths, strict=True):
        if mask is not None and (found := photo_size(mask)) != (size := photo_size(file, upright=upright)):
            raise DatasetError(
                f"{mask}: the mask is {found[0]} x {found[1]} pixels, its photo {file.name} {size[0]} x {size[1]}"
            )
    return masks if any(mask is not None for mask in masks) else ()


def _cameras(
    source: Path,
    views: Sequence[ColmapView | TransformsView],
    image_paths: list[Path],
    max_width: int | None,
    upright: bool,
) -> tuple[Cameras, tuple[Undistortion | None, ...]]:
    """Cameras of the photos as they are loaded, and what undistorts them; nothing where no lens bends rays."""
    first = photo_size(image_paths[0], upright=upright)
    width, height = limited_size(*first, max_width)
    intrinsics, bent = [], []
    for view, file in zip(views, image_paths, strict=True):
        size = photo_size(file, upright=upright)
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
        bent.append(_undistortion(source, view, K, width, height))
        intrinsics.append(K if bent[-1] is None else bent[-1].K)
    names = view_names([view.name for view in views])
    viewmats = np.stack([view.viewmat for view in views])
    cameras = make_cameras(source, names, viewmats, np.stack(intrinsics), width, height)
    return cameras, tuple(bent) if any(bent) else ()


def _undistortion(
    source: Path, view: ColmapView | TransformsView, K: np.ndarray, width: int, height: int
) -> Undistortion | None:  # fmt: skip
    if not view.lens.bends or not min(K[0, 0], K[1, 1]) > 0:  # a focal length that is none is told with the cameras
        return None
    try:
        return undistortion(view.lens, K, width, height)
    except DatasetError as error:
        raise DatasetError(f"{source}: view '{view.name}': {error}") from error
