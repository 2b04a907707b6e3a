"""Antialiasing widens Gaussians and lowers their opacity by the same factor, in Python, streams and files."""

import json
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from explicit import encode_splats
from scenes import tiny_cameras
from splatwire.anchors.projection import DILATION
from splatwire.bitstream import stream_from_bytes, stream_to_bytes, write_stream
from splatwire.bitstream.sections import sections_of
from splatwire.cli.main import main
from splatwire.codec import decode_stream, encode_scene, repack, with_section
from splatwire.codec.antialiasing import SECTION
from splatwire.io import open_scene, save_scene
from splatwire.io.formats import is_antialiased
from splatwire.lod import encode_levels
from splatwire.render import render_scene
from splatwire.sequence import encode_sequence, open_sequence
from splatwire.sequence.decoding import decode_frames
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from web.test_page import SMALL, ball


def dot(size: float) -> Splats:
    """One white Gaussian at the origin."""
    turn = np.array([[1.0, 0.0, 0.0, 0.0]], np.float32)
    return Splats(
        np.zeros((1, 3), np.float32),
        turn,
        np.full((1, 3), size, np.float32),
        np.array([0.5], np.float32),
        np.full((1, 1, 3), 10.0, np.float32),
    )


def test_antialiased_dot_emits_light_of_its_own_area() -> None:
    """The antialiased dot emits light of exactly its area; without antialiasing it emits more."""
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


def test_stream_stores_antialiasing_and_others_are_unchanged() -> None:
    plain = encode_splats(ball(), SMALL)
    assert SECTION not in sections_of(plain)
    scene = SplatScene(ball(), antialiased=True)
    stream = encode_scene(scene, SMALL)
    assert sections_of(stream)[SECTION] == b""
    assert decode_stream(stream_from_bytes(stream_to_bytes(stream))[0]).scene.antialiased
    assert not decode_stream(plain).scene.antialiased
    assert decode_stream(with_section(plain, SECTION, b"")).scene.antialiased


def test_spz_stores_antialiasing(tmp_path: Path) -> None:
    import gzip

    from splatwire.io.formats.spz_writer import write_spz

    path = tmp_path / "ball.spz"
    write_spz([ball()], path, version=3)
    assert not is_antialiased(path)
    data = bytearray(gzip.decompress(path.read_bytes()))
    struct.pack_into("<B", data, 14, 1)
    path.write_bytes(gzip.compress(bytes(data)))
    assert is_antialiased(path)
    scene = open_scene(path)
    assert isinstance(scene, SplatScene)
    assert scene.antialiased


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.spz", "a.sog", "a.glb"])
def test_formats_with_an_antialiasing_flag_keep_it(name: str, tmp_path: Path) -> None:
    for wish in (False, True):
        save_scene(SplatScene(ball(), antialiased=wish), tmp_path / name)
        assert is_antialiased(tmp_path / name) is wish
        opened = open_scene(tmp_path / name)
        assert isinstance(opened, SplatScene)
        assert opened.antialiased is wish


def called(*words: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert not ended.value.code


def test_export_keeps_antialiasing_or_warns(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    source = tmp_path / "scene.swz"
    write_stream(encode_scene(SplatScene(ball(), antialiased=True), SMALL), source)
    kinds = ("ply", "compressed-ply", "spz", "sog")
    for kind, more in (*((kind, ()) for kind in kinds), ("spz", ("--harmonic-bits", "5", "4"))):
        written = tmp_path / f"b.{kind.replace('-', '.')}"
        called("export", kind, str(source), "-o", str(written), *more)
        assert is_antialiased(written)
        called("import", "splats", str(written), "-o", str(tmp_path / "c.ply"))
        assert is_antialiased(tmp_path / "c.ply")
    assert not caplog.messages
    called("export", "splat", str(source), "-o", str(tmp_path / "b.splat"))
    assert "cannot ask for antialiasing" in caplog.text


@pytest.mark.parametrize("wish", [False, True])
def test_streamed_sog_stores_antialiasing_and_levels_keep_it(wish: bool, tmp_path: Path) -> None:
    save_scene(SplatScene(ball(), antialiased=wish), tmp_path / "chunk.sog")
    zipfile.ZipFile(tmp_path / "chunk.sog").extractall(tmp_path / "0_0")
    whole = {"lods": {"0": {"file": 0, "offset": 0, "count": ball().num_gaussians}}}
    (tmp_path / "lod-meta.json").write_text(json.dumps({"filenames": ["0_0/meta.json"], "tree": whole}))
    scene = open_scene(tmp_path / "lod-meta.json")
    assert isinstance(scene, SplatScene)
    assert scene.antialiased is wish
    stream = encode_levels(scene, SMALL)
    for each in (stream, repack(stream, replace(SMALL, packet_bytes=1000))):
        assert decode_stream(each).scene.antialiased is wish


@pytest.mark.slow
def test_clip_stores_antialiasing(tmp_path: Path) -> None:
    for number in range(2):
        save_scene(SplatScene(ball(), antialiased=True), tmp_path / f"{number}.spz")
    clip, _ = encode_sequence(open_sequence(tmp_path).read())
    assert all(frame.scene.antialiased for frame in decode_frames(decode_stream(clip).scene))
