"""Start-up time of each verb in a fresh process, with an empty and with a full cache of kernels.

    python benchmarks/cold_start.py [--json FILE]

Processor seconds include child processes and depend less on other load than wall seconds, which are reported as well.
`first_word_s` is the time of the first output on a terminal, `compiled` the number of functions that numba compiled,
`compile_s` their time.
"""

import argparse
import contextlib
import json
import os
import pty
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ASSETS = Path(__file__).resolve().parents[1] / "src" / "splatwire" / "assets"
VERBS = {
    "--version": ["--version"],
    "decode": ["decode", "{assets}/snowmiku.swz", "-o", "{folder}/a.scene"],
    "encode": ["encode", "{folder}/a.scene", "-o", "{folder}/a.swz"],
    "render": ["render", "{folder}/a.scene", "--cameras", "{assets}/snowmiku_cameras.json", "-o", "{folder}/views"],
    "demo": ["demo", "-o", "{folder}/demo"],
}
_PROGRAM = """
import json, os, sys, threading, time
from splatwire.cli.main import main
began, found = threading.local(), [0, 0.0]

def count():
    from numba.core import event
    class Compiled(event.Listener):
        def on_start(self, e):
            began.stack = [*getattr(began, "stack", []), time.thread_time()]
        def on_end(self, e):
            start = began.stack.pop()
            found[0] += 1
            found[1] += 0.0 if began.stack else time.thread_time() - start
    event.register("numba:compile", Compiled())

if sys.argv[1] != "--version":
    count()
try:
    main(sys.argv[1:])
finally:
    with open(os.environ["COUNTED"], "w") as file:
        json.dump({"compiled": found[0], "compile_s": found[1]}, file)
"""


def run(words: list[str], folder: Path, cache: Path) -> dict[str, float]:
    """Runs a verb and measures it."""
    words = [word.format(assets=ASSETS, folder=folder) for word in words]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "COUNTED": str(folder / "counted.json")}
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    ours, theirs = pty.openpty()  # output on a terminal
    command = [sys.executable, "-c", _PROGRAM, *words]
    with subprocess.Popen(command, env=environment, stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        os.read(ours, 1)
        first = time.perf_counter() - began
        with contextlib.suppress(OSError):  # so the end of a terminal is reported
            while os.read(ours, 1 << 16):
                pass
    os.close(ours)
    assert process.returncode == 0, words
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cost = {
        "first_word_s": first,
        "wall_s": time.perf_counter() - began,
        "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        **json.loads((folder / "counted.json").read_text()),
    }
    return {key: round(value, 2) for key, value in cost.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--verbs", nargs="*", default=list(VERBS), choices=list(VERBS))
    arguments = parser.parse_args()
    found: dict[str, object] = {"cores": os.cpu_count(), "load": round(os.getloadavg()[0], 1)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(VERBS["decode"], folder, folder / "prepared")
        for verb in arguments.verbs:
            cold = run(VERBS[verb], folder, folder / f"cache{verb}")
            found[verb] = {"cold": cold, "warm": run(VERBS[verb], folder, folder / f"cache{verb}")}
            print(verb, json.dumps(found[verb]), flush=True)
            if arguments.json is not None:
                arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
