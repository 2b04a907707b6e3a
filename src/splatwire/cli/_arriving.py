"""Files that appear while a live clip is encoded: in a folder, or named in a pipe."""

import os
import select
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

LOOK_S = 0.02
"""A folder is looked at so often."""


def names_of_a_pipe(stop: Callable[[], bool]) -> Iterator[Path | None]:
    """Files named on standard input, one a line, until it ends; None while nothing comes.

    Args:
        stop: Whether to end.
    """
    source, rest = sys.stdin.fileno(), b""
    while not stop():
        if not select.select([source], [], [], LOOK_S)[0]:
            yield None
            continue
        some = os.read(source, 1 << 16)
        *lines, rest = (rest + (some or b"\n")).split(b"\n")
        yield from (Path(os.fsdecode(line.strip())) for line in lines if line.strip())
        if not some:
            return


def files_of(folder: Path, stop: Callable[[], bool]) -> Iterator[Path | None]:
    """Frames of a folder, each as soon as it is there and has stopped growing; None while nothing new is.

    What was removed is forgotten: who writes for days tidies up, and may use its names again.

    Args:
        folder: The folder.
        stop: Whether to end.
    """
    from splatwire.clips.frames import by_number, is_frame

    done: set[str] = set()
    sizes: dict[str, tuple[int, int]] = {}
    while not stop():
        found = list(folder.iterdir())
        done &= {path.name for path in found}
        new = sorted((path for path in found if path.name not in done), key=by_number)
        ready = [path for path in new if _settled(path, sizes) and is_frame(path)]
        for path in ready:
            done.add(path.name)
            sizes.pop(path.name, None)
            yield path
        if not ready:
            time.sleep(LOOK_S)
            yield None


def _settled(path: Path, sizes: dict[str, tuple[int, int]]) -> bool:
    """Whether a file is as it was when it was last looked at, a moment ago."""
    try:
        facts = path.stat()
    except OSError:  # it was moved away
        return False
    now = (facts.st_size, facts.st_mtime_ns)
    before = sizes.get(path.name)
    sizes[path.name] = now
    return before == now or (before is None and time.time() - facts.st_mtime > 1.0)
