import numpy as np
import pytest
from PIL import Image

from splatwire.data.photos import has_exif_rotation, limited_size, load_photo, photo_size
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


def test_large_photos_give_no_warning_of_pillow_and_larger_ones_an_error(tmp_path, monkeypatch):
    """Pillow calls photos of more than 89 million pixels a possible attack."""
    Image.fromarray(np.full((10, 15, 3), 128, np.uint8)).save(tmp_path / "a.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    assert photo_size(tmp_path / "a.png") == (15, 10)
    assert load_photo(tmp_path / "a.png").shape == (10, 15, 3)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 70)
    with pytest.raises(DatasetError, match=r"has more than 140 pixels.*: scale the photo down"):
        photo_size(tmp_path / "a.png")


def test_damaged_metadata_of_a_photo_gives_no_warning_of_pillow(tmp_path):
    metadata = Image.Exif()
    metadata[0x112] = 6
    metadata[0x10E] = "A long description of the picture"
    data = bytearray(metadata.tobytes())
    data[data.index(b"A long") - 26 :] = b""  # cut within the table of tags
    Image.fromarray(np.full((10, 15, 3), 128, np.uint8)).save(tmp_path / "a.jpg", exif=bytes(data))
    assert sorted(photo_size(tmp_path / "a.jpg", apply_exif=True)) == [10, 15]
    loaded = load_photo(tmp_path / "a.jpg", apply_exif=True)
    assert not has_exif_rotation(tmp_path / "a.jpg") or loaded.shape == (15, 10, 3)


@pytest.mark.parametrize("brand", ["heic", "mif1", "avif"])
def test_a_heic_or_avif_picture_is_named(brand, tmp_path):
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftyp" + brand.encode() + bytes(200))
    with pytest.raises(DatasetError, match="it looks like a HEIC or AVIF picture: convert it to JPEG or PNG"):
        load_photo(tmp_path / "a.heic")
