# `make` alone checks and tests. Each target makes the environment it needs, in .venv, with whichever
# Python >= 3.11 is found; a finished environment is recognised by its stamp and costs nothing.

PYTHON ?= $(shell for name in python3.13 python3.12 python3.11 python3 python; do \
	$$name -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$name && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
CORE := $(VENV)/.core-installed
DEV := $(VENV)/.dev-installed
DOCS := $(VENV)/.docs-installed
DEMO ?= demo
SEED ?= 1
MINUTES ?= 30
WORKERS ?= 2
UV ?= uv

# Compiled kernels are kept here between runs and shared by the worker processes of the tests.
export NUMBA_CACHE_DIR ?= $(abspath $(VENV))/numba-cache
# So are compiled modules: a program that a test starts would compile each anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: all check style test docs dist fuzz demo validate bench report-check constraints environment clean

all: check test

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "Sightline needs Python 3.11 or newer with venv; install it, or name it: make PYTHON=/path/to/python3"; exit 2; }
	$(PYTHON) -m venv $(VENV)

# The package itself is installed without its dependencies: those come from the constraints, by hash.
$(CORE): constraints.txt pyproject.toml src/sightline/version.py | $(BIN)/python
	@echo "installing Sightline and what it needs into $(VENV) (about a minute)"
	$(PIP) install --require-hashes -r constraints.txt
	$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

$(DEV): constraints-dev.txt $(CORE)
	@echo "installing what the checks and tests need into $(VENV) (about a minute)"
	$(PIP) install --no-compile --require-hashes -r constraints-dev.txt  # tests import a small part of it
	@touch $@

$(DOCS): constraints-docs.txt $(DEV)
	@echo "installing what the site needs into $(VENV)"
	$(PIP) install --no-compile --require-hashes -r constraints-docs.txt
	@touch $@

environment: $(DOCS)  ## everything needed to work on Sightline

demo: $(CORE)  ## the main job on a scene it renders, with a score against truth and a report to open
	$(BIN)/sightline demo --out $(DEMO) --seed $(SEED) --overwrite

style: $(DEV)  ## style, types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check: style  ## style, types, architecture
	$(BIN)/python -m pytest -q tests/test_architecture.py tests/test_public_api.py

test: $(DEV)  ## all tests; what had to be left out is named at the end
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal $(ARGS)

docs: $(DOCS)  ## the site in build/site, from docs/: its notebooks are run, its links and names checked; no network
	cd website && NO_MKDOCS_2_WARNING=1 OMP_NUM_THREADS=1 $(abspath $(BIN))/python -m mkdocs build --quiet
	OMP_NUM_THREADS=1 $(BIN)/python website/check.py

dist: $(DEV)  ## wheel and sdist in dist/, each installed into a fresh environment and used there; no network
	KEEP_IN=dist .ci/wheel $(BIN)/python

fuzz: $(DEV)  ## spoilt inputs for every reader, MINUTES long; a new seed each time unless SEED is given
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --minutes $(MINUTES) $(if $(filter command line environment,$(origin SEED)),--seed $(SEED)) $(ARGS)

validate: $(DEV)  ## accuracy and honesty of sigma against truth (SIGHTLINE_DATA names the folder of the real data): refreshes docs/validation.md, ends with 1 for a missed figure
	@missed=; for script in $(filter-out %/gates.py %/point_flights.py,$(wildcard validation/*.py)); do echo "== $$script"; $(BIN)/python $$script || missed="$$missed $$script"; done; \
		test -z "$$missed" || { echo "figures missed, or not printed, by:$$missed"; exit 1; }

bench: $(DEV)  ## speed and memory beside rivals, in one run
	@set -e; for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script; done

constraints:  ## refresh the pinned versions (needs uv): review the change like any other
	printf 'hatchling\neditables\n' | $(UV) pip compile --universal --generate-hashes --no-header --quiet $(UPGRADE) \
		--python-version 3.11 pyproject.toml - -o constraints.txt
	printf 'hatchling\neditables\n' | $(UV) pip compile --universal --generate-hashes --no-header --quiet $(UPGRADE) \
		--python-version 3.11 --extra dev --extra dask --extra sfm --extra cube --extra plot --extra catalog -c constraints.txt pyproject.toml - -o constraints-dev.txt
	printf 'hatchling\neditables\n' | $(UV) pip compile --universal --generate-hashes --no-header --quiet $(UPGRADE) \
		--python-version 3.11 --extra dev --extra dask --extra sfm --extra cube --extra plot --extra catalog --extra docs -c constraints-dev.txt pyproject.toml - -o constraints-docs.txt

clean:  ## forget the environment and what the tools left
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis
