"""Promises of the repository itself."""

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from splatwire.errors import EXTRAS

REPOSITORY = Path(__file__).resolve().parents[2]
MAX_DEMO_BYTES = 6_000_000


def _project():
    return tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))


def _name(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[\s<>=!~\[;]", requirement, maxsplit=1)[0]).lower()


def test_every_requirement_is_pinned():
    lines = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    project = _project()
    wanted = project["project"]["dependencies"] + project["dependency-groups"]["dev"]
    wanted += [
        line
        for extra in ("scenes", "neural", "report", "relay")
        for line in project["project"]["optional-dependencies"][extra]
    ]
    assert {_name(requirement) for requirement in wanted} - {"splatwire"} <= set(pins)
    assert pins["torch"] == "2.13.0"


def test_an_extra_is_what_errors_say_of_it():
    called = {"PIL": "pillow", "moq": "moq-rs"}
    for extra, modules in EXTRAS.items():
        lines = _project()["project"]["optional-dependencies"][extra]
        named = {_name(line) for line in lines if not line.startswith("splatwire[")}
        assert named == {called.get(module, module) for module in modules}


def test_no_dependency_has_a_viral_licence():
    """By what every pinned package that is installed says of itself; those that this field likes, by name."""
    text = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8")
    assert not re.search(r"^(torchac|zfec|plyfile|pykdtree)==", text, re.MULTILINE)
    pinned = re.findall(r"^([A-Za-z0-9._-]+)==", text, re.MULTILINE)
    said = {name: _licence(name) for name in pinned if _there(name)}
    assert {"numpy", "torch"} <= set(said)
    assert {name: words for name, words in said.items() if re.search(r"GPL|General Public", words)} == {}
    assert [name for name, words in said.items() if not words] == []


def _there(name: str) -> bool:
    try:
        return bool(importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return False


def _licence(name: str) -> str:
    facts = importlib.metadata.metadata(name)
    classes = [line for line in facts.get_all("Classifier") or [] if line.startswith("License")]
    said = {name: (facts.get_all(name) or [""])[0].strip() for name in ("License", "License-Expression")}
    return " ".join(filter(None, [said["License-Expression"], said["License"].partition("\n")[0], *classes]))


def test_the_bundled_scene_is_small():
    assets = [path for path in (REPOSITORY / "src" / "splatwire" / "assets").rglob("*") if path.is_file()]
    assert assets
    assert sum(path.stat().st_size for path in assets) <= MAX_DEMO_BYTES


DOCUMENTS = [REPOSITORY / name for name in ("README.md", "CHANGELOG.md")] + sorted((REPOSITORY / "docs").glob("*.md"))


@pytest.mark.parametrize("path", [str(path.relative_to(REPOSITORY)) for path in DOCUMENTS])
def test_local_links_of_documents_lead_somewhere(path):
    document = REPOSITORY / path
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", document.read_text(encoding="utf-8")):
        if "://" not in target and not target.startswith("reference/"):  # pages that the site makes
            assert (document.parent / target).exists(), f"{path} points to {target}"


def test_readme_names_ci_run_and_ci_run_makes_every_check():
    assert re.search(r"^\.ci/run$", (REPOSITORY / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    script = REPOSITORY / ".ci" / "run"
    assert script.stat().st_mode & 0o111
    steps = re.findall(
        r"^ *(?:CHECKED=.* )?(?:step|beside \w+) (.*)$", script.read_text(encoding="utf-8"), re.MULTILINE
    )
    for check in ("ruff check", "ruff format --check", "mypy", "lint-imports", "mkdocs build", "pytest", ".ci/interp"):
        assert sum(check in step for step in steps) == 1, check
    assert any("--constraint constraints.txt" in step for step in steps)


def test_every_place_claims_the_same_oldest_python():
    project = _project()
    oldest = project["project"]["requires-python"].removeprefix(">=")
    assert project["tool"]["mypy"]["python_version"] == oldest
    assert project["tool"]["ruff"]["target-version"] == "py" + oldest.replace(".", "")
    assert f"Python {oldest} or newer" in (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert f"sys.version_info < {tuple(map(int, oldest.split('.')))}" in (REPOSITORY / ".ci" / "run").read_text()
    checked = re.search(r"^for python in (.*); do$", (REPOSITORY / ".ci" / "interpreters").read_text(), re.MULTILINE)
    assert checked is not None
    assert checked[1].split()[0] == "python" + oldest


def test_type_checkers_may_use_the_annotations():
    assert (REPOSITORY / "src" / "splatwire" / "py.typed").is_file()


def test_an_interpreter_that_does_not_start_is_skipped_with_a_word(tmp_path):
    """Such as a version manager's shim; one that starts is checked."""
    for name, line in (("python3.12", "exit 127"), ("python3.13", f'exec "{sys.executable}" "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{line}\n")
        (tmp_path / name).chmod(0o755)
    for tool in ("dirname", "mktemp", "rm", "env", "bash"):
        (tmp_path / tool).symlink_to(next(p for f in os.defpath.split(":") if (p := Path(f) / tool).exists()))
    command = [str(REPOSITORY / ".ci" / "interpreters"), "--list"]
    done = subprocess.run(command, env={"PATH": str(tmp_path)}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == ["python3.12: skipped, it does not start, or lacks venv", "python3.13: there"]
