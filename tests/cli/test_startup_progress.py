"""Long waits are explained to the user."""

import logging

import pytest

from splatwire.cli import _startup_progress

LOG = logging.getLogger("splatwire.ops.compiled")


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(_startup_progress.time, "monotonic", lambda: now[0])
    return now


def test_compilation_is_reported_at_once_and_every_few_seconds(clock, capsys):
    with _startup_progress.startup_messages("decode"):
        for second in range(8):
            clock[0] = 100.0 + second
            LOG.info("compiling kernel_%d", second)
    assert capsys.readouterr().err.splitlines() == [
        "compiling kernels, once on this machine",
        "6 kernels compiled after 6 s, compiling kernel_6",
    ]
    LOG.info("compiling afterwards")
    assert not capsys.readouterr().err


def test_one_compiled_kernel_is_no_plural(clock, capsys):
    with _startup_progress.startup_messages("decode"):
        for second in (0, 9):
            clock[0] = 100.0 + second
            LOG.info("compiling kernel_%d", second)
    assert capsys.readouterr().err.splitlines()[1] == "1 kernel compiled after 9 s, compiling kernel_9"


def test_waits_for_another_process_are_reported_but_are_no_compilations(clock, capsys):
    with _startup_progress.startup_messages("decode"):
        for second in range(8):
            clock[0] = 100.0 + second
            LOG.info("waiting for kernel_%d", second, extra={"waits": True})
        LOG.info("compiling kernel_7")
    assert capsys.readouterr().err.splitlines() == [
        "waiting for kernel_0",
        "waiting for kernel_6",
        "compiling kernels, once on this machine",
    ]


def test_loading_is_reported_only_on_a_terminal(monkeypatch, capsys):
    started = []
    monkeypatch.setattr(_startup_progress.threading.Timer, "start", lambda timer: started.append(timer))
    with _startup_progress.startup_messages("decode"):
        assert not started
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with _startup_progress.startup_messages("decode"):
        (timer,) = started
        assert timer.daemon
        timer.function(*timer.args)
        assert not timer.finished.is_set()
    assert timer.finished.is_set()
    assert capsys.readouterr().err == "splatwire decode: loading\n"
