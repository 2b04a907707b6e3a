"""A stream in binary glTF (docs/gltf.md): round trip, Khronos validation, and the fallback of other readers."""

import json
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from explicit import encode_splats
from splatwire import open_scene
from splatwire.bitstream import SceneStream, read_stream, stream_to_bytes, write_stream
from splatwire.cli.main import main
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.errors import BitstreamError, SplatwireError
from splatwire.files.kinds import STREAM_GLB, file_kind
from splatwire.io.formats import read_splats
from splatwire.io.formats.gltf_writer import write_gltf
from splatwire.lod.packed_gltf import write_packed_gltf
from splatwire.types import SplatScene
from splatwire.types.metadata import SceneMetadata
from web.node import WEB, lacking
from web.pictures import half_of
from web.test_page import SMALL, ball

VALIDATE = """
import { readFileSync } from "node:fs";
import validator from "gltf-validator";
const report = await validator.validateBytes(new Uint8Array(readFileSync(process.argv[1])));
console.log(JSON.stringify(report.issues));
"""


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(5000), SMALL, quality=Quality(10.0))


@pytest.fixture(scope="module")
def packed(stream: SceneStream, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file written by `pack`."""
    folder = tmp_path_factory.mktemp("gltf")
    write_stream(stream, folder / "scene.swz")
    with pytest.raises(SystemExit) as ended:
        main(["pack", str(folder / "scene.swz"), "-o", str(folder / "scene.glb")])
    assert ended.value.code == 0
    return folder / "scene.glb"


def document(path: Path) -> dict:
    data = path.read_bytes()
    (size,) = struct.unpack("<I", data[12:16])
    return json.loads(data[20 : 20 + size])


def changed(path: Path, target: Path, old: str, new: str) -> Path:
    """Replaces a text of the document by one of equal length."""
    data = path.read_bytes()
    assert data.count(old.encode()) == 1
    target.write_bytes(data.replace(old.encode(), new.ljust(len(old)).encode()))
    return target


def test_stream_in_gltf_round_trips_byte_identically(stream: SceneStream, packed: Path) -> None:
    assert file_kind(packed) == STREAM_GLB
    found, report = read_stream(packed)
    assert stream_to_bytes(found) == stream_to_bytes(stream)
    assert report.num_missing == 0
    assert open_scene(packed).num_elements == 5000


def test_lossy_stream_in_gltf_keeps_its_losses(stream: SceneStream, tmp_path: Path) -> None:
    half = half_of(stream)
    write_gltf([ball(10, degree=0)], tmp_path / "half.glb", stream=stream_to_bytes(half))
    found, report = read_stream(tmp_path / "half.glb")
    assert len(found.packets) == len(half.packets)
    assert report.num_missing == len(stream.packets) - len(half.packets)


def test_metadata_of_the_stream_are_in_the_document(tmp_path: Path) -> None:
    scene = SplatScene(ball(300), metadata=SceneMetadata(title="Quay", author="Ana", license="CC0"))
    stream = encode_scene(scene, SMALL)
    write_packed_gltf(stream, ball(20), tmp_path / "a.glb")
    asset = document(tmp_path / "a.glb")["asset"]
    assert asset["copyright"] == "Ana, CC0"
    assert asset["extras"]["title"] == "Quay"


def test_readers_without_the_extension_get_a_coarse_scene(packed: Path, tmp_path: Path) -> None:
    content = document(packed)
    assert "EXT_splatwire" not in content.get("extensionsRequired", [])
    plain = changed(packed, tmp_path / "plain.glb", '"extensions":{"EXT_splatwire":', '"unknown":{"x":')
    coarse = read_splats(changed(plain, tmp_path / "used.glb", ',"EXT_splatwire"', ""))
    assert coarse.num_gaussians == 4096
    middle = ball(5000).means.mean(axis=0)
    assert np.allclose(coarse.means.mean(axis=0), middle, atol=0.05)


@pytest.mark.slow
def test_khronos_validator_reports_unknown_attribute_names_only(packed: Path) -> None:
    """Allowed errors concern attributes of KHR_gaussian_splatting, which is newer than the validator."""
    if reason := lacking():
        pytest.skip(reason)
    words = ["node", "--input-type=module", "-e", VALIDATE, str(packed)]
    done = subprocess.run(words, cwd=WEB, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    errors = [m for m in json.loads(done.stdout)["messages"] if m["severity"] == 0]
    assert {m["code"] for m in errors} <= {"MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    assert all("/attributes/KHR_gaussian_splatting:" in m["pointer"] for m in errors)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"EXT_splatwire":{"bufferView":', '"EXT_splatwire":{"bufferVieW":'),
        ('"EXT_splatwire":{"bufferView":6', '"EXT_splatwire":{"bufferView":9'),
        ('"meshes":[', '"meshes":{'),
        (',"EXT_splatwire"]', ',"EXT_splatwire"}'),
    ],
)
def test_a_damaged_document_is_one_error(packed: Path, tmp_path: Path, old: str, new: str) -> None:
    with pytest.raises(BitstreamError, match="damaged"):
        read_stream(changed(packed, tmp_path / "bad.glb", old, new))


@pytest.mark.parametrize("length", [0, 3, 19, 20, 27, 400, 3000])
def test_truncated_file_is_one_error(packed: Path, tmp_path: Path, length: int) -> None:
    (tmp_path / "cut.glb").write_bytes(packed.read_bytes()[:length])
    with pytest.raises(SplatwireError):
        open_scene(tmp_path / "cut.glb")


def test_stream_outside_the_binary_chunk_is_refused(packed: Path, tmp_path: Path) -> None:
    view = document(packed)["bufferViews"][-1]
    old = f'"byteLength":{view["byteLength"]}}}]'
    bad = changed(
        packed, tmp_path / "bad.glb", old, old.replace(str(view["byteLength"]), "9" * len(str(view["byteLength"])))
    )
    with pytest.raises(BitstreamError, match="not within"):
        read_stream(bad)
