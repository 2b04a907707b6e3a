"""How many threads a piece of work is worth: waking a second one costs more than a small scene does."""

import contextlib
from collections.abc import Iterator

SMALL = 4000
"""Below this many anchors one thread is faster, above all where others use the cores too."""


@contextlib.contextmanager
def threads_for(num_anchors: int) -> Iterator[None]:
    """Limits compiled kernels to one thread while a small scene is worked on; results never depend on it.

    Args:
        num_anchors: Anchors of the scene.
    """
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1 if num_anchors < SMALL else before)
    try:
        yield
    finally:
        numba.set_num_threads(before)
