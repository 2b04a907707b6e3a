import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.scene_file import save_scene
from splatwire.cli.main import main
from splatwire.data import save_cameras


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """Standard output, which must be exactly one JSON object."""
        content = json.loads(self.out)
        assert isinstance(content, dict)
        return content


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]):
    """Runs a command line in this process."""

    def call(*words: object) -> Outcome:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main([str(word) for word in words])
        captured = capsys.readouterr()
        code = stopped.value.code
        return Outcome(code if isinstance(code, int) else 1, captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def journey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a scene, its cameras, its stream and the stream after losses."""
    folder = tmp_path_factory.mktemp("journey")
    save_scene(tiny_scene(seed=3, num_anchors=240), folder / "tiny.scene")
    save_cameras(tiny_cameras(num_views=2, width=64, height=48), folder / "cameras.json")
    for words in (
        ["encode", folder / "tiny.scene", "-o", folder / "tiny.swz", "--block-size", 60, "--json"],
        ["transmit", folder / "tiny.swz", "-o", folder / "lossy.swz", "--loss", "bernoulli:0.3", "--seed", 1],
        ["transmit", folder / "tiny.swz", "-o", folder / "packets", "--loss", "none"],
    ):
        with pytest.raises(SystemExit) as stopped:
            main([str(word) for word in words])
        assert stopped.value.code == 0
    return folder
