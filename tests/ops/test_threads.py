"""Small work stays on its thread and does not affect other threads."""

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from splatwire.ops.threads import one_blas_thread


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in ThreadpoolController().select(user_api="blas").info()}


@pytest.fixture
def two_threads():
    with threadpool_limits(limits=2):
        yield


def test_blas_threads_are_restored_when_the_last_context_exits(two_threads):
    first, second = one_blas_thread(), one_blas_thread()
    first.__enter__()
    second.__enter__()
    assert blas_threads() == {1}
    first.__exit__(None, None, None)  # not in the order of a stack, as with threads
    assert blas_threads() == {1}
    second.__exit__(None, None, None)
    assert blas_threads() == {2}
    with pytest.raises(KeyError), one_blas_thread():
        raise KeyError
    assert blas_threads() == {2}
