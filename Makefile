# `make book` and `make test` work first thing in a fresh clone: Python >= 3.11 (with venv) and make are enough.
PYTHON ?= python3
BIN    := .venv/bin
STAMP  := .venv/.installed

# Runs beside others, so each process keeps to one thread.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help venv book test full fuzz check-book lint format clean

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 20

venv: $(STAMP) ## the environment alone, in .venv

$(STAMP): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

book: $(STAMP) ## build the book: _build/html/index.html
	rm -rf _build/html
	$(BIN)/jupyter-book build . --all -W -n --keep-going

# A claim whose verdict is not the accepted one fails.
test: export ESFEM_STRICT = 1
test: $(STAMP) ## solver, doctests and all notebooks
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --durations 10 \
	    --nbval-lax --nbval-current-env tests esfem_core book

full: $(STAMP) ## the papers' own resolution: hours; interrupt at will, start again to go on (STALE=1 renews)
	$(BIN)/python -m esfem_core.companion.experiments $(if $(STALE),--stale)

fuzz: $(STAMP) ## generated arguments for all public functions; writes the table of the book
	$(BIN)/python tests/fuzz.py

check-book: book ## the built pages, in a browser without network
	$(BIN)/python -m pytest -q -n 2 --dist loadfile tests/pages

lint: $(STAMP) ## ruff and mypy
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

format: $(STAMP) ## let ruff format everything
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

clean: ## remove what was built (the environment stays)
	rm -rf _build build *.egg-info
