"""Exhausted memory, disk space, file sizes and open files are one error line each."""

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from splatwire.cli._resources import file_problem, resource_problem


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
def test_exhausted_resource_is_named(error, words):
    problem = resource_problem(error)
    assert problem is not None
    assert words in problem
    assert "\n" not in problem


def test_a_file_that_happens_to_be_the_first_too_many_is_not_named():
    assert "thread.py" not in resource_problem(OSError(errno.EMFILE, "Too many open files", "thread.py"))


@pytest.mark.parametrize("error", [OSError(errno.ENOENT, "No such file", "a"), ValueError("memory"), KeyError("x")])
def test_other_errors_are_no_resource_errors(error):
    assert resource_problem(error) is None


def test_limited_address_space_is_named_in_the_error(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (800_000_000, 800_000_000))
    said = "Could not find/load shared object file 'libllvmlite.so' from resource location"
    assert "limited to 0.8 GB, `ulimit -v`" in resource_problem(OSError(said))
    assert "`ulimit -v`" in resource_problem(MemoryError())
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert resource_problem(OSError(said)) is None  # a broken installation


@pytest.mark.parametrize(("limit", "warns"), [(600_000_000, True), (4_000_000_000, False), (None, False)])
def test_small_address_space_gives_a_warning_before_libraries_abort(run, journey, monkeypatch, limit, warns):
    limit = resource.RLIM_INFINITY if limit is None else limit
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    outcome = run("inspect", journey / "tiny.swz")
    assert outcome.status == 0
    assert ("splatwire: warning: the address space is limited to 0.6 GB (`ulimit -v`)" in outcome.err) == warns


@pytest.mark.parametrize("words", [("decode", "FILE", "-o", "a.scene"), ("serve", "FILE", "--port", "0")])
def test_address_space_that_is_too_small_for_libraries_is_one_error_line(words, journey, tmp_path):
    """Without the check, LLVM aborts the process, or OpenBLAS waits for threads without end."""
    words = [str(journey / "tiny.swz") if word == "FILE" else word for word in words]
    done = subprocess.run(
        [sys.executable, "-m", "splatwire", *words], capture_output=True, text=True, timeout=600, check=False,
        cwd=tmp_path, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (256_000_000, 256_000_000)),
    )  # fmt: skip
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("splatwire: error: ")
    assert "limited to 0.3 GB, `ulimit -v`: raise that" in line


def test_file_size_limit_is_one_error_line_and_leaves_no_file(journey, tmp_path):
    """The system sets the limit; Python raises an error instead of receiving the signal."""
    words = [sys.executable, "-m", "splatwire", "transmit", str(journey / "tiny.swz"), "-o", str(tmp_path / "a.swz")]
    done = subprocess.run(
        [*words, "--loss", "none"], capture_output=True, text=True, timeout=600, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024)),
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1].startswith("splatwire: error: ")
    assert "ulimit -f" in done.stderr
    assert "Traceback" not in done.stderr
    assert not any(path.suffix == ".swz" for path in tmp_path.iterdir())


def test_file_size_limit_leaves_no_truncated_compiled_module(tmp_path):
    """Python cuts a compiled module at the limit without an error, and cannot load it afterwards."""
    cached = {"PYTHONPYCACHEPREFIX": str(tmp_path), "PYTHONDONTWRITEBYTECODE": ""}
    done = subprocess.run(
        [sys.executable, "-m", "splatwire", "inspect", str(tmp_path / "absent.swz")], capture_output=True, text=True,
        timeout=600, check=False, env={**os.environ, **cached},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
    )  # fmt: skip
    assert "no such file" in done.stderr
    assert [path.name.partition(".")[0] for path in tmp_path.rglob("splatwire/cli/*.pyc")] == ["__init__"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")
def test_full_standard_output_is_one_error_line():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "splatwire", "--version"], stdout=full, stderr=subprocess.PIPE, text=True,
            timeout=600, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("splatwire: error: ")
    assert "No space left on device" in line


def test_errors_about_files_begin_with_the_path_and_have_no_number():
    denied = PermissionError(errno.EACCES, "Permission denied", "a/b.ply")
    assert file_problem(denied).startswith("a/b.ply: Permission denied (`ls -ld` shows")
    assert file_problem(IsADirectoryError(errno.EISDIR, "Is a directory", b"a/b")) == "a/b: Is a directory"
    assert file_problem(OSError("no number")) == "no number"


DENIED = {
    "render": ("secret.ply", "-o", "out"),
    "encode": ("secret.ply", "-o", "a.swz"),
    "decode": ("secret.swz", "-o", "a.ply"),
    "export": ("spz", "secret.ply", "-o", "a.spz"),
    "import": ("splats", "secret.ply", "-o", "a.ply"),
    "train": ("secret", "-o", "a.scene"),
    "inspect": ("secret.ply",),
    "view": ("secret.swz",),
}


@pytest.mark.parametrize("verb", DENIED)
def test_a_file_without_permission_is_named_with_the_way(verb, run, tmp_path, monkeypatch):
    """Access is denied by a patch, because tests may run as root."""
    (tmp_path / "secret").mkdir()
    for name in ("secret.ply", "secret.swz", "secret/transforms.json"):
        (tmp_path / name).write_bytes(b"ply")

    def denied(of):
        def method(path, *rest, **more):
            if any(part.startswith("secret") for part in path.parts):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
            return of(path, *rest, **more)

        return method

    for name in ("open", "iterdir"):
        monkeypatch.setattr(Path, name, denied(getattr(Path, name)))
    monkeypatch.chdir(tmp_path)
    outcome = run(verb, *DENIED[verb])
    assert outcome.status == 2
    (line,) = outcome.err.strip().splitlines()
    assert "secret" in line.split(": ")[2]
    assert "Permission denied" in line
    assert "Errno" not in line
