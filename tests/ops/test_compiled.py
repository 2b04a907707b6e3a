"""Compiled kernels are cached in private folders only."""

import contextlib
import errno
import fcntl
import itertools
import logging
import os
import shutil
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.caching import IndexDataCacheFile

from splatwire.ops import _cache_file, compiled
from splatwire.ops._cache_file import CacheFile

pytestmark = pytest.mark.slow

SOURCE = Path(compiled.__file__).resolve().parents[2]
_NOBODY = 65534


@pytest.fixture(autouse=True)
def _fresh():
    compiled.private_folder.cache_clear()
    yield
    compiled.private_folder.cache_clear()


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder for temporary files with the permissions of `/tmp`."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def test_cache_folder_is_private_and_stable(temporary):
    folder = compiled.private_folder()
    assert folder.parent == temporary
    assert folder.stat().st_mode & 0o777 == 0o700
    compiled.private_folder.cache_clear()
    assert compiled.private_folder() == folder


def _loosen(folder):
    folder.mkdir()
    folder.chmod(0o770)


def _link(folder):
    (folder.parent / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(folder.parent / "elsewhere")


def _open_parent(folder):
    folder.mkdir(mode=0o700)
    folder.parent.chmod(0o777)  # without the sticky bit any user can replace it by another folder


@pytest.mark.parametrize("plant", [_loosen, _link, _open_parent, Path.touch])
def test_cache_folder_writable_by_others_is_not_used(plant, temporary, caplog):
    plant(temporary / f"splatwire-kernels-{os.getuid()}")
    assert compiled.private_folder() is None
    assert "NUMBA_CACHE_DIR" in caplog.text


@pytest.mark.skipif(os.getuid() != 0, reason="gives a folder away")
def test_cache_folder_of_another_user_is_not_used(temporary):
    folder = temporary / f"splatwire-kernels-{os.getuid()}"
    folder.mkdir(mode=0o700)
    os.chown(folder, _NOBODY, _NOBODY)
    assert compiled.private_folder() is None


def _refuse_caches(monkeypatch):
    """Makes numba find no cache folder, as in a read-only container without a home."""

    def njit(*, cache=False, **options):
        if cache and not numba.config.CACHE_DIR:
            raise RuntimeError("cannot cache function: no locator available")
        return numba.njit(cache=cache, **options)

    monkeypatch.setattr(compiled, "numba", types.SimpleNamespace(njit=njit, config=numba.config))
    monkeypatch.setattr("numba.config.CACHE_DIR", "")


def test_private_folder_is_used_without_a_numba_cache(temporary, monkeypatch):
    _refuse_caches(monkeypatch)
    kernel = compiled.njit(nogil=True)(_twice)
    assert kernel(21) == 42
    assert list(compiled.private_folder().rglob("*.nbi"))
    assert numba.config.CACHE_DIR == ""


def test_no_cache_is_kept_without_a_writable_folder(temporary, monkeypatch):
    _refuse_caches(monkeypatch)
    monkeypatch.setattr(compiled, "private_folder", lambda: None)
    assert compiled.njit(nogil=True)(_twice)(21) == 42
    assert not list(temporary.rglob("*.nbi"))


COMPILED = """
import sys
from numba.core import event
sys.path.insert(0, {folder!r})

class Calls(event.Listener):
    total = 0
    def on_start(self, event):
        Calls.total += 1
    def on_end(self, event):
        pass

event.register("numba:compile", Calls())
import kernel_for_tests
sys.stdin.readline()
assert kernel_for_tests.outer(2) == 9
print(Calls.total)
"""
KERNELS = """
from splatwire.ops.compiled import njit

@njit()
def inner(x):
    return x * x

@njit()
def outer(x):
    return inner(x) + 5
"""


def test_processes_that_start_together_compile_each_kernel_once(tmp_path):
    (tmp_path / "kernel_for_tests.py").write_text(KERNELS)
    words = [sys.executable, "-c", COMPILED.format(folder=str(tmp_path))]
    processes = [subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    assert sorted(int(process.communicate(timeout=300)[0]) for process in processes) == [0, 0, 2]


def test_a_kernel_is_compiled_where_the_lock_file_cannot_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    kernel: Any = compiled.njit()(_twice)
    Path(kernel._cache.cache_path, f"{_twice.__module__}.{_twice.__qualname__}.lock").mkdir(parents=True)
    assert kernel(21) == 42


def _lock_of(kernel: Any) -> Path:
    return Path(kernel._cache.cache_path, f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}.lock")


@pytest.fixture
def suspended(tmp_path, monkeypatch):
    """Two kernels that are not compiled yet, with locks that seem to belong to another process; waits of 0.3 s."""
    monkeypatch.setattr(compiled, "_TURN_S", 0.3)
    monkeypatch.setattr(compiled, "_NOTICE_S", 0.1)
    monkeypatch.setattr(compiled, "_IN_VAIN", threading.Event())
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    kernels: list[Any] = [compiled.njit()(_twice), compiled.njit()(_observed)]
    with compiled._file_lock(_lock_of(kernels[0]), "_twice"), compiled._file_lock(_lock_of(kernels[1]), "_observed"):
        yield kernels


def _record_waits(monkeypatch) -> list[tuple[str, float, bool]]:
    """Returns a list that records each wait for a lock: kernel, seconds, and if it was ever counted as compiling."""
    waits: list[tuple[str, float, bool]] = []
    wait, sleep = compiled._wait_for, time.sleep
    seen: list[bool] = []

    def observed_sleep(duration: float) -> None:
        seen.append(compiled.is_compiling())
        sleep(duration)

    def observed_wait(handle: int, kernel: str) -> None:
        seen.clear()
        began = time.monotonic()
        wait(handle, kernel)
        waits.append((kernel, time.monotonic() - began, any(seen)))

    clock = types.SimpleNamespace(monotonic=time.monotonic, sleep=observed_sleep)
    monkeypatch.setattr(compiled, "time", clock)
    monkeypatch.setattr(compiled, "_wait_for", observed_wait)
    return waits


def test_a_suspended_process_delays_one_compilation_for_a_limited_time(suspended, monkeypatch, caplog):
    waits = _record_waits(monkeypatch)
    with caplog.at_level(logging.INFO, compiled.LOG.name):
        assert [kernel(21) for kernel in suspended] == [42, 21]
    assert [kernel for kernel, _, _ in waits] == ["_twice", "_observed"]
    assert waits[0][1] >= 0.3
    assert [counted for _, _, counted in waits] == [True, False], "the second kernel does not wait"
    assert [record.getMessage() for record in caplog.records] == ["waiting for another process that compiles _twice"]
    assert not compiled.is_compiling()


def test_a_lock_that_is_released_ends_the_wait(tmp_path, monkeypatch):
    """The lock is then this process's own, and the next kernel is waited for, too."""
    monkeypatch.setattr(compiled, "_NOTICE_S", 0.0)
    monkeypatch.setattr(compiled, "_IN_VAIN", threading.Event())
    path = tmp_path / "kernel.lock"
    other = os.open(path, os.O_RDWR | os.O_CREAT)
    fcntl.flock(other, fcntl.LOCK_EX)

    def release(_: float) -> None:
        fcntl.flock(other, fcntl.LOCK_UN)

    monkeypatch.setattr(compiled, "time", types.SimpleNamespace(monotonic=time.monotonic, sleep=release))
    with compiled._file_lock(path, "kernel"), pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(other)
    assert not compiled._IN_VAIN.is_set()


def test_compilation_is_logged_once_and_loading_is_not(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(_twice, "__module__", "splatwire.here")
    with caplog.at_level(logging.INFO, compiled.LOG.name):
        assert compiled.njit()(_twice)(21) == 42
        assert [record.getMessage() for record in caplog.records] == ["compiling _twice"]
        caplog.clear()
        assert compiled.njit()(_twice)(21) == 42
    assert not caplog.records


def test_a_compilation_is_visible_while_it_lasts(tmp_path, monkeypatch):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    found: list[bool] = []

    @numba.extending.overload(_observed)
    def _compiled(x):
        found.append(compiled.is_compiling())
        return lambda x: x

    assert not compiled.is_compiling()
    assert numba.njit(lambda x: _observed(x))(21) == 21
    assert found
    assert all(found)
    assert not compiled.is_compiling()


def _observed(x):
    return x


def _twice(x):
    return 2 * x


CHAIN = {
    "limits": "STEP = 1\n",
    "inner": "from splatwire.ops.compiled import njit\n\n\n@njit()\ndef inner(x):\n    return x + 10\n",
    "middle": "from chain.inner import inner\nfrom splatwire.ops.compiled import njit\n\n\n"
    "@njit()\ndef middle(x):\n    return 2 * inner(x)\n",
    "outer": "from chain.limits import STEP\nfrom chain.middle import middle\n"
    "from splatwire.ops.compiled import njit\n\n\n@njit()\ndef outer(x):\n    return middle(x) + STEP\n",
}


@pytest.mark.extended
@pytest.mark.parametrize(("file", "old", "new", "result"), [("inner", "+ 10", "+ 20", 43), ("limits", "1", "5", 27)])
def test_kernel_is_recompiled_when_its_dependencies_change(file, old, new, result, tmp_path):
    """numba does not detect this change, because the file of the called kernel is unchanged."""
    package = tmp_path / "chain"
    package.mkdir()
    for name, text in CHAIN.items():
        (package / f"{name}.py").write_text(text)
    program = (
        "from numba.core import event\n"
        "class Compiled(event.Listener):\n"
        "    def on_start(self, e): print(e.data['dispatcher'].py_func.__name__)\n"
        "    def on_end(self, e): pass\n"
        "event.register('numba:compile', Compiled())\n"
        "from chain.outer import outer\nprint(outer(1))\n"
    )
    path = os.pathsep.join([str(SOURCE), str(tmp_path)])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def run():
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.split()

    assert run() == ["outer", "middle", "inner", "23"]
    assert run() == ["23"]
    (package / f"{file}.py").write_text(CHAIN[file].replace(old, new))
    assert run()[-1] == str(result)
    assert run() == [str(result)]


def test_every_kernel_uses_the_shared_cache():
    for path in (SOURCE / "splatwire").rglob("*.py"):
        if path != Path(compiled.__file__):
            assert "numba import njit" not in path.read_text(encoding="utf-8"), path
            assert "numba.njit" not in path.read_text(encoding="utf-8"), path


@pytest.mark.extended
def test_a_read_only_installation_decodes_without_a_home(temporary):
    """Simulates an ordinary container; files in place of folders prevent even root from writing next to the source."""
    installed = temporary.parent / "installed"
    shutil.copytree(SOURCE / "splatwire", installed / "splatwire", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [installed / "splatwire", *(installed / "splatwire").rglob("*/")]:
        (folder / "__pycache__").touch()
    program = (
        "import numpy as np\n"
        "import splatwire.entropy.coder as coder\n"
        "bits, contexts = np.array([0, 1, 1, 0], np.uint8), np.zeros(4, np.int64)\n"
        "data = coder.encode_bits(bits, contexts, coder.fresh_models(1))\n"
        "assert (coder.decode_bits(data, contexts, coder.fresh_models(1)) == bits).all()\n"
        "print(coder.__file__)\n"
    )
    environment = {"PATH": os.environ["PATH"], "HOME": os.devnull, "TMPDIR": str(temporary)}
    environment["PYTHONPATH"] = str(installed)
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(installed))
    assert list((temporary / f"splatwire-kernels-{os.getuid()}").rglob("*.nbi"))


@pytest.mark.extended
def test_unreadable_cache_index_counts_as_empty(tmp_path, monkeypatch):
    """An index of another release names removed types, and numba unpickles it."""
    source = "from splatwire.ops.compiled import njit\n\n\n@njit()\ndef doubled(x):\n    return 2 * x\n"
    (tmp_path / "old_kernels.py").write_text(source)
    words = [sys.executable, "-c", "import old_kernels; print(old_kernels.doubled(3))"]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": f"{tmp_path}:{SOURCE}"}
    for _ in range(2):
        done = subprocess.run(words, env=env, capture_output=True, text=True, timeout=600, check=False)
        assert done.stdout == "6\n", done.stderr
        (index,) = (tmp_path / "cache").rglob("*.nbi")
        content = index.read_bytes()
        index.write_bytes(content[: len(content) - 5])


_KEYS = ("float64", "int64", "int32")


def _cache(folder: Path, source: int) -> CacheFile:
    return CacheFile(IndexDataCacheFile(str(folder), "kernel", None), source)


def _store(folder: Path, source: int, key: str) -> None:
    _cache(folder, source).save(key, f"code {source} {key}")


def _killed() -> None:
    raise SystemExit


def _happen_at_write(number: int, event: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets something happen just before a file of a cache gets its name, counted from 0."""
    replace, count = os.replace, itertools.count()

    def observed(*names: Any) -> None:
        if next(count) == number:
            event()
        replace(*names)

    monkeypatch.setattr(os, "replace", observed)


def _check_codes(folder: Path) -> None:
    for source in (1, 2):
        for key in _KEYS:
            assert _cache(folder, source).load(key) in (None, f"code {source} {key}")


@pytest.mark.parametrize("number", range(4))
def test_a_killed_process_leaves_no_code_of_other_sources(number, tmp_path, monkeypatch):
    for key in _KEYS:
        _store(tmp_path, 1, key)
    with monkeypatch.context() as patched, contextlib.suppress(SystemExit):
        _happen_at_write(number, _killed, patched)
        for key in reversed(_KEYS):
            _store(tmp_path, 2, key)
    _check_codes(tmp_path)
    for key in _KEYS:
        _store(tmp_path, 2, key)
    assert [_cache(tmp_path, 2).load(key) for key in _KEYS] == [f"code 2 {key}" for key in _KEYS]
    assert len(list(tmp_path.iterdir())) == 1 + len(_KEYS), "old or unfinished files are left"


@pytest.mark.parametrize("stored", [(1, "int64"), (2, "int64"), (2, "float64")])
@pytest.mark.parametrize("number", range(4))
def test_processes_that_store_code_at_once_mix_up_nothing(number, stored, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        _happen_at_write(number, lambda: _store(tmp_path, *stored), patched)
        for key in ("float64", "int32"):
            _store(tmp_path, 2, key)
    _check_codes(tmp_path)


def test_damaged_code_counts_as_not_cached(tmp_path, monkeypatch):
    """A power failure can leave a file with zeros; machine code with an error could do anything."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    assert compiled.njit()(_twice)(21) == 42
    for damage in (lambda data: bytes(len(data)), lambda data: data[:-9], lambda data: data[:-9] + bytes(9)):
        (path,) = tmp_path.rglob("*.nbc")
        path.write_bytes(damage(path.read_bytes()))
        assert compiled.njit()(_twice)(21) == 42
    (path,) = tmp_path.rglob("*.nbc")
    assert path.read_bytes().strip(b"\0")


def test_kernels_work_if_their_code_cannot_be_stored(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(_cache_file, "_REPORTED", set())
    kernels: list[Any] = [compiled.njit()(_twice), compiled.njit()(_observed)]

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert [kernel(21) for kernel in kernels] == [42, 21]
    assert [record.getMessage() for record in caplog.records if record.levelno > logging.INFO] == [
        f"compiled kernels cannot be kept in {kernels[0]._cache.cache_path}, so each process compiles them: "
        "No space left on device"
    ]
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".lock"]


def test_files_that_another_process_reads_are_no_reason_for_a_warning(tmp_path, monkeypatch, caplog):
    """Windows refuses to replace them; a later process stores the code."""
    monkeypatch.setattr(_cache_file, "_HOLDS_OPEN_FILES", True)
    _store(tmp_path, 1, "int64")
    with monkeypatch.context() as patched:

        def held(*_: Any) -> None:
            raise PermissionError(errno.EACCES, "Access is denied")

        patched.setattr(os, "replace", held)
        _store(tmp_path, 2, "int64")
    assert not caplog.records
    assert not list(tmp_path.glob("*.tmp"))
    _check_codes(tmp_path)
    _store(tmp_path, 2, "int64")
    assert _cache(tmp_path, 2).load("int64") == "code 2 int64"


def test_kernels_work_if_their_folder_is_gone(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(_cache_file, "_REPORTED", set())
    kernel: Any = compiled.njit()(_twice)
    Path(kernel._cache.cache_path).rmdir()
    Path(kernel._cache.cache_path).touch()
    assert kernel(21) == 42
    assert "compiled kernels cannot be kept" in caplog.text


_CODED = """
import sys
from splatwire.ops import compiled
assert compiled.CAN_BORROW
if sys.argv[1] == "plain":
    compiled.CAN_BORROW = False
import numpy as np
from splatwire.entropy import coder
rng = np.random.default_rng(4)
mixtures = coder.Mixtures.normals(rng.integers(-(2**20), 2**20, 500), rng.integers(0, 200, 500))
symbols = rng.integers(-100, 100, 500)
data = coder.encode_symbols(symbols, mixtures)
assert (coder.decode_symbols(data, mixtures) == symbols).all()
print(data.hex())
"""


@pytest.mark.extended
def test_kernels_work_without_numbas_private_option(tmp_path):
    """A later numba may lack `_nrt`; kernels then count references to arrays and code the same bytes."""
    found = {}
    for way in ("plain", "borrowing"):  # the second one runs normally from the cache of this machine
        cache = {"NUMBA_CACHE_DIR": str(tmp_path)} if way == "plain" else {}
        environment = os.environ | {"PYTHONPATH": str(SOURCE)} | cache
        words = [sys.executable, "-c", _CODED, way]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        found[way] = done.stdout
    assert found["plain"] == found["borrowing"] != ""


def test_unknown_numba_options_are_detected():
    assert compiled._supports_option("_nrt")
    assert not compiled._supports_option("_gone")
