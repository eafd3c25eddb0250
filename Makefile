# `make book` and `make test` work first thing in a fresh clone: Python >= 3.11 (with venv) and make are enough.
PYTHON ?= python3
BIN    := .venv/bin
STAMP  := .venv/.installed
LITE   := .venv/lite
FIREFOX := .venv/firefox
PEERS  := .venv/.peers

# Runs beside others, so each process keeps to one thread.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help venv wheel book lite test test-long full fuzz mutants check-book check-firefox check-lite lint format \
        clean pyodide-there test-oldest test-newest test-readers compare-builds lab

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 20

venv: $(STAMP) ## the environment alone, in .venv

$(STAMP): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

# The date makes two wheels of the same sources the same file.
wheel: export SOURCE_DATE_EPOCH = 315532800
wheel: $(STAMP) ## the wheel of esfem_core alone, in _build/wheel
	rm -rf build _build/wheel
	$(BIN)/python -m pip wheel -q --disable-pip-version-check --no-deps --no-build-isolation -w _build/wheel .
	rm -rf build

book: wheel ## build the book: _build/html/index.html
	rm -rf _build/html
	$(BIN)/jupyter-book build . --all -W -n --keep-going

$(LITE)/.installed: lite/requirements.txt
	$(PYTHON) -m venv $(LITE)
	$(LITE)/bin/python -m pip install -q --disable-pip-version-check -r $<
	touch $@

# Asked before the book is built, which takes minutes.
pyodide-there:
	@case "$(PYODIDE)" in ""|http://*|https://*) ;; *) test -d "$(PYODIDE)" || \
	    { echo "PYODIDE must be a folder or an address, got $(PYODIDE)" >&2; exit 1; } ;; esac

lite: pyodide-there book $(LITE)/.installed ## the book with chapters that run in it (PYODIDE=folder or address of a distribution)
	$(LITE)/bin/python lite/build.py "$(PYODIDE)"

# NGSolve, which tests/peers compares with. Where there is no wheel of it these tests are skipped,
# but not in CI.
$(PEERS): benchmarks/requirements.txt $(STAMP)
	$(BIN)/python -m pip install -q --disable-pip-version-check -r $< && touch $@ || echo "no NGSolve"

# What a chapter states and does not hold fails here; a reader is told and can go on.
book test test-long compare-builds: export ESFEM_STRICT = 1

test: $(STAMP) $(PEERS) ## the solver and its examples, in some minutes
	$(BIN)/python -m pytest -q -n 2 --dist worksteal --durations 10 -m "not slow" tests esfem_core

test-long: $(STAMP) ## all notebooks, cell by cell, and what takes long of the solver
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --durations 10 --nbval-lax --nbval-current-env book
	$(BIN)/python -m pytest -q -n 2 --dist worksteal --durations 10 -m slow tests

lab: $(STAMP) ## the chapters in JupyterLab
	$(BIN)/python -m pip install -q --disable-pip-version-check "jupyterlab>=4"
	$(BIN)/jupyter lab book

ifneq ($(filter-out 1,$(STALE)),)
$(error STALE must be 1 or nothing, got $(STALE))
endif

full: $(STAMP) ## the papers' own resolution, an hour and a half; interrupt at will, start again to go on (STALE=1 renews)
	$(BIN)/python -m esfem_core.companion.experiments $(if $(STALE),--stale)

fuzz: $(STAMP) ## generated arguments for all functions that scripts call; writes the table of the book
	$(BIN)/python tests/fuzz.py

mutants: $(STAMP) ## faults put into the solver, of which its tests must notice nine in ten: half an hour
	nice -n 19 $(BIN)/python tests/mutants.py

check-book: book ## the built pages, in a browser without network
	$(BIN)/python -m pytest -q -n 2 --dist worksteal --durations 10 tests/pages

$(FIREFOX)/.installed: tests/pages/firefox.txt
	$(PYTHON) -m venv $(FIREFOX)
	$(FIREFOX)/bin/python -m pip install -q --disable-pip-version-check -r $<
	touch $@

check-firefox: book $(FIREFOX)/.installed ## the same in the Firefox of the system, but for print, the dark and axe
	BROWSER=firefox $(FIREFOX)/bin/python -m pytest -q -n 2 -k "not bars_a_reader" tests/pages/test_browser.py \
	    tests/pages/test_each_page.py

check-lite: lite ## chapters that run in the browser, without network: some minutes
	$(BIN)/python -m pytest -q -x tests/lite

# Tests of the solver with other versions of NumPy, SciPy, trimesh and what is optional beside them.
test-oldest: ## the solver, with the oldest versions that pyproject.toml allows
	$(PYTHON) tests/versions.py oldest

test-newest: ## the solver, with the newest versions there are
	$(PYTHON) tests/versions.py newest

test-readers: $(STAMP) ## each chapter alone, with another degree and step: some twenty minutes
	$(BIN)/python tests/readers.py

compare-builds: wheel ## build the book with 1 and with 2 threads: the same numbers to 1e-9?
	rm -rf _build/threads-1 _build/threads-2
	for n in 1 2; do rm -rf _build/cache; OMP_NUM_THREADS=$$n OPENBLAS_NUM_THREADS=$$n \
	    $(BIN)/jupyter-book build . --all -W -n --keep-going --path-output _build/threads-$$n || exit 1; done
	$(BIN)/python tests/same_digits.py _build/threads-1/_build/html _build/threads-2/_build/html

lint: $(STAMP) ## ruff and mypy
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

format: $(STAMP) ## let ruff format everything
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

clean: ## remove what was built (the environment stays)
	rm -rf _build build *.egg-info
