"""Two things timed in turn, and what one may say about their ratio."""

import time

import numpy as np
from threadpoolctl import threadpool_info

from esfem_core.study.environment import environment


def seconds(function, *arguments):
    """Seconds for one call."""
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def in_turn(peer, ours, repeats):
    """Time two functions alternately, after one run of each that is not counted.

    Returns
    -------
    dict
        Median seconds of both, and median and quartiles of the ratios peer : ours.
    """
    times = np.empty((repeats + 1, 2))
    for row in times:
        row[:] = seconds(peer), seconds(ours)
    return summary(*times[1:].T)


def summary(peer, ours):
    """Medians of paired times and of their ratio, with the quartiles of the ratio."""
    ratio = np.asarray(peer) / np.asarray(ours)
    low, middle, high = np.quantile(ratio, [0.25, 0.5, 0.75])
    return {
        "peer": float(np.median(peer)),
        "ours": float(np.median(ours)),
        "ratio": float(middle),
        "quartiles": [float(low), float(high)],
    }


def machine():
    """What the times were measured on, and with which kernels of BLAS."""
    kernels = {f"{blas['internal_api']} {blas['architecture']}" for blas in threadpool_info()}
    return environment() | {"BLAS": ", ".join(sorted(kernels)), "threads": 1}
