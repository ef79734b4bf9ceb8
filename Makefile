# `make demo` and `make test` do everything on a fresh machine with Python 3.11+: environment, packages, run. The demo
# installs the core only, tests and checks what they need besides.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
CORE := $(VENV)/.core
DEV := $(VENV)/.dev
# Bytecode is left to the first import: compiling all of every package takes longer than installing it.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt

.PHONY: baseline install dev demo design-demo test coverage test-all lint types contracts check accuracy benchmarks pictures fem challenge power docs docs-links clean

install: $(CORE)

dev: $(DEV)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed (PYTHON=...)"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(CORE): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e .
	touch $@

$(DEV): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e '.[dev]'
	touch $(CORE) $@

# The finite-element extra (GPL and proprietary parts; see docs/decisions) is asked for by name.
fem: dev
	$(PIP) -e '.[dev,fem]'

demo: install
	$(BIN)/evanesce demo

# Rigs of no more than the thesis rig's cost, by their predicted area error: some ten minutes on two quiet cores. An
# interrupted run resumes where it stopped.
design-demo: dev
	$(BIN)/evanesce design scenes/questions/same_cost.toml --workers 2 --out outputs/design-demo

# Two workers of one thread each: linear algebra that takes both cores in both of them waits for itself.
PYTEST = OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal \
  -m "not slow and not whole_case" --durations 10

test: dev
	$(PYTEST)

# The same tests: lines are counted as they run, which takes longer, and what is covered least is shown.
coverage: dev
	$(PYTEST) --cov --cov-report=
	@$(BIN)/coverage report > .coverage-report && head -n 14 .coverage-report && tail -n 1 .coverage-report

test-all: dev
	$(BIN)/python -m pytest

lint: dev
	$(BIN)/ruff check src tests benchmarks docs examples .ci
	$(BIN)/ruff format --check src tests benchmarks docs examples .ci

types: dev
	$(BIN)/mypy

contracts: dev
	$(BIN)/lint-imports

# The fast renderer against the path tracer on all contacts: some ten minutes.
accuracy: dev
	$(BIN)/python -m pytest -m slow tests/physics/test_fast_agreement.py

pictures: dev
	$(BIN)/python docs/pictures/make.py

benchmarks: dev
	$(BIN)/python benchmarks/render.py
	$(BIN)/python benchmarks/measure.py
	$(BIN)/python benchmarks/calibrate.py

# Two slip detectors trained on a small generated set and scored on unseen friction and ridges.
baseline: dev
	$(BIN)/python benchmarks/baseline.py --out outputs/baseline --json outputs/baseline.json

# The site in docs/_build/html, without a network once packages are installed. A name, page or picture that is referred
# to and missing, a link within the site that leads nowhere, and an example that fails are errors.
DOCS := $(VENV)/.docs

$(DOCS): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e '.[dev,docs]'
	touch $(CORE) $(DEV) $@

docs: $(DOCS)
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

# Pages and README as they stand: every relative link and every anchor, in under ten seconds.
docs-links: dev
	$(BIN)/python -m pytest tests/system/test_docs_links.py

check: lint types contracts test

# The critic against hidden causes, in two processes of one thread each: hours; goes on where it stopped. SET=dev while
# developing; BUDGET in seconds and LIMIT in cases run a part, which is a fair sample of the whole.
SET ?= scored
BUDGET ?= 1e9
LIMIT ?= 0
challenge: dev
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m tests.inference.challenge.run \
	  --set $(SET) --workers 2 --budget $(BUDGET) --limit $(LIMIT) --beside matched-filters

# Expected power of the joint critic by cause and strength, from noiseless signals: some minutes.
power: dev
	$(BIN)/python benchmarks/critic_power.py

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis docs/_build docs/gallery docs/reference/api
