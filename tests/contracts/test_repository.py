"""Requirements, licences, links, documented constants and supported interpreters of the repository."""

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from splatwire.errors import EXTRAS
from splatwire.sequence.live_encoder import PERIOD_BYTES, PERIOD_GROUPS
from splatwire.sequence.options import GROUP_FRAMES
from splatwire.transport.protocol.messages import MAX_NACKS
from splatwire.transport.protocol.nack import MAX_NACK_ATTEMPTS, NACK_INTERVAL_S
from splatwire.transport.protocol.receiver import REORDER_THRESHOLD

REPOSITORY = Path(__file__).resolve().parents[2]


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


def test_extras_match_the_error_messages():
    called = {
        "PIL": "pillow",
        "moq": "moq-rs",
        "prometheus_client": "prometheus-client",
        "jwt": "pyjwt",
        "pxr": "usd-core",
    }
    for extra, modules in EXTRAS.items():
        lines = _project()["project"]["optional-dependencies"][extra]
        named = {_name(line) for line in lines if not line.startswith("splatwire[")}
        assert named == {called.get(module, module) for module in modules}


@pytest.mark.needs_torch
def test_no_dependency_has_a_copyleft_licence():
    """Reads the licence metadata of every installed pinned package; a few known packages are excluded by name."""
    text = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8")
    assert not re.search(r"^(torchac|zfec|plyfile|pykdtree)==", text, re.MULTILINE)
    pinned = re.findall(r"^([A-Za-z0-9._-]+)==", text, re.MULTILINE)
    licences = {name: _licence(name) for name in pinned if _is_installed(name)}
    assert {"numpy", "torch"} <= set(licences)
    assert {name: words for name, words in licences.items() if re.search(r"GPL|General Public", words)} == {}
    assert [name for name, words in licences.items() if not words] == []


def _is_installed(name: str) -> bool:
    try:
        return bool(importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return False


def _licence(name: str) -> str:
    facts = importlib.metadata.metadata(name)
    classes = [line for line in facts.get_all("Classifier") or [] if line.startswith("License")]
    fields = {name: (facts.get_all(name) or [""])[0].strip() for name in ("License", "License-Expression")}
    return " ".join(filter(None, [fields["License-Expression"], fields["License"].partition("\n")[0], *classes]))


DOCUMENTS = [REPOSITORY / name for name in ("README.md", "CHANGELOG.md")] + sorted((REPOSITORY / "docs").glob("*.md"))


@pytest.mark.parametrize("path", [str(path.relative_to(REPOSITORY)) for path in DOCUMENTS])
def test_local_links_of_documents_resolve(path):
    document = REPOSITORY / path
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", document.read_text(encoding="utf-8")):
        if "://" not in target and not target.startswith("reference/"):  # pages that mkdocs generates
            assert (document.parent / target).exists(), f"{path} points to {target}"


@pytest.mark.parametrize(
    ("page", "text"),
    [
        ("transport.md", f"after {NACK_INTERVAL_S:g} s at the earliest"),
        ("transport.md", f"at most {MAX_NACK_ATTEMPTS} times"),
        ("transport.md", f"when a packet {REORDER_THRESHOLD} "),
        ("wire.md", f"together at most {MAX_NACKS}"),
        ("glossary.md", f", {GROUP_FRAMES} by default"),
        ("motion.md", f"({GROUP_FRAMES}; `--group`)"),
        ("motion.md", f"after {PERIOD_GROUPS} groups or {PERIOD_BYTES >> 20} MiB"),
        ("glossary.md", f"after {PERIOD_GROUPS} groups or {PERIOD_BYTES >> 20} MiB (DASH)"),
    ],
)
def test_documents_state_the_constants_of_the_code(page, text):
    assert text in (REPOSITORY / "docs" / page).read_text(encoding="utf-8")


def test_minimum_python_version_is_consistent():
    project = _project()
    oldest = project["project"]["requires-python"].removeprefix(">=")
    assert project["tool"]["mypy"]["python_version"] == oldest
    assert project["tool"]["ruff"]["target-version"] == "py" + oldest.replace(".", "")


def test_package_is_marked_as_typed():
    assert (REPOSITORY / "src" / "splatwire" / "py.typed").is_file()


def test_interpreter_that_does_not_start_is_skipped_with_a_message(tmp_path):
    """An example is the shim of a version manager. An interpreter that starts is listed."""
    for name, line in (("python3.12", "exit 127"), ("python3.13", f'exec "{sys.executable}" "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{line}\n")
        (tmp_path / name).chmod(0o755)
    for tool in ("dirname", "mktemp", "rm", "env", "bash"):
        (tmp_path / tool).symlink_to(next(p for f in os.defpath.split(":") if (p := Path(f) / tool).exists()))
    command = [str(REPOSITORY / ".ci" / "interpreters"), "--list"]
    done = subprocess.run(command, env={"PATH": str(tmp_path)}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == ["python3.12: skipped, it does not start, or lacks venv", "python3.13: there"]
