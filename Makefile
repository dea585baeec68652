# Everything runs in a virtual environment of its own. `make` alone lists the targets.
PYTHON ?= python3
VENV ?= .venv
WORKERS ?= 2
ARGS ?=

BIN := $(VENV)/bin
# -qq hides progress and warnings about indexes, never an error. No isolation: the build tools are pinned as well.
# No compiling: Python does it for what is imported, which halves the wait.
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-compile --no-build-isolation -c constraints.txt
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast lint format clean
.NOTPARALLEL:

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' Makefile
	@echo 'demo and test-fast hand ARGS on: make demo ARGS="--seed 3", make test-fast ARGS="-k camera"'

demo: $(VENV)/installed-demo  ## the paper's experiment: a table here, figures and an animation in out/demo/
	$(BIN)/fovconn demo $(ARGS)

test: $(VENV)/installed-test  ## the whole suite, then the part of it that also runs without the JIT
	$(PYTEST)
	NUMBA_DISABLE_JIT=1 $(PYTEST) -m nojit

test-fast: $(VENV)/installed-test  ## the suite without its long statistics
	$(PYTEST) -m "not slow" $(ARGS)

lint: $(VENV)/installed-dev  ## ruff (rules and format) and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(VENV)/installed-dev  ## let ruff format the code and sort the imports
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove the virtual environment, caches and builds; out/ stays
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: an install runs again only when pyproject.toml or constraints.txt changed.
$(VENV)/created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "fovconn-env needs Python 3.11 or newer: make PYTHON=python3.12 ..." >&2; exit 1; }
	@echo "creating $(VENV) with $$($(PYTHON) --version) ..."
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/installed-demo: pyproject.toml constraints.txt $(VENV)/created
	@echo "installing the package and what the demo needs (about 20 s) ..."
	@$(PIP) hatchling editables
	@$(PIP) -e '.[demo]'
	@touch $@

$(VENV)/installed-test: $(VENV)/installed-demo
	@echo "installing what the tests need (about 5 s) ..."
	@$(PIP) -e '.[demo,test]'
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed-demo
	@echo "installing ruff and pyright (about 5 s) ..."
	@$(PIP) -e '.[demo,dev]'
	@touch $@
