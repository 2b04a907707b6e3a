"""What is left of the command line where only numpy and tyro are installed, as on a relay."""

import subprocess
import sys
from pathlib import Path

import pytest

from formats.handmade import some_splats
from splatwire.errors import EXTRAS
from splatwire.formats import write_splats

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
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    "words", [["transmit", "--loss", "bernoulli:0.2"], ["pack"]], ids=["losing packets", "packing a page"]
)
def test_streams_are_carried_without_what_looks_into_scenes(words: list[str], tmp_path: Path) -> None:
    verb, *rest = words
    all_words = [verb, str(GOLDEN / "tiny_causal.swz"), "-o", str(tmp_path / "out"), *rest]
    done = bare(f"from splatwire.cli.main import main; main({all_words})")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out").stat().st_size > 1000


def test_what_looks_into_a_scene_says_what_to_install(tmp_path: Path) -> None:
    words = ["decode", str(GOLDEN / "tiny_causal.swz"), "-o", str(tmp_path / "scene.ply")]
    done = bare(f"from splatwire.cli.main import main; main({words})")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "pip install 'splatwire[scenes]'" in done.stderr
    assert "pip install 'splatwire[scenes]'" in bare("import splatwire; splatwire.decode_stream").stderr


def test_without_torch_gaussians_are_encoded_for_datagrams_without_a_sketch(tmp_path: Path) -> None:
    write_splats([some_splats(300, 0)], tmp_path / "scene.ply")
    words = ["encode", str(tmp_path / "scene.ply"), "-o", str(tmp_path / "scene.swz"), "--preset", "datagram"]
    done = bare(f"from splatwire.cli.main import main; main({words})", ["torch"])
    assert done.returncode == 0, done.stderr
    assert "without a sketch: this needs torch" in done.stderr
    words = ["decode", str(tmp_path / "scene.swz"), "-o", str(tmp_path / "back.ply"), "--conceal", "idw"]
    done = bare(f"from splatwire.cli.main import main; main({words})", ["torch"])
    assert done.returncode == 2
    assert "pip install 'splatwire[neural]'" in done.stderr
