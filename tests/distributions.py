"""Third-party packages that are installed into a folder without network or build."""

import atexit
import functools
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
FORKS = """
import importlib, json, os, pkgutil, sys
import splatwire.cli
from splatwire.cli.main import main

for module in pkgutil.iter_modules(splatwire.cli.__path__, "splatwire.cli."):
    if not module.name.endswith("_gnn"):  # imports torch, which few commands need
        importlib.import_module(module.name)
for line in sys.stdin:
    request = json.loads(line)
    if child := os.fork():
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
        continue
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, name in enumerate(request["outputs"], 1):
        os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.path.append(request["site"])
    sys.argv = request["command"]
    main()
    break
"""
"""Reads requests and runs each command in a fork, which writes to files; prints the exit status of each."""


def install_page(page: str, folder: Path) -> Path:
    """Writes the package of a page of docs/ into a folder that the caller adds to the path.

    Files are the blocks that follow "File `NAME`"; one of them is `pyproject.toml`.
    """
    folder.mkdir(exist_ok=True)
    text = (DOCS / page).read_text(encoding="utf-8")
    files = dict(re.findall(r"File `([\w.]+)`(?:(?!```).)*```\w+\n(.*?)```", text, re.DOTALL))
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    assert files
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    announce(folder, project)
    return folder


def announce(folder: Path, project: dict) -> None:
    """Writes the metadata of a package, as an installer does."""
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    head = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(head, encoding="utf-8")
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")


def run_with(site: Path, folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Runs a command in a process that finds the packages in `site`.

    The process is a fork of one that has imported all commands and nothing of `site`: imports take longer than most
    commands.
    """
    command = ["splatwire", *map(str, words)]
    path = os.pathsep.join([*filter(None, [os.environ.get("PYTHONPATH")]), str(site)])
    with tempfile.TemporaryDirectory() as texts:
        outputs = [Path(texts, name) for name in ("out", "err")]
        request = {
            "command": command, "folder": str(folder), "site": str(site), "outputs": list(map(str, outputs)),
            "environment": {**os.environ, "PYTHONPATH": path},
        }  # fmt: skip
        importer = _importer()
        assert importer.stdin is not None
        assert importer.stdout is not None
        importer.stdin.write(json.dumps(request) + "\n")
        importer.stdin.flush()
        status = int(importer.stdout.readline())
        return subprocess.CompletedProcess(command, status, *(output.read_text(encoding="utf-8") for output in outputs))


@functools.cache
def _importer() -> subprocess.Popen[str]:
    """Starts the process that forks for each command; it ends with this process."""
    importer = subprocess.Popen([sys.executable, "-c", FORKS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(importer.communicate)
    return importer
