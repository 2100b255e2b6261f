"""How many threads a process's libraries of numbers and images compute with."""

from __future__ import annotations

import os

_VARIABLES = ("OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Of OpenBLAS, unless OPENBLAS_NUM_THREADS is set, and of whatever else is built on OpenMP; of OpenCV."""


def one_thread_each() -> None:
    """Have BLAS, OpenMP and OpenCV compute with one thread a process, unless the environment says how many.

    The matrices are small: further threads wait for one another longer than they compute, beside other load ten times
    as long. Several images or fits at a time are several processes. The libraries read this when they are loaded, and
    processes that are started have it from this one.
    """
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
