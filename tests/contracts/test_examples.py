"""Examples of the repository run as they stand."""

import importlib
import re
import runpy
import shlex
from pathlib import Path

import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.cli.main import VERBS, main
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import concealer_names
from splatwire.data import save_cameras
from splatwire.packets import Packetization, write_stream

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
]


@pytest.mark.parametrize("words", COMMANDS)
def test_commands_of_the_documents_are_understood(words, monkeypatch):
    """Verbs and options are those that there are; what a verb then does with files is for its own tests."""
    ran = []
    file, name = VERBS[words[0]].split(".")
    settings = getattr(importlib.import_module(f"splatwire.cli.{file}"), name)
    monkeypatch.setattr(settings, "run", lambda verb: ran.append(verb))
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    assert isinstance(ran[0], settings)


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_snippets_of_the_documents_run_as_they_stand(snippet):
    """Nothing is defined for them, and what they end with is a picture."""
    names = {"__name__": "snippet"}
    exec(compile(snippet, "snippet", "exec"), names)
    pictures = names.get("images", names.get("pictures"))
    assert pictures.shape[0] == 1
    assert 0.05 < float(pictures.mean()) < 0.95


def test_the_readme_has_a_snippet():
    assert any(case.id.startswith("README.md") for case in SNIPPETS)


def test_lose_and_conceal(tmp_path, capsys):
    stream = encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60))
    write_stream(stream, tmp_path / "a.swz")
    save_cameras(tiny_cameras(1, 32, 24), tmp_path / "cameras.json")
    main = runpy.run_path(str(EXAMPLES / "lose_and_conceal.py"))["main"]
    main(str(tmp_path / "a.swz"), str(tmp_path / "cameras.json"), "bernoulli:0.4")
    lines = capsys.readouterr().out.splitlines()
    assert "packets (pak) lost" in lines[0]
    assert [line.split()[0] for line in lines[1:]] == list(concealer_names(offers=decode_stream(stream).offers))
