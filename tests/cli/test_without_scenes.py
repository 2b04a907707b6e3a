"""Commands that work with numpy and tyro alone, as on a relay."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import splatwire
from scenes import tiny_cameras, tiny_causal_scene, tiny_scene
from splat_io.formats.handmade import some_splats
from splatwire.bitstream import read_stream
from splatwire.bitstream.sections import sections_of
from splatwire.data import save_cameras
from splatwire.errors import EXTRAS
from splatwire.io import save_scene
from splatwire.io.formats import write_splats
from splatwire.types import AnchorScene

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[1] / "golden"
ALL = sorted({name for names in EXTRAS.values() for name in names})
BARE = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ABSENT:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)

sys.meta_path.insert(0, Absent())
"""


def bare(code: str, absent: list[str] = ALL) -> subprocess.CompletedProcess[str]:
    program = f"ABSENT = {absent}{BARE}{code}"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=600)


@pytest.mark.parametrize(
    "words", [["transmit", "--loss", "bernoulli:0.2"], ["pack"]], ids=["losing packets", "packing a page"]
)
def test_streams_are_transported_without_scene_dependencies(words: list[str], tmp_path: Path) -> None:
    verb, *rest = words
    all_words = [verb, str(GOLDEN / "tiny_causal.swz"), "-o", str(tmp_path / "out"), *rest]
    done = bare(f"from splatwire.cli.main import main; main({all_words})")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out").stat().st_size > 1000


def test_missing_scene_dependencies_name_the_extra_to_install(tmp_path: Path) -> None:
    words = ["decode", str(GOLDEN / "tiny_causal.swz"), "-o", str(tmp_path / "scene.ply")]
    done = bare(f"from splatwire.cli.main import main; main({words})")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "pip install 'splatwire[scenes]'" in done.stderr
    assert "pip install 'splatwire[scenes]'" in bare("import splatwire; splatwire.decode_stream").stderr


def without_torch(*commands: tuple[object, ...]) -> subprocess.CompletedProcess[str]:
    """Runs commands one after another, up to the first that fails, in one process without torch."""
    all_words = [[str(word) for word in command] for command in commands]
    code = f"""
from splatwire.cli.main import main
for words in {all_words}:
    try:
        main(words)
    except SystemExit as end:
        if end.code:
            raise
"""
    return bare(code, ["torch", "gsplat"])


@pytest.mark.extended
@pytest.mark.parametrize("make", [tiny_scene, tiny_causal_scene])
def test_scenes_of_anchors_need_no_torch(make: Callable[..., AnchorScene], tmp_path: Path) -> None:
    save_scene(make(num_anchors=200), tmp_path / "scene.safetensors")
    save_cameras(tiny_cameras(9, 48, 32), tmp_path / "cameras.json")
    scene, stream, cameras = (tmp_path / name for name in ("scene.safetensors", "scene.swz", "cameras.json"))
    done = without_torch(
        ("encode", scene, "-o", stream, "--cameras", cameras),
        ("transmit", stream, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.3"),
        ("decode", tmp_path / "lossy.swz", "-o", tmp_path / "back.safetensors", "--conceal", "grow"),
        ("export", "ply", stream, "-o", tmp_path / "fitted.ply", "--cameras", cameras),
        ("calibrate", "preview", scene, "-o", tmp_path / "more.swz", "--cameras", cameras),
    )
    assert done.returncode == 0, done.stderr
    assert "preview" in sections_of(read_stream(tmp_path / "more.swz")[0])


@pytest.mark.extended
def test_sketches_of_anchors_need_no_torch(tmp_path: Path) -> None:
    bundled = Path(splatwire.__file__).parent / "assets" / "snowmiku.swz"
    done = without_torch(
        ("decode", bundled, "-o", tmp_path / "scene.safetensors"),
        ("encode", tmp_path / "scene.safetensors", "-o", tmp_path / "scene.swz", "--preset", "datagram"),
    )
    assert done.returncode == 0, done.stderr
    assert "without a sketch" not in done.stderr
    assert "sketch" in sections_of(read_stream(tmp_path / "scene.swz")[0])


@pytest.mark.extended
def test_gaussians_get_their_sketch_without_torch(tmp_path: Path) -> None:
    write_splats([some_splats(300, 0)], tmp_path / "scene.ply")
    done = without_torch(("encode", tmp_path / "scene.ply", "-o", tmp_path / "scene.swz", "--preset", "datagram"))
    assert done.returncode == 0, done.stderr
    assert "torch" not in done.stderr


@pytest.mark.parametrize("name", ["idw", "kriging"])
def test_concealers_of_the_paper_name_the_extra_to_install(name: str, tmp_path: Path) -> None:
    done = without_torch(("decode", GOLDEN / "tiny_causal.swz", "-o", tmp_path / "back.safetensors", "--conceal", name))
    assert done.returncode == 2
    assert "pip install 'splatwire[neural]'" in done.stderr
