"""Photos of every lens model of COLMAP are undistorted to a pinhole camera.

The references go from pixels to rays, by COLMAP's definitions of unprojection, by bisection or by iteration; the
product goes from rays to pixels.
"""

import json
import struct

import numpy as np
import pytest
from PIL import Image

from splatwire.data import open_dataset
from splatwire.data.fisheye import DivisionLens, EucmLens, FisheyeLens, FovLens, RadTanThinPrismLens
from splatwire.data.lens import Lens
from splatwire.errors import DatasetError

WIDTH, HEIGHT, FX, FY, CX, CY = 160, 120, 90.0, 94.0, 82.5, 58.25


def _picture(x, y):
    """Colours of rays (x, y, 1)."""
    waves = (np.sin(5 * x + 1) * np.cos(4 * y), np.cos(3 * x - 6 * y), np.sin(4 * y + 2))
    return 0.5 + 0.35 * np.stack(waves, axis=-1)


def _rays(u, v, project):
    """Rays (x, y, 1) of points of the picture plane: the inverse of a projection, by iteration."""
    x, y = u.copy(), v.copy()
    for _ in range(300):
        a, b = project(x, y)
        x, y = x + 0.7 * (u - a), y + 0.7 * (v - b)
    assert max(np.abs(np.subtract(project(x, y), (u, v))).max(axis=(1, 2))) < 1e-9
    return x, y


def _radially(inverse):
    """Unprojection by a symmetric lens model, given the undistorted radius as a function of the distorted one."""

    def rays(u, v):
        radius = np.hypot(u, v)
        factor = inverse(radius) / radius
        return u * factor, v * factor

    return rays


def _polynomial(*terms):
    """Unprojection of a fisheye lens, with the angle found by bisection."""

    def inverse(wanted):
        low, high = np.zeros_like(wanted), np.full_like(wanted, 1.5)
        for _ in range(60):
            angle = (low + high) / 2
            below = angle + sum(k * angle ** (2 * n + 3) for n, k in enumerate(terms)) < wanted
            low, high = np.where(below, angle, low), np.where(below, high, angle)
        return np.tan(low)

    return _radially(inverse)


def _inverse(project):
    return lambda u, v: _rays(u, v, project)


def _angle(x, y):
    radius = np.hypot(x, y)
    return np.arctan(radius) * x / radius, np.arctan(radius) * y / radius


def _thin_prism(x, y):
    a, b = _angle(x, y)
    r = a * a + b * b
    return a * (1 + 0.02 * r - 0.01 * r**2 + 0.001 * r**3) + 2 * 0.002 * a * b - 0.003 * (
        r + 2 * a * a
    ) + 0.004 * r, b * (1 + 0.02 * r - 0.01 * r**2 + 0.001 * r**3) - 2 * 0.003 * a * b + 0.002 * (
        r + 2 * b * b
    ) - 0.002 * r


def _rad_tan(x, y):
    a, b = _angle(x, y)
    r = a * a + b * b
    a, b = (side * (1 + 0.03 * r - 0.02 * r**2 + 0.004 * r**3) for side in (a, b))
    r = a * a + b * b
    return (
        a + 2 * 0.002 * a * b + 0.001 * (r + 2 * a * a) + 0.003 * r + 0.001 * r * r,
        b + 2 * 0.001 * a * b + 0.002 * (r + 2 * b * b) - 0.002 * r + 0.0005 * r * r,
    )


def _full(x, y):
    r = x * x + y * y
    bend = (1 - 0.1 * r + 0.02 * r**2 + 0.003 * r**3) / (1 + 0.05 * r - 0.01 * r**2 + 0.002 * r**3)
    return x * bend + 2 * 0.001 * x * y - 0.002 * (r + 2 * x * x), y * bend - 2 * 0.002 * x * y + 0.001 * (
        r + 2 * y * y
    )


def _eucm(radius, alpha=0.6, beta=1.1):
    """Undistorted radius for a distorted one: z of the unprojection (Khomutenko 2016, equation 12)."""
    square = radius * radius
    depth = (1 - beta * alpha**2 * square) / (alpha * np.sqrt(1 - (2 * alpha - 1) * beta * square) + 1 - alpha)
    return radius / depth


TWO, ONE = (FX, FY, CX, CY), (FX, CX, CY)


def _division(k):
    return lambda u, v: (u / (1 + k * (u * u + v * v)), v / (1 + k * (u * u + v * v)))


FISHEYES = {
    "OPENCV_FISHEYE": (5, (*TWO, 0.03, -0.02, 0.004, -0.001), _polynomial(0.03, -0.02, 0.004, -0.001)),
    "FULL_OPENCV": (6, (*TWO, -0.1, 0.02, 0.001, -0.002, 0.003, 0.05, -0.01, 0.002), _inverse(_full)),
    "FOV": (7, (*TWO, 0.9), _radially(lambda r: np.tan(r * 0.9) / (2 * np.tan(0.45)))),
    "SIMPLE_RADIAL_FISHEYE": (8, (*ONE, 0.04), _polynomial(0.04)),
    "RADIAL_FISHEYE": (9, (*ONE, 0.04, -0.01), _polynomial(0.04, -0.01)),
    "THIN_PRISM_FISHEYE": (10, (*TWO, 0.02, -0.01, 0.002, -0.003, 0.001, 0.0, 0.004, -0.002), _inverse(_thin_prism)),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        11, (*TWO, 0.03, -0.02, 0.004, 0.0, 0.0, 0.0, 0.001, 0.002, 0.003, 0.001, -0.002, 0.0005), _inverse(_rad_tan)),
    "SIMPLE_DIVISION": (12, (*ONE, -0.1), _division(-0.1)),
    "DIVISION": (13, (*TWO, 0.08), _division(0.08)),
    "SIMPLE_FISHEYE": (14, ONE, _radially(np.tan)),
    "FISHEYE": (15, TWO, _radially(np.tan)),
    "EUCM": (16, (*TWO, 0.6, 1.1), _radially(_eucm)),
}  # fmt: skip
"""Lens models by name: number, parameters, and the rays of image points."""


def _write(folder, name, binary):
    number, parameters, rays = FISHEYES[name]
    fy = FY if parameters[1] == FY else FX
    plane = np.meshgrid((np.arange(WIDTH) + 0.5 - CX) / FX, (np.arange(HEIGHT) + 0.5 - CY) / fy)
    (folder / "images").mkdir(parents=True)
    Image.fromarray(np.rint(_picture(*rays(*plane)) * 255).astype(np.uint8)).save(folder / "images" / "a.png")
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    if binary:
        camera = struct.pack("<QIiQQ", 1, 7, number, WIDTH, HEIGHT) + struct.pack(f"<{len(parameters)}d", *parameters)
        (sparse / "cameras.bin").write_bytes(camera)
    else:
        text = " ".join(map(str, (7, name, WIDTH, HEIGHT, *parameters)))
        (sparse / "cameras.txt").write_text(text + "\n")
    (sparse / "images.txt").write_text("1 1 0 0 0 0 0 0 7 a.png\n")


def _assert_straight(dataset):
    """Each pixel shows the ray of its pinhole camera, also at the border."""
    K = dataset.cameras.Ks[0].astype(np.float64)
    x, y = np.meshgrid((np.arange(WIDTH) + 0.5 - K[0, 2]) / K[0, 0], (np.arange(HEIGHT) + 0.5 - K[1, 2]) / K[1, 1])
    assert np.abs(dataset.image(0) - _picture(x, y)).max() < 0.025
    return K


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize("name", FISHEYES)
def test_photos_of_every_model_of_colmap_are_undistorted(tmp_path, name, binary):
    _write(tmp_path, name, binary)
    K = _assert_straight(open_dataset(tmp_path, split="all"))
    if "FISHEYE" in name:
        assert K[0, 0] >= FX - 1e-6


@pytest.mark.parametrize("more", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}], ids=["nerfstudio", "ngp"])
def test_fisheye_photos_of_transforms_are_undistorted(tmp_path, more):
    _write(tmp_path, "OPENCV_FISHEYE", True)
    for file in (tmp_path / "sparse" / "0").iterdir():
        file.unlink()
    frame = {"file_path": "images/a.png", "transform_matrix": np.eye(4).tolist()}
    content = {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT, "frames": [frame],
               "k1": 0.03, "k2": -0.02, "k3": 0.004, "k4": -0.001, **more}  # fmt: skip
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    _assert_straight(open_dataset(tmp_path, split="all"))


@pytest.mark.parametrize(
    "lens",
    [
        Lens(-0.1, 0.02, 0.001, -0.002, 0.003, 0.05, -0.01, 0.002),
        FisheyeLens(0.03, -0.02, 0.004, -0.001, 0.002, 0.001, 0.003, -0.002),
        RadTanThinPrismLens(0.03, -0.02, 0.004, 0.0, 0.0, 0.0, 0.001, 0.002, 0.003, 0.001, -0.002, 0.0005),
        FovLens(0.9),
        DivisionLens(-0.1),
        EucmLens(0.6, 1.1),
    ],
)
def test_local_area_scale_equals_that_of_small_squares(lens):
    x, y = np.random.default_rng(3).uniform(-0.7, 0.7, (2, 50))
    step = 1e-4
    corners = [lens.distort(x + dx, y + dy) for dx, dy in ((-step, -step), (step, -step), (step, step), (-step, step))]
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)) / 2
    np.testing.assert_allclose(lens.stretch(x, y), area / (4 * step * step), rtol=1e-4)


def test_lens_without_distortion_is_a_pinhole_and_a_folding_one_is_refused(tmp_path):
    for lens in (Lens(), FovLens(0.0), DivisionLens(0.0), EucmLens(0.0, 1.0)):
        assert not lens.has_distortion
    _write(tmp_path, "SIMPLE_RADIAL_FISHEYE", False)
    camera = tmp_path / "sparse" / "0" / "cameras.txt"
    camera.write_text(camera.read_text().replace("0.04", "-3"))
    with pytest.raises(DatasetError, match=r"the distortion of the lens is too large.*image_undistorter"):
        open_dataset(tmp_path, split="all")
