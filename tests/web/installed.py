"""The npm package as users get it: packed and installed into separate projects."""

import fcntl
import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

from web.node import WEB, lacking

TSCONFIG = {
    "compilerOptions": {
        "target": "es2022", "module": "esnext", "moduleResolution": "bundler", "lib": ["es2022", "dom"], "types": [],
        "strict": True, "noEmit": True, "skipLibCheck": False,
    },
    "include": ["*.ts"],
}  # fmt: skip


def called(words: list[str], folder: Path) -> str:
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def package(factory: pytest.TempPathFactory) -> Path:
    """File that `npm publish` would upload, in the folder of its content `splatwire`; all test processes share it."""
    if reason := lacking():
        pytest.skip(reason)
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "npm"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as one_at_a_time:
        fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
        if not list(folder.glob("*.tgz")):
            called(["node", "scripts/package.mjs", str(folder / "splatwire")], WEB)
            called(["npm", "pack", "--silent", "./splatwire"], folder)
    [file] = folder.glob("*.tgz")
    return file


def install(folder: Path, packed: Path, others: Mapping[str, str]) -> None:
    """Turns the folder into a project with the package and other packages, by version.

    The test is skipped if npm reaches no registry.
    """
    project = {"name": "theirs", "private": True, "type": "module", "devDependencies": dict(others)}
    (folder / "package.json").write_text(json.dumps(project))
    (folder / "tsconfig.json").write_text(json.dumps(TSCONFIG))
    words = ["npm", "install", "--no-audit", "--no-fund", "--loglevel=error", str(packed)]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=1200)
    if done.returncode and ("ENOTFOUND" in done.stderr or "ECONNREFUSED" in done.stderr or "EAI_AGAIN" in done.stderr):
        pytest.skip(f"npm reaches no registry, so the package was not installed anywhere: {done.stderr[-200:]}")
    assert done.returncode == 0, done.stderr
