# Everything runs in a virtual environment of its own. `make` alone lists the targets.
PYTHON ?= python3
VENV ?= .venv
LIBRARIES ?= .venvs
WORKERS ?= 2
ARGS ?=
PYTHONS ?=
RAY ?=
LONG := --policy expert --policy expert-flooding --policy augmented --policy omni
SHOWN := LeaderFollow-v0_curves.png LeaderObstacles-v0_causes.png

BIN := $(VENV)/bin
# -qq hides progress and warnings about indexes, never an error. No isolation: the build tools are pinned as well.
# No compiling: Python does it for what is imported, which halves the wait.
INSTALL := -m pip install -qq --disable-pip-version-check --no-compile --no-build-isolation
PIP := $(BIN)/python $(INSTALL) -c constraints.txt
# tests of what needs libraries that `make test` has not
LEARNERS = $(shell grep -rlE 'importorskip.*"(rerun|stable_baselines3|torch)"' tests --include='test_*.py' --exclude-dir=integrations)
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

# Where this is set, as in many containers, each of the suite's hundred processes would compile all that it imports.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help demo results docs site test suite suite-nojit test-fast test-integrations test-pythons fuzz lint format dist clean
ifndef BESIDE
.NOTPARALLEL:
endif

help:  ## list the targets
	@$(PYTHON) -c 'import re; [print(f"  make {name:17} {what}") for name, what in re.findall("(?m)^([a-z-]+):.*## (.*)$$", open("Makefile", encoding="utf-8").read())]'
	@echo 'demo, test-fast and test-integrations hand ARGS on: make demo ARGS="--seed 3", make test-fast ARGS="-k camera"'
	@echo 'results flies on a Ray cluster as well: make results RAY="--ray auto", with the extra cluster installed'

demo: $(VENV)/installed-demo  ## the paper's experiment: a table here, figures and an animation in out/demo/
	$(BIN)/fovconn demo $(ARGS)

test: $(VENV)/installed-dev  ## the whole suite, and beside it the part that also runs without the JIT
	@$(MAKE) --no-print-directory --keep-going -j2 BESIDE=yes suite suite-nojit

suite:
	$(PYTEST)

suite-nojit:  # half the processes: it has a fifth of the work
	NUMBA_DISABLE_JIT=1 $(PYTEST) -n $$((($(WORKERS) + 1) / 2)) -m nojit >$(VENV)/nojit.log 2>&1; status=$$?; cat $(VENV)/nojit.log; exit $$status

test-fast: $(VENV)/installed-dev  ## the suite without its long statistics
	$(PYTEST) -m "not slow" $(ARGS)

test-integrations: $(addprefix $(LIBRARIES)/,$(addsuffix /installed,current older ros))  ## docs/examples, each with its library (torch, 3 GB)
	$(LIBRARIES)/current/bin/python -m pytest tests/integrations $(LEARNERS) $(ARGS)
	$(LIBRARIES)/older/bin/python -m pytest tests/integrations $(ARGS)
	$(LIBRARIES)/ros/bin/python -m pytest tests/integrations/test_ros2.py $(ARGS)

test-pythons: $(VENV)/installed-dev  ## a wheel, installed and flown with each Python from 3.11 on that is found (PYTHONS="...")
	$(BIN)/python tests/pythons.py $(PYTHONS)

fuzz: $(VENV)/installed-dev  ## the tests with random inputs, with as many as docs/security.md promises (hours)
	FUZZ=full $(PYTEST) -m fuzz $(ARGS)

results: $(VENV)/installed-demo  ## fly all that docs/results shows (two hours), write it, and check it
	$(BIN)/fovconn eval $(RAY) --suite full --out out/results/full --json docs/results/full.json
	$(BIN)/fovconn submit $(RAY) $$($(BIN)/python -c 'from fovconn_env.baselines import *; print(*POLICIES, *ORACLES)') --out out/results/full
	$(BIN)/fovconn leaderboard $(RAY) out/results/full/*.npz --draw 1 --out out/results/leaderboard --json docs/results/leaderboard.json
	$(BIN)/fovconn eval $(RAY) $(LONG) --seeds 0-999 --out out/results/thousand --json docs/results/thousand.json
	$(BIN)/fovconn eval $(RAY) $(LONG) --seeds 0-999 --set stick_speed=2.5 --out out/results/fast --json docs/results/fast.json
	$(BIN)/fovconn figures $(RAY) --ablations --seeds 0-319 --out out/results/ablations --json docs/results/ablations.json
	$(BIN)/python -m fovconn_env.training.evaluation levels learned cameras envelope
	cp out/results/ablations/ablations.png out/results/leaderboard/leaderboard.png docs/images/
	cp $(addprefix out/results/full/plots/,$(SHOWN)) docs/images/
	$(BIN)/python docs/shrink.py
	$(BIN)/python docs/tables.py
	$(BIN)/python -m fovconn_env.training.evaluation check

docs: $(VENV)/installed-demo  ## write the tables of README.md and docs anew, from docs/results and the code
	$(BIN)/python docs/tables.py

site: $(LIBRARIES)/site/installed  ## build the documentation site, out/site/index.html, and check it
	$(LIBRARIES)/site/bin/python -m mkdocs build
	$(LIBRARIES)/site/bin/python -m pytest tests/site $(ARGS)

lint: $(VENV)/installed-dev  ## ruff (rules and format), the direction of imports, and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/pyright --pythonpath $(BIN)/python -p tests/user_project

format: $(VENV)/installed-dev  ## let ruff format the code and sort the imports
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

dist: $(VENV)/installed-demo $(LIBRARIES)/twine/installed  ## build the sdist and the wheel in dist/, and check them
	rm -rf dist
	$(BIN)/python -m hatchling build
	$(LIBRARIES)/twine/bin/twine check --strict dist/*

clean:  ## remove the virtual environments, caches and builds; out/ stays
	rm -rf $(VENV) $(LIBRARIES) build dist .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: an install runs again only when pyproject.toml or constraints.txt changed.
$(VENV)/created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "fovconn-env needs Python 3.11 or newer: make PYTHON=python3.12 ..." >&2; exit 1; }
	@echo "creating $(VENV) with $$($(PYTHON) --version) ..."
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/installed-demo: EXTRAS := cli,render
$(VENV)/installed-dev: EXTRAS := dev
$(VENV)/installed-demo $(VENV)/installed-dev: pyproject.toml constraints.txt $(VENV)/created
	@echo "installing the package with [$(EXTRAS)] (about 20 s) ..."
	@$(PIP) hatchling editables
	@$(PIP) -e .
	@$(BIN)/python -m fovconn_env.baselines & $(PIP) -e '.[$(EXTRAS)]' && wait $$!  # compiles while pip unpacks
	@touch $@

$(LIBRARIES)/twine/installed: constraints.txt
	@echo "installing twine in $(@D) (about 5 s) ..."
	@rm -rf $(@D)
	@$(PYTHON) -m venv $(@D)
	@$(@D)/bin/python -m pip install -qq --disable-pip-version-check --no-compile -c constraints.txt twine
	@touch $@

$(LIBRARIES)/site/installed: pyproject.toml constraints.txt
	@echo "installing the package with [site] in $(@D) (about 20 s) ..."
	@rm -rf $(@D)
	@$(PYTHON) -m venv $(@D)
	@$(@D)/bin/python $(INSTALL) -c constraints.txt hatchling editables
	@$(@D)/bin/python $(INSTALL) -c constraints.txt -e '.[site]'
	@touch $@

# One virtual environment for each list of versions in tests/integrations/; made anew when that list changed.
$(LIBRARIES)/%/installed: tests/integrations/%.txt pyproject.toml constraints.txt
	@echo "installing the libraries of $< in $(@D) (about 40 s) ..."
	@rm -rf $(@D)
	@$(PYTHON) -m venv $(@D)
	@$(@D)/bin/python $(INSTALL) -c constraints.txt hatchling editables setuptools
	@$(@D)/bin/python $(INSTALL) -r $< -e .
	@touch $@
