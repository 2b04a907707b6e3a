"""Small work stays on the thread that has it, and nobody else notices."""

import threading

import pytest
import torch
from threadpoolctl import ThreadpoolController, threadpool_limits

from splatwire.ops.threads import one_blas_thread, one_torch_thread


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in ThreadpoolController().select(user_api="blas").info()}


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    with threadpool_limits(limits=2):
        yield
    torch.set_num_threads(before)


def test_matrix_products_have_their_threads_again_once_the_last_one_leaves(two_threads):
    first, second = one_blas_thread(), one_blas_thread()
    first.__enter__()
    second.__enter__()
    assert blas_threads() == {1}
    first.__exit__(None, None, None)  # not the order of a stack, as in threads
    assert blas_threads() == {1}
    second.__exit__(None, None, None)
    assert blas_threads() == {2}
    with pytest.raises(KeyError), one_blas_thread():
        raise KeyError
    assert blas_threads() == {2}


def test_only_the_calling_thread_keeps_torch_to_itself(two_threads):
    found = []

    def ask() -> None:
        found.append(torch.get_num_threads())

    with one_torch_thread():
        ask()
        other = threading.Thread(target=ask)
        other.start()
        other.join()
    ask()
    assert found == [1, 2, 2]


def test_a_thread_that_never_used_torch_is_limited_too(two_threads):
    found = []

    def work() -> None:
        with one_torch_thread():
            torch.ones(1 << 17).add_(1)
            found.append(torch.get_num_threads())
        found.append(torch.get_num_threads())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [1, 2]
