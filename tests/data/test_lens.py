"""Photos with lens distortion are undistorted to a pinhole camera."""

import json
import struct

import numpy as np
import pytest
from PIL import Image

from splatwire.data import open_dataset
from splatwire.data.lens import Lens, undistortion_of
from splatwire.errors import DatasetError

WIDTH, HEIGHT, FX, FY, CX, CY = 160, 120, 110.0, 115.0, 82.5, 58.25
BARREL, PINCUSHION, TANGENTIAL = (-0.15, 0.03, 0.0, 0.0), (0.12, -0.02, 0.0, 0.0), (-0.08, 0.01, 0.004, -0.006)
LENSES = pytest.mark.parametrize("bend", [BARREL, PINCUSHION, TANGENTIAL], ids=["barrel", "pincushion", "tangential"])


def _picture(x, y):
    """Colours of rays (x, y, 1)."""
    waves = (np.sin(5 * x + 1) * np.cos(4 * y), np.cos(3 * x - 6 * y), np.sin(4 * y + 2))
    return 0.5 + 0.35 * np.stack(waves, axis=-1)


def _bent(x, y, k1, k2, p1, p2):
    """OpenCV's distortion model in complex numbers; p = p1 + i p2 rotates the tangential part."""
    ray, square = x + 1j * y, x**2 + y**2
    turned = 1j * np.conj(p1 + 1j * p2)
    bent = ray * (1 + k1 * square + k2 * square**2) + turned * square + 2 * ray * np.real(ray * np.conj(turned))
    return bent.real, bent.imag


def _straight(u, v, bend):
    """Rays of picture points (u, v): the inverse of a distortion model, by iteration."""
    x, y = u.copy(), v.copy()
    for _ in range(200):
        found = _bent(x, y, *bend)
        x, y = x + u - found[0], y + v - found[1]
    assert max(np.abs(_bent(x, y, *bend)[0] - u).max(), np.abs(_bent(x, y, *bend)[1] - v).max()) < 1e-12
    return x, y


def _pixels(fx, fy, cx, cy):
    return np.meshgrid((np.arange(WIDTH) + 0.5 - cx) / fx, (np.arange(HEIGHT) + 0.5 - cy) / fy)


def _write_photo(path, bend, fy=FY):
    seen = _picture(*_straight(*_pixels(FX, fy, CX, CY), bend))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(seen * 255).astype(np.uint8)).save(path)


def _write_transforms(folder, bend, **more):
    _write_photo(folder / "images" / "a.png", bend)
    k1, k2, p1, p2 = bend
    frame = {"file_path": "images/a.png", "transform_matrix": np.eye(4).tolist()}
    content = {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT, "camera_model": "OPENCV",
               "k1": k1, "k2": k2, "p1": p1, "p2": p2, "frames": [frame], **more}  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(content))


def _write_colmap(folder, model, parameters):
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    camera = struct.pack("<QIiQQ", 1, 7, model, WIDTH, HEIGHT) + struct.pack(f"<{len(parameters)}d", *parameters)
    (sparse / "cameras.bin").write_bytes(camera)
    pose = struct.pack("<I7dI", 1, 1, 0, 0, 0, 0, 0, 0, 7)
    (sparse / "images.bin").write_bytes(struct.pack("<Q", 1) + pose + b"a.png\0" + struct.pack("<Q", 0))


def _assert_straight(dataset):
    """Each pixel shows the ray of its pinhole camera, also at the border."""
    K = dataset.cameras.Ks[0].astype(np.float64)
    seen = _picture(*_pixels(K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    assert np.abs(dataset.image(0) - seen).max() < 0.012
    return K


@LENSES
def test_photos_of_nerfstudio_are_undistorted(tmp_path, bend):
    _write_transforms(tmp_path, bend)
    K = _assert_straight(open_dataset(tmp_path, split="all"))
    assert K[0, 0] != pytest.approx(FX, rel=1e-3)
    assert K[0, 0] / FX == pytest.approx(K[1, 1] / FY)
    assert (K[0, 2], K[1, 2]) == (CX, CY)


@pytest.mark.parametrize(
    ("model", "parameters", "bend", "fy"),
    [
        (2, (FX, CX, CY, -0.12), (-0.12, 0.0, 0.0, 0.0), FX),
        (3, (FX, CX, CY, *BARREL[:2]), BARREL, FX),
        (4, (FX, FY, CX, CY, *TANGENTIAL), TANGENTIAL, FY),
    ],
    ids=["SIMPLE_RADIAL", "RADIAL", "OPENCV"],
)
def test_photos_of_colmap_are_undistorted(tmp_path, model, parameters, bend, fy):
    _write_photo(tmp_path / "images" / "a.png", bend, fy)
    _write_colmap(tmp_path, model, parameters)
    _assert_straight(open_dataset(tmp_path, split="all"))


@LENSES
def test_reduced_photos_are_undistorted_like_full_ones(tmp_path, bend):
    _write_transforms(tmp_path, bend)
    whole, half = (open_dataset(tmp_path, split="all", max_width=width) for width in (None, WIDTH // 2))
    np.testing.assert_allclose(half.cameras.Ks[0, :2], whole.cameras.Ks[0, :2] / 2, rtol=1e-6)
    mean = whole.image(0).reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
    assert float(np.abs((half.image(0) - mean)[2:-2, 2:-2]).max()) < 0.02


@LENSES
def test_distortion_derivative_equals_finite_differences(bend):
    lens, step = Lens(*bend), 1e-6
    x, y = np.random.default_rng(3).uniform(-0.7, 0.7, (2, 50))
    columns = [
        [(a - b) / (2 * step) for a, b in zip(lens.distort(x + dx, y + dy), lens.distort(x - dx, y - dy), strict=True)]
        for dx, dy in ((step, 0), (0, step))
    ]
    (xx, yx), (xy, yy) = columns
    np.testing.assert_allclose(lens.stretch(x, y), xx * yy - xy * yx, rtol=1e-6)
    np.testing.assert_allclose(lens.distort(x, y), _bent(x, y, *bend), rtol=1e-12)


def test_masks_are_undistorted_with_their_photos(tmp_path):
    """A mask of the rays on one side stays a mask of that side."""
    _write_transforms(tmp_path, BARREL)
    x, _ = _straight(*_pixels(FX, FY, CX, CY), BARREL)
    Image.fromarray(np.where(x > 0.3, 255, 0).astype(np.uint8)).save(tmp_path / "mask.png")
    content = json.loads((tmp_path / "transforms.json").read_text())
    content["frames"][0]["mask_path"] = "mask.png"
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    dataset = open_dataset(tmp_path, split="all").select([0])
    K = dataset.cameras.Ks[0].astype(np.float64)
    rays, _ = _pixels(K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    wrong = dataset.mask(0) != (rays > 0.3)
    assert not wrong[np.abs(rays - 0.3) > 1 / FX].any()


@pytest.mark.parametrize("bend", [(-2.0, 0.0, 0.0, 0.0), (9.0, 0.0, 0.0, 0.0)])
def test_excessive_distortion_is_refused(tmp_path, bend):
    with pytest.raises(DatasetError, match=r"the distortion of the lens is too large.*image_undistorter"):
        undistortion_of(Lens(*bend), np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]]), WIDTH, HEIGHT)


@pytest.mark.parametrize("more", [{"k4": 0.01}, {"k1": 1e9}, {"camera_model": "OPENCV_FISHEYE", "p1": 0.01}])
def test_unsupported_lens_models_are_refused(tmp_path, more):
    _write_transforms(tmp_path, BARREL, **more)
    with pytest.raises(DatasetError, match=r"view 'images/a.png' has (a lens|lens parameters)"):
        open_dataset(tmp_path, split="all")


def test_photos_without_poses_name_how_to_make_them(tmp_path):
    for name in ("photos/a.JPG", "more/images/a.png"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes(b"photo")
        with pytest.raises(DatasetError, match=r"without poses.*ns-process-data.*colmap automatic_reconstructor"):
            open_dataset(tmp_path / name.split("/")[0])
