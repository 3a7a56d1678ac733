# Every target installs what it needs into .venv. Apart from pip's cache, nothing else on the machine changes.
#   make demo                      generates a motion as a page, a GIF and a BVH file
#   make test PYTEST_ARGS="-x tests/motion"
#   make lint PYTHON=python3.12    creates .venv with that Python; an existing .venv is kept

PYTHON ?= python3
PYTEST_ARGS ?= -n 2
VENV ?= .venv
BIN := $(VENV)/bin
PROMPT ?= a person waves with the left hand

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow soak lint format docs notebooks clean

help:
	@echo "make demo       generate a motion and print where it was saved"
	@echo "make test       run the tests that take a short time (PYTEST_ARGS=\"...\" for other options of pytest)"
	@echo "make test-slow  run the other tests"
	@echo "make soak       attack the readers of files with a million inputs (SOAK_ARGS=\"--inputs 10000\" for fewer)"
	@echo "make lint       check style, imports, types and the Dockerfile"
	@echo "make format     format the code"
	@echo "make docs       write the documentation to site/index.html, and check its links"
	@echo "make notebooks  run the notebooks and save their outputs"
	@echo "make clean      remove .venv, caches and generated files"

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# These files record which extras are installed in .venv. A change of pyproject.toml makes them out of date.
$(VENV)/.base: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(VENV)/.base $@

$(VENV)/.notebooks: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[notebooks]'
	@touch $(VENV)/.base $@

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $(VENV)/.base $@

demo: $(VENV)/.base
	@mkdir -p demo
	$(BIN)/t2m generate "$(PROMPT)" -o demo/wave.html -o demo/wave.gif -o demo/wave.bvh

test: $(VENV)/.dev
	$(BIN)/python -m pytest -m "not slow" $(PYTEST_ARGS)

test-slow: $(VENV)/.dev
	$(BIN)/python -m pytest -m slow $(PYTEST_ARGS)

soak: $(VENV)/.dev
	$(BIN)/python -m tests.fuzz.soak $(SOAK_ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/hadolint Dockerfile

format: $(VENV)/.dev
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

docs: $(VENV)/.docs
	$(BIN)/sphinx-build --quiet --fresh-env --fail-on-warning --keep-going --conf-dir docs . site

notebooks: $(VENV)/.notebooks
	$(BIN)/python notebooks/run.py

clean:
	rm -rf $(VENV) demo build dist site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
