"""Shared work runs completely, once and in order, and errors of any thread reach the caller."""

import os
import threading
import time

import pytest

from splatwire.ops import threads
from splatwire.ops.threads import allowed_threads, limit_threads, parallel_map


@pytest.mark.parametrize("num", [0, 1, 2, 1000])
def test_every_item_runs_once_and_results_keep_their_order(num):
    done = []

    def work(item: int) -> int:
        done.append(item)
        return item * item

    assert parallel_map(work, range(num)) == [n * n for n in range(num)]
    assert sorted(done) == list(range(num))


@pytest.mark.skipif(allowed_threads() < 2, reason="one processor")
def test_work_is_shared_with_another_thread():
    both = threading.Barrier(2)
    assert len(set(parallel_map(lambda _: (both.wait(240), threading.get_ident())[1], range(2)))) == 2


def test_single_thread_runs_in_the_caller():
    threads._LIMIT.set()
    try:
        assert set(parallel_map(lambda _: threading.get_ident(), range(50))) == {threading.get_ident()}
    finally:
        threads._LIMIT.clear()


def test_the_number_of_threads_is_limited_within_its_context():
    with limit_threads(1):
        assert set(parallel_map(lambda _: threading.get_ident(), range(50))) == {threading.get_ident()}
    threads._LIMIT.set()
    both = threading.Barrier(2)
    try:
        with limit_threads(2):  # an explicit number precedes the default
            assert len(set(parallel_map(lambda _: (both.wait(240), threading.get_ident())[1], range(2)))) == 2
        assert set(parallel_map(lambda _: threading.get_ident(), range(50))) == {threading.get_ident()}
    finally:
        threads._LIMIT.clear()


@pytest.mark.parametrize("bad", [0, 5])
def test_error_stops_the_work_and_is_raised_in_the_caller(bad):
    def work(item: int) -> None:
        time.sleep(0.001)
        if item == bad:
            raise KeyError(item)

    with pytest.raises(KeyError):
        parallel_map(work, range(1000))
    assert parallel_map(abs, [-1, 2]) == [1, 2]


def test_nested_sharing_works():
    assert parallel_map(lambda n: sum(parallel_map(lambda m: n * m, range(5))), range(8)) == [10 * n for n in range(8)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_forked_process_starts_its_own_threads():
    parallel_map(abs, range(4))
    child = os.fork()  # no torch code runs in the child
    if child == 0:
        os._exit(0 if parallel_map(abs, [-3, -4]) == [3, 4] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
