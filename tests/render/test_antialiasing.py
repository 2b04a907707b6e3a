"""Gaussians of scenes that ask for it lose as much opacity as they are widened, in Python, in streams and files."""

import struct
from pathlib import Path

import pytest
import torch

from explicit import encode_splats
from scenes import tiny_cameras
from splatwire.codec import add_concealment, decode_stream, encode_scene
from splatwire.codec.antialiasing import SECTION
from splatwire.formats import is_antialiased
from splatwire.model.projection import DILATION
from splatwire.model.splat_scene import SplatScene
from splatwire.packets import stream_from_bytes, stream_to_bytes
from splatwire.packets.sections import sections_of
from splatwire.render import render_scene
from splatwire.scene.splats import Splats
from splatwire.scene_io import open_scene
from web.test_page import SMALL, ball


def dot(size: float) -> Splats:
    """One white Gaussian at the origin."""
    turn = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    return Splats(torch.zeros(1, 3), turn, torch.full((1, 3), size), torch.tensor([0.5]), torch.full((1, 1, 3), 10.0))


def test_a_dot_has_the_light_of_what_it_covers() -> None:
    """Its whole light is that of its own area, whatever the picture adds to it; without the wish it has more."""
    cameras = tiny_cameras(1, 240, 180)
    depth, focal = float(cameras.viewmats[0, 2, 3]), float(cameras.Ks[0, 0, 0])
    for pixels in (0.1, 0.3, 3.0):
        size = pixels * depth / focal
        plain, asked = (
            float(next(iter(render_scene(SplatScene(dot(size), antialiased=wish), cameras))).sum())
            for wish in (False, True)
        )
        share = pixels**2 / (pixels**2 + DILATION)
        assert asked / plain == pytest.approx(share, rel=0.25 if pixels < 1 else 0.05)


def test_streams_say_it_and_others_are_what_they_always_were() -> None:
    plain = encode_splats(ball(), SMALL)
    assert SECTION not in sections_of(plain)
    scene = SplatScene(ball(), antialiased=True)
    stream = encode_scene(scene, SMALL)
    assert sections_of(stream)[SECTION] == b""
    assert decode_stream(stream_from_bytes(stream_to_bytes(stream))[0]).scene.antialiased
    assert not decode_stream(plain).scene.antialiased
    assert decode_stream(add_concealment(plain, SECTION, b"")).scene.antialiased


def test_an_spz_says_it(tmp_path: Path) -> None:
    import gzip

    from splatwire.formats.spz import write_spz

    path = tmp_path / "ball.spz"
    write_spz([ball()], path)
    assert not is_antialiased(path)
    data = bytearray(gzip.decompress(path.read_bytes()))
    struct.pack_into("<B", data, 14, 1)
    path.write_bytes(gzip.compress(bytes(data)))
    assert is_antialiased(path)
    scene = open_scene(path)
    assert isinstance(scene, SplatScene)
    assert scene.antialiased
