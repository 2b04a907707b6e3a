"""What is used up is said in one line: memory, space, sizes of files, open files."""

import errno
import os
import resource
import subprocess
import sys

import pytest

from splatwire.cli._resources import resource_problem


def raised(error: BaseException, cause: BaseException | None = None) -> BaseException:
    try:
        raise error from cause
    except BaseException as caught:
        return caught


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.EFBIG, "File too large"), "ulimit -f"),
        (OSError(errno.ENOSPC, "No space left on device", "a.ply"), "a.ply: No space left on device"),
        (OSError(errno.EMFILE, "Too many open files"), "ulimit -n"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "quota"),
        (MemoryError("Unable to allocate 3.00 GiB"), "not enough memory here: Unable to allocate 3.00 GiB"),
        (ImportError("libtorch_cpu.so: failed to map segment from shared object"), "not enough memory"),
        (RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to"), "not enough memory"),
        (RuntimeError("can't start new thread"), "ulimit -u"),
        (RuntimeError("I/O error: File too large (os error 27)"), "ulimit -f"),
        (raised(SystemError("kernel"), MemoryError()), "not enough memory"),
    ],
)
def test_a_used_up_resource_is_named(error, words):
    problem = resource_problem(error)
    assert problem is not None
    assert words in problem
    assert "\n" not in problem


@pytest.mark.parametrize("error", [OSError(errno.ENOENT, "No such file", "a"), ValueError("memory"), KeyError("x")])
def test_other_errors_are_not(error):
    assert resource_problem(error) is None


def test_a_limited_address_space_is_named(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (800_000_000, 800_000_000))
    said = "Could not find/load shared object file 'libllvmlite.so' from resource location"
    assert "limited to 0.8 GB, `ulimit -v`" in resource_problem(OSError(said))
    assert "`ulimit -v`" in resource_problem(MemoryError())
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert resource_problem(OSError(said)) is None  # a broken installation


def test_a_file_that_may_not_grow_is_one_line_and_leaves_nothing(journey, tmp_path):
    """The limit is that of the system: Python gets an error in place of the signal."""
    words = [sys.executable, "-m", "splatwire", "transmit", str(journey / "tiny.swz"), "-o", str(tmp_path / "a.swz")]
    done = subprocess.run(
        [*words, "--loss", "none"], capture_output=True, text=True, timeout=120, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024)),
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1].startswith("splatwire: error: ")
    assert "ulimit -f" in done.stderr
    assert "Traceback" not in done.stderr
    assert not any(path.suffix == ".swz" for path in tmp_path.iterdir())


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")
def test_standard_output_that_is_full_is_one_line():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "splatwire", "--version"], stdout=full, stderr=subprocess.PIPE, text=True,
            timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("splatwire: error: ")
    assert "No space left on device" in line
