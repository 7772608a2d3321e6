# Plain verbs. Each sets up what it needs: only git, make and Python >= 3.11 must be there.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# One thread for linear algebra: matrices are small, and a second thread only adds jitter.
export OPENBLAS_NUM_THREADS := 1

.PHONY: demo test test-slow test-browser test-hostile test-live test-peers bench-peers docs lint format setup clean help

help:  ## list the verbs
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/'

demo: $(VENV)/.installed  ## set up and run the paper's experiment
	$(BIN)/pulsempc run paper

test: $(VENV)/.installed-dev  ## set up and run the test suite
	$(BIN)/python -m pytest -n 2 --dist loadfile

test-browser: $(VENV)/.installed-browser  ## the report in headless Chromium (CHROMIUM=path; .ci/chromium gets one)
	$(BIN)/python -m pytest -m browser -rPs tests/bench/browser

test-slow: $(VENV)/.installed-dev  ## what takes longer than the suite may
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

test-hostile: $(VENV)/.installed-dev  ## 13,000 hostile command sequences against the protection
	$(BIN)/python -m pytest -n 2 -m hostile -rP tests/plant/test_protection.py tests/plant/test_redundant.py

test-live: $(VENV)/.installed-dev  ## a live setpoint for a minute, its sender killed, the port flooded
	$(BIN)/python -m pytest -m minute -rP tests/scenarios/test_live_siege.py

test-peers: $(VENV)/.installed-dev  ## run a real peer end to end, from PyPI
	$(BIN)/python -m pytest -m peers tests/bench/test_peers.py

bench-peers: $(VENV)/.installed  ## other MPC packages on the same instances, each in its own environment
	$(BIN)/python -m bench.peers

docs: $(VENV)/.installed-docs  ## build the pages, notebooks run, into docs/_build/html
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

lint: $(VENV)/.installed-dev  ## style, types, layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.installed-dev  ## put the code into its form
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

setup: $(VENV)/.installed-dev  ## set up for development

clean:  ## remove the environment and caches, keep results
	rm -rf $(VENV) .browser .peers .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "pulsempc needs Python >= 3.11; name one: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary pulsempc -e .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary pulsempc -e '.[dev]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary pulsempc -e '.[docs]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-browser: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary pulsempc -e '.[dev,browser]'
	@touch $@ $(VENV)/.installed-dev $(VENV)/.installed
