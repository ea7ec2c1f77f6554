# Everything a fresh clone needs: Python 3.11, 3.12 or 3.13, pip and make. Another Python than the
# machine's own has an environment beside the first: `make test PYTHON=python3.13`.
PYTHON ?= python3
VENV := .venv$(if $(filter-out python3,$(PYTHON)),-$(notdir $(PYTHON)))
BIN := $(VENV)/bin
# One version of each package on all Pythons: one set of types and of digits.
COMPILE := uv pip compile pyproject.toml --universal --fork-strategy fewest --generate-hashes \
  --no-emit-index-url --no-header

# The tests start hundreds of short processes: each module is compiled once, not once for each.
export PYTHONDONTWRITEBYTECODE =
export OPENBLAS_NUM_THREADS = 1

.PHONY: run test together waiting processes alone recordings nightly mutants torture lint types docs gauges bench bundle lock clean

run: $(VENV)/ready  ## calibrate the simulated paper cell and print the table
	$(BIN)/hilcell run --full

test: $(VENV)/more  ## all lanes and lint at once; then the deadlines, with nothing beside
	@export GOLDEN_RUNS=$$(mktemp -d); trap 'rm -rf "$$GOLDEN_RUNS"' EXIT; \
	$(MAKE) --no-print-directory --jobs 4 together waiting processes lint && \
	$(MAKE) --no-print-directory alone

together: $(VENV)/compiled  ## tests in event time, in random order on all cores
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not (nightly or process or waits or wall)"

waiting: $(VENV)/compiled  ## tests in event time that mostly wait, and need no core of their own
	$(BIN)/python -m pytest -m "waits and not (nightly or process or wall)" $$(grep -lr --include="test_*.py" mark.waits tests)

processes: $(VENV)/compiled  ## tests that start processes and hold at any pace
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "process and not (nightly or wall)" $$(grep -lr --include="test_*.py" mark.process tests)

alone: $(VENV)/compiled  ## tests of real deadlines, one at a time
	$(BIN)/python -m pytest -m "wall and not nightly" $$(grep -lr --include="test_*.py" mark.wall tests)

recordings: $(VENV)/more  ## tests/wires: run each kept recording's run again, keep it in its place
	$(BIN)/python -m tests.whole.recordings

NIGHTLY := --timeout 1200 --hypothesis-profile nightly
nightly: lint types  ## every test and every long sweep, property tests with fresh seeds
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not wall" $(NIGHTLY)
	$(BIN)/python -m pytest -m wall $(NIGHTLY)

mutants: $(VENV)/more  ## deliberate breaks, each of which a test must notice; ONLY=name, or ONLY=hilcell.run
	$(BIN)/python -m campaigns.breaks $(ONLY)

torture: $(VENV)/more  ## the long campaigns: faults, disturbances, kills, fuzz, days, ..; ONLY=name for one
	$(BIN)/python -m campaigns $(ONLY)

lint: $(VENV)/more  ## style, types and the import contract
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyrefly check --python-interpreter-path $(BIN)/python --output-format min-text
	$(BIN)/lint-imports

types: $(VENV)/more  ## types once more, by mypy
	$(BIN)/mypy

docs: $(VENV)/docs  ## the manual as a site in site/, with the pages that are written from the code
	$(BIN)/python -m hilcell.alarms.page > docs/alarms.md
	$(BIN)/python -m hilcell.commands.manual > docs/cli.md
	$(BIN)/python -m fakes.truth.sizes_page > docs/machine-sizes.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --clean

gauges:  ## modules, lines, names, Any, shapes of each noun; docs/architecture.md
	@$(PYTHON) benchmarks/gauges.py

bench: $(VENV)/more  ## timings, as ratios within one run
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks

# A fresh clone is compiled once, and not by each worker and engine of its tests.
$(VENV)/compiled: $(VENV)/more
	-$(BIN)/python -m compileall -q hilcell drivers procedures fakes
	touch $@

$(VENV)/ready: requirements-run.lock pyproject.toml
	@$(PYTHON) -c "import sys; sys.exit(0 if (3, 11) <= sys.version_info[:2] <= (3, 13) else \
	  'expected Python 3.11, 3.12 or 3.13, got ' + sys.version.split()[0] + '; name another: make PYTHON=python3.11')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-run.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

# What tests need, `hilcell study` and `hilcell plant`; a run needs none of it.
$(VENV)/more: requirements.lock requirements-more.lock $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-more.lock
	touch $@

# What only the site needs.
$(VENV)/docs: requirements-docs.lock $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	touch $@

bundle: $(VENV)/ready  ## one archive in dist/ that installs on a PC without a network
	sh .ci/bundle/make.sh $(BIN)/python

lock:  ## pin every dependency by hash, for all supported pythons; those of a run by themselves
	$(COMPILE) --extra dev --extra build --output-file requirements.lock
	$(COMPILE) --extra dev --extra pandas --extra study --extra plant --constraint requirements.lock --output-file requirements-more.lock
	$(COMPILE) --extra docs --constraint requirements-more.lock --output-file requirements-docs.lock
	$(COMPILE) --extra offline --extra build --constraint requirements.lock --output-file requirements-run.lock

clean:
	rm -rf .venv* .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache site
