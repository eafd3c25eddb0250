"""Two things timed in turn, and what one may say about their ratio."""

import platform
import time
from pathlib import Path

import numpy as np
import scipy
from threadpoolctl import threadpool_info


def in_turn(peer, ours, repeats):
    """Time two functions alternately, after one run of each that is not counted.

    Returns
    -------
    dict
        Median seconds of both, and median and quartiles of the ratios peer : ours.
    """
    times = np.empty((repeats + 1, 2))
    for row in times:
        for i, function in enumerate((peer, ours)):
            start = time.perf_counter()
            function()
            row[i] = time.perf_counter() - start
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
    """What the times were measured on."""
    names = [
        line.split(":", 1)[1].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    return {
        "processor": f"{names[0]}, {len(names)} cores seen" if names else platform.processor(),
        "system": f"{platform.system()}, Python {platform.python_version()}",
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "BLAS": ", ".join(
            sorted({f"{b['internal_api']} {b['architecture']}" for b in threadpool_info()})
        ),
        "threads": 1,
    }
