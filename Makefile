# Every target installs what it needs into .venv. Apart from the caches of pip and uv, nothing else on the machine changes.
#   make demo                      generates a motion as a page, a GIF and a BVH file
#   make test PYTEST_ARGS="-x tests/motion"
#   make lint PYTHON=python3.12    creates .venv with that Python; an existing .venv is kept
#   make test PYTHON=python3.12 VENV=.venv-3.12    uses an environment of its own

# The newest Python of this machine. The slow tests run with the oldest one, so that every change sees both.
PYTHON ?= $(shell .ci/find-python 3.13 3.12 3.11 || echo python3)
OLDEST := $(shell .ci/find-python 3.11 3.12 3.13 || echo python3)
VENV ?= .venv
BIN := $(VENV)/bin
SLOW_VENV := $(if $(and $(filter file,$(origin PYTHON)),$(filter-out $(OLDEST),$(PYTHON))),.venv-oldest,$(VENV))
# The tests of a file share what they compile, so they run in one process.
FAST := -m "not slow and not release" --ignore tests/lint
# As users run the package: only the fast tests check shapes at run time, for which many functions are compiled again.
SLOW = -m "$(or $(TIER),slow and not release)" -o "addopts=-ra --strict-markers"
BY_FILE := --dist loadfile --no-loadscope-reorder
# Tests start many processes. Without bytecode on disk, each would compile JAX and everything else again.
unexport PYTHONDONTWRITEBYTECODE
PROMPT ?= a person waves with the left hand

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-release test-lowest test-python3.11 test-python3.12 test-python3.13 soak soak-serve soak-hostile faults lint lint-style lint-types lint-tests three runtime page format docs notebooks clean

help:
	@echo "make demo       generate a motion and print where it was saved"
	@echo "make test       run the tests that take a short time (PYTEST_ARGS=\"...\" for other options of pytest)"
	@echo "make test-slow  run the other tests, with the oldest Python that is supported and found"
	@echo "make test-release  run the tests that take minutes each, before a release"
	@echo "make test-lowest      run the tests with the lowest versions that pyproject.toml allows"
	@echo "make test-python3.12  run the tests with this Python, also with 3.11 and 3.13"
	@echo "make soak       attack the readers of files with a million inputs (SOAK_ARGS=\"--inputs 10000\" for fewer)"
	@echo "make soak-serve  load the server with many clients, and kill its process (SOAK_ARGS=\"--clients 10\" for fewer)"
	@echo "make soak-hostile  send 200,000 hostile requests to the server beside a user (SOAK_ARGS=\"--requests 3000\" for fewer)"
	@echo "make faults     plant mistakes in copies of the package, which fast tests must find (FAULT=mirror for some)"
	@echo "make lint       check style, imports, types, pages, configs and the Dockerfile"
	@echo "make three      build the part of three.js that the pages use (needs npm)"
	@echo "make runtime    build the part of onnxruntime-web that exported pages use (needs npm)"
	@echo "make page       write the page that makes motions in the browser, with the model \`demo-free\`, to page/"
	@echo "make format     format the code"
	@echo "make docs       write the documentation to site/index.html, and check its links"
	@echo "make notebooks  run the notebooks and save their outputs"
	@echo "make clean      remove .venv, caches and generated files"

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# Installs t2m_jax with extras into .venv. uv takes seconds where pip takes a minute or two, but does not read the settings
# of pip, which may name the only server that can be reached.
define install
@$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
@$(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.$(1)' || \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.$(1)'
@touch $(VENV)/.base $@
endef

# These files record which extras are installed in .venv. A change of pyproject.toml makes them out of date.
$(VENV)/.base: pyproject.toml | $(BIN)/python
	@echo "Installing t2m_jax and what it needs into $(VENV): a minute or two."
	$(call install)

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	@echo "Installing t2m_jax and the tools of its tests into $(VENV): a minute or two."
	$(call install,[dev])

$(VENV)/.notebooks: pyproject.toml | $(BIN)/python
	@echo "Installing what the notebooks need into $(VENV): a minute or two."
	$(call install,[notebooks])

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	@echo "Installing what the documentation needs into $(VENV): a minute or two."
	$(call install,[docs])

# Further environments to test in: .venv-oldest, .venv-lowest and .venv-python3.12. uv can choose the lowest versions.
.venv-lowest/.dev: RESOLUTION := lowest-direct
.venv-lowest/.dev .venv-oldest/.dev: VERSION_PATH = $(OLDEST)
.venv-%/.dev: VERSION_PATH = $(shell .ci/find-python $(patsubst python%,%,$*))
.venv-%/.dev: pyproject.toml $(VENV)/.dev
	@echo "Installing t2m_jax and the tools of its tests into .venv-$*: a minute or two."
	$(BIN)/uv venv --quiet --clear --seed --no-python-downloads --python "$(VERSION_PATH)" .venv-$*
	$(BIN)/uv pip install --quiet --python .venv-$*/bin/python --resolution $(or $(RESOLUTION),highest) --editable '.[dev]'
	@touch $@

demo: $(VENV)/.base
	@mkdir -p demo
	$(BIN)/t2m generate "$(PROMPT)" -o demo/wave.html -o demo/wave.gif -o demo/wave.bvh
	@echo "To use the command t2m in this terminal: source $(VENV)/bin/activate"

test: $(VENV)/.dev
	$(BIN)/python -m pytest $(FAST) $(or $(PYTEST_ARGS),-n 2 $(BY_FILE))

# Slow tests often wait for browsers, for servers and for commands that end, so three processes keep two cores busy.
test-release: TIER := release
test-slow test-release: $(SLOW_VENV)/.dev
	$(SLOW_VENV)/bin/python -m pytest $(SLOW) $(or $(PYTEST_ARGS),-n 3 $(BY_FILE))

test-lowest test-python3.11 test-python3.12 test-python3.13: test-%: .venv-%/.dev
	.venv-$*/bin/python -m pytest $(FAST) $(or $(PYTEST_ARGS),-n 2 $(BY_FILE))

soak: $(VENV)/.dev
	$(BIN)/python -m tests.fuzz.soak $(SOAK_ARGS)

soak-serve: $(VENV)/.dev
	$(BIN)/python -m tests.serving.soak $(SOAK_ARGS)

soak-hostile: $(VENV)/.dev
	$(BIN)/python -m tests.serving.hostile $(SOAK_ARGS)

faults: $(VENV)/.dev
	$(BIN)/python -m tests.faults $(FAULT)

# In three parts, of which make can run two at once: `make --jobs=2 lint`.
lint: lint-style lint-types lint-tests

lint-style: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/hadolint Dockerfile

lint-types: $(VENV)/.dev
	$(BIN)/mypy

lint-tests: $(VENV)/.dev
	$(BIN)/python -m pytest -m "not slow" -q tests/lint

# Only needed for another version of three.js, the renderer of the pages; the result is part of the package.
three:
	cd t2m_jax/export/viewer/vendor && npm ci && npm run build

# Only needed for another version of onnxruntime-web; the result is part of the package.
runtime:
	cd t2m_jax/export/page/web/vendor && npm ci --ignore-scripts && npm run build

page: $(VENV)/.dev
	rm -rf page
	$(BIN)/t2m export page $(or $(MODEL),demo-free) page

format: $(VENV)/.dev
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

docs: $(VENV)/.docs
	$(BIN)/sphinx-build --quiet --fresh-env --fail-on-warning --keep-going --conf-dir docs . site

notebooks: $(VENV)/.notebooks
	$(BIN)/python notebooks/run.py

clean:
	rm -rf $(VENV) .venv-* demo build dist page site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
