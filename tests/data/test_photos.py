import numpy as np
import pytest
from PIL import Image

from splatwire.data.photos import limited_size, load_photo, photo_size
from splatwire.errors import DatasetError


@pytest.fixture
def pixels():
    return np.random.default_rng(0).integers(0, 256, (6, 9, 4)).astype(np.uint8)


def test_rgb_is_divided_by_255(pixels, tmp_path):
    Image.fromarray(pixels[:, :, :3]).save(tmp_path / "a.png")
    image = load_photo(tmp_path / "a.png")
    assert image.dtype == np.float32
    assert np.array_equal(image, pixels[:, :, :3].astype(np.float32) / 255)
    assert photo_size(tmp_path / "a.png") == (9, 6)


def test_alpha_is_composed_on_the_background(pixels, tmp_path):
    Image.fromarray(pixels).save(tmp_path / "a.png")
    image = load_photo(tmp_path / "a.png", background=(1.0, 0.5, 0.0))
    colour, alpha = pixels[:, :, :3] / 255, pixels[:, :, 3:] / 255
    np.testing.assert_allclose(image, colour * alpha + np.array([1, 0.5, 0]) * (1 - alpha), atol=1e-6)


def test_grey_becomes_three_equal_channels(pixels, tmp_path):
    Image.fromarray(pixels[:, :, 0]).save(tmp_path / "a.png")
    image = load_photo(tmp_path / "a.png")
    assert np.array_equal(image[:, :, 2], pixels[:, :, 0].astype(np.float32) / 255)


def test_resizing_is_pillows_bicubic_on_bytes(pixels, tmp_path):
    picture = Image.fromarray(pixels[:, :, :3])
    picture.save(tmp_path / "a.png")
    expected = np.asarray(picture.resize((5, 3), Image.Resampling.BICUBIC), dtype=np.float32) / 255
    assert np.array_equal(load_photo(tmp_path / "a.png", (5, 3)), expected)


@pytest.mark.parametrize(
    ("size", "limit", "expected"),
    [
        ((800, 533), 1600, (800, 533)),
        ((1600, 1064), 1600, (1600, 1064)),
        ((3200, 2001), 1600, (1600, 1000)),
        ((1601, 1000), 1600, (1599, 999)),
        ((4946, 3286), 1600, (1600, 1063)),
        ((5000, 10), None, (5000, 10)),
        ((5000, 1), 10, (10, 1)),
    ],
)
def test_width_limit_reduces_photos(size, limit, expected):
    assert limited_size(*size, limit) == expected


def test_invalid_photo_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("not a picture")
    Image.fromarray(np.zeros((4, 4), dtype=np.uint16)).save(tmp_path / "deep.png")
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)).save(tmp_path / "cut.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "cut.png").read_bytes()[:3000])
    for name, reason in {"absent": "missing", "text": "not a readable", "deep": "mode I;16", "cut": "damaged"}.items():
        with pytest.raises(DatasetError, match=rf"{name}\.png: .*{reason}"):
            load_photo(tmp_path / f"{name}.png")
