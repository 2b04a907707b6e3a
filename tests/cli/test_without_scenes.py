"""What is left of the command line where only numpy and tyro are installed, as on a relay."""

import subprocess
import sys
from pathlib import Path

import pytest

from splatwire.errors import EXTRAS

GOLDEN = Path(__file__).parents[1] / "golden"
BARE = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {sorted({name for names in EXTRAS.values() for name in names})}:
            raise ModuleNotFoundError(f"No module named '{{name}}'", name=name)

sys.meta_path.insert(0, Absent())
"""


def bare(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", BARE + code], capture_output=True, text=True, timeout=120)


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
