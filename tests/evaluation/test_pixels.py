import numpy as np

from splatwire.evaluation.pixels import png_bytes, png_pixels, to_pixels


def test_to_pixels_rounds_to_the_nearest_byte():
    image = np.array([[[0.0, 1.0, 0.5], [-1.0, 2.0, 1 / 255 * 0.49]]], np.float32)
    assert to_pixels(image).tolist() == [[[0, 255, 128], [0, 255, 0]]]


def test_png_keeps_every_pixel():
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    assert np.array_equal(png_pixels(png_bytes(pixels)), pixels)
