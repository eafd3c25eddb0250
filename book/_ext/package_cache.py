"""Sphinx extension: run notebooks side by side, and again when the solver under them has changed.

jupyter-cache keys on a notebook's own code, so an edit to ``esfem_core`` would leave stale outputs
in the book. Here the cache folder carries a hash of everything else that outputs depend on: the
package with the script of its moving pictures, the stored data, the pinned environment and the
Python version.

myst-nb executes a notebook when it comes to it, one after the other. Here those that are missing in
the cache are executed before, one on each processor.

What follows, reading and writing pages, is work of one processor. The trees of pages are made of
millions of objects that live until the end, and Python's collector of garbage would go through them
again and again: it is told to look less often.
"""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import shutil
import sys
from pathlib import Path

from jupyter_cache import get_cache
from jupyter_cache.executors import load_executor
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.environment import BuildEnvironment

from esfem_core.study.environment import source_hash

INPUTS = (  # beside the Python files of the package
    "esfem_core/companion/data/**/*",
    "esfem_core/output/viewer.*",
    "requirements.lock",
)


def digest(root: Path) -> str:
    """Return a hash of the files that notebooks depend on."""
    h = hashlib.sha256((sys.version + source_hash(root / "esfem_core")).encode())
    for path in sorted(p for pattern in INPUTS for p in root.glob(pattern) if p.is_file()):
        h.update(path.relative_to(root).as_posix().encode() + b"\0")
        h.update(hashlib.sha256(path.read_bytes()).digest())
    return h.hexdigest()[:16]


def configure(app: Sphinx, config: Config) -> None:
    """Point myst-nb to the cache of this state of the package; drop the caches of older states."""
    root = Path(app.srcdir)
    caches = root / "_build" / "cache"
    current = caches / digest(root)
    for old in caches.glob("*"):
        if old != current:
            shutil.rmtree(old)
    config["nb_execution_cache_path"] = str(current)
    # The pages share one copy of plotly; a notebook run elsewhere carries its own.
    os.environ["ESFEM_PLOTLY_JS"] = "../_static/plotly/plotly-gl3d.min.js"


def execute(app: Sphinx, env: BuildEnvironment, names: list[str]) -> None:
    """Fill the cache; what fails here is executed again by myst-nb, which reports it."""
    paths = [str(env.doc2path(name)) for name in names]
    notebooks = [path for path in paths if path.endswith(".ipynb")]
    if not notebooks:
        return
    cache = get_cache(app.config.nb_execution_cache_path)
    for path in notebooks:
        cache.add_nb_to_project(path)
    logger = logging.getLogger(__name__)
    logger.setLevel(logging.INFO)  # tells which notebook is executed
    executor = load_executor("local-parallel", cache, logger)
    executor.run_and_cache(filter_uris=notebooks, timeout=app.config.nb_execution_timeout)


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    gc.set_threshold(100_000, 20, 100)
    app.connect("config-inited", configure)
    app.connect("env-before-read-docs", execute)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
