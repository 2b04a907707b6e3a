"""Mutations of valid input: bytes changed, cut or repeated, and leaves of JSON replaced by unexpected values."""

import copy
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splatwire.errors import SplatwireError

HOSTILE = (
    None, True, False, 0, -1, 1, 1 << 31, 1 << 63, 10**400, -(10**400), 0.5, 1e300, 1e-320, float("inf"),
    float("nan"), "", "nan", "../x", "x" * 5000, "\ud800", "0x1p99999", "a\0b", [], [[]], {}, {"a": 1}, [1, [2]],
)  # fmt: skip


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    """Applies one to four byte mutations."""
    found = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        at, length = rng.randrange(len(found) + 1), rng.choice([1, 2, 4, 8, 60])
        change = rng.randrange(5)
        if change == 0:
            found[at : at + length] = rng.randbytes(length)
        elif change == 1:
            found[at : at + length] = rng.choice([b"\xff", b"\0", b"\x7f"]) * length
        elif change == 2:
            del found[at : at + length]
        elif change == 3:
            found[at:at] = found[max(0, at - length) : at]
        elif at < len(found):
            found[at] ^= 1 << rng.randrange(8)
    return bytes(found[: rng.randrange(len(found) + 1)] if rng.random() < 0.2 else found)


def mutated_json(content: Any, rng: random.Random) -> str:
    """Replaces or removes one or two leaves at any depth."""
    found = [copy.deepcopy(content)]
    for _ in range(rng.randrange(1, 3)):
        holder: Any = found
        while True:
            key = rng.choice(range(len(holder)) if isinstance(holder, list) else sorted(holder))
            inner = holder[key]
            if not isinstance(inner, (list, dict)) or not inner or rng.random() < 0.2:
                break
            holder = inner
        if isinstance(holder, dict) and rng.random() < 0.2:
            del holder[key]
        else:
            holder[key] = copy.deepcopy(rng.choice(HOSTILE))
    text = json.dumps(found[0])
    return text if rng.random() < 0.95 else "[" * 100_000 + text


def attack(path: Path, mutate: Callable[[], bytes], read: Callable[[], object], times: int) -> int:
    """Writes and reads mutated files; any exception other than a splatwire error fails the test.

    Returns:
        Number of files that were refused.
    """
    refused = 0
    for _ in range(times):
        data, said = mutate(), ""
        path.write_bytes(data)
        try:
            read()
        except SplatwireError as error:
            said = str(error)
        except Exception as error:
            raise AssertionError(f"{path.name}: {type(error).__name__}: {error}; bytes {data[:2000]!r}") from error
        assert len(said) < 1000, f"{path.name}: what a file says is repeated at length: {said[:200]}"
        refused += bool(said)
    return refused
