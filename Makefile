# `make demo` and `make test` do everything on a fresh machine with Python 3.11+: environment, packages, run.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: baseline install demo design-demo test test-all lint types contracts check accuracy benchmarks pictures fem challenge challenge-slice docs docs-links clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed (PYTHON=...)"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

# The finite-element extra (GPL and proprietary parts; see docs/decisions) is asked for by name.
fem: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,fem]'

demo: install
	$(BIN)/evanesce demo

# Rigs of no more than the thesis rig's cost, by their predicted area error: some ten minutes on two quiet cores. An
# interrupted run resumes where it stopped.
design-demo: install
	$(BIN)/evanesce design scenes/questions/same_cost.toml --workers 2 --out outputs/design-demo

# Two workers of one thread each: linear algebra that takes both cores in both of them waits for itself.
test: install
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

test-all: install
	$(BIN)/python -m pytest

lint: install
	$(BIN)/ruff check src tests benchmarks docs
	$(BIN)/ruff format --check src tests benchmarks docs

types: install
	$(BIN)/mypy

contracts: install
	$(BIN)/lint-imports

# The fast renderer against the path tracer on all contacts: some ten minutes.
accuracy: install
	$(BIN)/python -m pytest -m slow tests/physics/test_fast_agreement.py

pictures: install
	$(BIN)/python docs/pictures/make.py

benchmarks: install
	$(BIN)/python benchmarks/render.py
	$(BIN)/python benchmarks/measure.py

# Two slip detectors trained on a small generated set and scored on unseen friction and ridges.
baseline: install
	$(BIN)/python benchmarks/baseline.py --out outputs/baseline --json outputs/baseline.json

# The site in docs/_build/html, without a network once packages are installed. A name, page or picture that is referred
# to and missing, a link within the site that leads nowhere, and an example that fails are errors.
DOCS_STAMP := $(VENV)/.docs

$(DOCS_STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,docs]'
	touch $@

docs: $(DOCS_STAMP)
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

# Pages and README as they stand: every relative link and every anchor, in under ten seconds.
docs-links: install
	$(BIN)/python -m pytest tests/system/test_docs_links.py

check: lint types contracts test

# The critic against hidden causes: hours, goes on where it stopped. SET=dev while developing, BUDGET in seconds. Cases
# whose outcome is known are left out.
SET ?= scored
BUDGET ?= 1e9
challenge: install
	$(BIN)/python -m tests.criticism.challenge.run --set $(SET) --workers 2 --budget-s $(BUDGET) \
	  --beside largest-prior chi-square nearest-signature --spent docs/criticism/runs/scored-*.jsonl

challenge-slice: install
	$(BIN)/python -m tests.criticism.challenge.run --set slice --workers 2 --budget-s 600

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis docs/_build docs/gallery docs/reference/api
