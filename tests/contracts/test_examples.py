"""Examples of the repository run unchanged."""

import json
import re
import runpy
import shlex
from pathlib import Path

import pytest

from explicit import ball_of_gaussians
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.cli._parsing import settings_of
from splatwire.cli.main import main
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import concealer_names
from splatwire.data import save_cameras
from splatwire.io import save_scene

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]
EXAMPLES = REPOSITORY / "examples"
SNIPPETS = [
    pytest.param(found, id=f"{document.name}-{number}")
    for document in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
    for number, found in enumerate(re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL))
]
COMMANDS = [
    pytest.param(shlex.split(line, comments=True)[1:], id=f"{document.name}-{number}")
    for document in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
    for block in re.findall(
        r"```(?:bash|sh)\n(.*?)```", document.read_text(encoding="utf-8").replace("\\\n", ""), re.DOTALL
    )
    for number, line in enumerate(block.splitlines())
    if line.startswith("splatwire ")
    and not line.startswith(("splatwire --tyro-print-completion", "splatwire --manual"))
]


@pytest.mark.parametrize("words", COMMANDS)
def test_documented_commands_parse(words, monkeypatch):
    """Verbs and options exist; other tests check the work of each verb."""
    ran = []
    settings = settings_of(words[0])
    monkeypatch.setattr("splatwire.cli.main._execute", lambda verb, options: ran.append(options))
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    assert isinstance(ran[0], settings)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_documented_shell_completions_are_printed(shell, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--tyro-print-completion", shell])
    assert not ended.value.code
    assert "splatwire" in capsys.readouterr().out


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_documented_snippets_run(snippet):
    """Snippets run without definitions from elsewhere and end with a picture."""
    names = {"__name__": "snippet"}
    exec(compile(snippet, "snippet", "exec"), names)
    pictures = names.get("images", names.get("pictures"))
    assert pictures.shape[0] == 1
    assert 0.05 < float(pictures.mean()) < 0.95


def test_the_readme_has_a_snippet():
    assert any(case.id.startswith("README.md") for case in SNIPPETS)


def test_example_lose_and_conceal_runs(tmp_path, capsys):
    stream = encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60))
    write_stream(stream, tmp_path / "a.swz")
    save_cameras(tiny_cameras(1, 32, 24), tmp_path / "cameras.json")
    main = runpy.run_path(str(EXAMPLES / "lose_and_conceal.py"))["main"]
    main(str(tmp_path / "a.swz"), str(tmp_path / "cameras.json"), "bernoulli:0.4")
    lines = capsys.readouterr().out.splitlines()
    assert "packets (pak) lost" in lines[0]
    assert [line.split()[0] for line in lines[1:]] == list(concealer_names(provides=decode_stream(stream).provides))


def test_notebook_of_codecs_runs_and_compares_all_files(tmp_path, capsys, monkeypatch):
    """Its cells run in a folder with a small scene, in one namespace."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    save_scene(ball_of_gaussians(), "scene.ply")
    cells = json.loads((EXAMPLES / "compare_codecs.ipynb").read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "compare_codecs.ipynb", "exec"), names)
    lines = [line for line in capsys.readouterr().out.splitlines() if "bytes" in line]
    assert [line[:24].strip() for line in lines] == [
        "splatwire small", "splatwire default", "splatwire near-lossless", "SPZ", "compressed PLY"
    ]  # fmt: skip
    assert (tmp_path / "compared/report/rate_distortion.csv").is_file()
