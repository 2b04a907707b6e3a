"""The short names of `import splatwire`: examples of their docstrings run, and options fit the kind of scene."""

import doctest
import importlib
import io
import re
import typing

import numpy as np
import pytest
from PIL import Image

import splatwire
from moving_sequences import moving_frames
from scenes import tiny_cameras, tiny_scene
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError, check_kind
from splatwire.render import Pictures

MODULES = (
    "splatwire.api.coding", "splatwire.api.scoring", "splatwire.api.network",
    pytest.param("splatwire.api.training", marks=pytest.mark.slow),
)  # fmt: skip


@pytest.fixture(scope="module")
def scene() -> splatwire.SplatScene:
    draw = np.random.default_rng(0)
    count = 400

    def random(*shape: int) -> np.ndarray:
        return draw.random(shape, np.float32)

    splats = splatwire.Splats(
        random(count, 3) - np.float32(0.5), random(count, 4), random(count, 3) * np.float32(0.05),
        random(count) * np.float32(0.9) + np.float32(0.05), random(count, 1, 3),
    )  # fmt: skip
    return splatwire.SplatScene(splats)


@pytest.mark.parametrize("module", MODULES)
def test_examples_of_docstrings_run(module, scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    splatwire.save_scene(scene, "scene.ply")
    splatwire.write_stream(splatwire.encode(scene, splatwire.GaussianOptions("datagram")), "scene.swz")
    save_cameras(tiny_cameras(2, 32, 24), "cameras.json")
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted > 0
    assert result.failed == 0


def test_encode_gives_the_stream_of_encode_scene(scene):
    tiers = np.arange(400) % 2
    options = splatwire.GaussianOptions("paper", quality="small", tiers=tiers)
    assert splatwire.encode(scene, options) == splatwire.encode_scene(scene, "paper", quality="small", tiers=tiers)


def test_frames_are_encoded_with_their_own_options():
    frames = moving_frames(60, 2)
    stream = splatwire.encode(frames, splatwire.SequenceOptions(quality="small"))
    assert stream.manifest.schema_name == "tracks"
    with pytest.raises(InvalidValueError, match="threads in SequenceOptions"):
        splatwire.encode(frames, splatwire.SequenceOptions(), threads=1)


def test_options_of_another_kind_of_scene_are_refused(scene):
    with pytest.raises(InvalidValueError, match="options: expected GaussianOptions for Gaussians, not AnchorOptions"):
        splatwire.encode(scene, splatwire.AnchorOptions())
    with pytest.raises(InvalidValueError, match="options: expected AnchorOptions for anchors, not GaussianOptions"):
        splatwire.encode(tiny_scene(num_anchors=30), splatwire.GaussianOptions())


def test_messages_about_wrong_arguments_name_what_works(scene):
    stream = splatwire.encode(scene)
    for call, message in (
        (
            lambda: check_kind(stream, splatwire.ReceivedScene, "decode_stream"),
            r"expected ReceivedScene \(`decode_stream` returns one\)",
        ),
        (
            lambda: check_kind(scene, splatwire.Splats, "open_scene(...).splats"),
            r"expected Splats \(`open_scene\(...\).splats` is one\)",
        ),
        (lambda: splatwire.encode([scene.splats] * 2), "not list: frames need the options `SequenceOptions`"),
    ):
        with pytest.raises(splatwire.InvalidValueError, match=message):
            call()


def test_decode_takes_a_stream_its_bytes_or_its_path(scene, tmp_path):
    stream = splatwire.encode(scene)
    splatwire.write_stream(stream, tmp_path / "a.swz")
    means = [
        splatwire.decode(source).scene.positions
        for source in (stream, (tmp_path / "a.swz").read_bytes(), tmp_path / "a.swz", str(tmp_path / "a.swz"))
    ]
    assert all(np.array_equal(found, means[0]) for found in means)


def test_pictures_are_arrays_that_notebooks_show(scene):
    images = splatwire.render_scene(scene, tiny_cameras(2, 32, 24), background=(1.0, 0.0, 0.0))
    assert isinstance(images, Pictures)
    shown = np.asarray(Image.open(io.BytesIO(images._repr_png_())))
    assert shown.shape == (24, 64, 3)
    assert np.array_equal(shown[:, 32:], np.rint(255 * images[1]).astype(np.uint8))
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(images[0]._repr_png_()))), shown[:, :32])
    assert images[0, 0]._repr_png_() is None
    many = np.ones((3, 2, 7000, 3), np.float32)
    assert Image.open(io.BytesIO(many.view(Pictures)._repr_png_())).size == (14_000, 2)  # browsers have a limit
    assert type(images - images) is np.ndarray
    assert type(images.mean()) is np.float32
    assert type(images.max(axis=(1, 2))) is np.ndarray


def test_scores_are_those_of_the_metrics_per_view(scene):
    cameras = tiny_cameras(2, 32, 24)
    same = splatwire.evaluate(scene, scene, cameras)
    assert np.isinf(same.psnr).all()
    assert np.allclose(same.ssim, 1)
    black = splatwire.evaluate(scene, np.zeros((2, 24, 32, 3), np.float32), cameras)
    assert (black.psnr < 40).all()
    listed = splatwire.evaluate(scene, [np.zeros((24, 32, 3), np.float32)] * 2, cameras)
    assert np.array_equal(listed.psnr, black.psnr)


@pytest.mark.needs_torch
def test_results_have_types():
    """`Any` in a result would switch off a type checker in a program that uses it."""
    for name in vars(splatwire)["__all__"]:
        value = getattr(splatwire, name)
        if callable(value) and not isinstance(value, type):
            assert "Any" not in re.findall(r"\w+", str(value.__annotations__["return"])), name
            assert value.__annotations__["return"] is not typing.Any
