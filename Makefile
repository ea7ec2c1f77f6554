# Everything a fresh clone needs: python 3.11 or newer, pip and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
COMPILE := uv pip compile pyproject.toml --universal --generate-hashes \
  --no-emit-index-url --no-header

# The tests start hundreds of short processes: each module is compiled once, not once for each.
export PYTHONDONTWRITEBYTECODE =
export OPENBLAS_NUM_THREADS = 1

.PHONY: run test suite nightly mutants torture lint bench bundle lock clean

run: $(VENV)/ready  ## calibrate the simulated paper cell and print the table
	$(BIN)/hilcell run

test: $(VENV)/ready  ## lint beside the tests
	$(MAKE) --no-print-directory --jobs 2 lint suite

suite: $(VENV)/compiled  ## every test but the long sweeps, in random order on all cores
	$(BIN)/python -m pytest -n auto --dist worksteal

nightly: lint  ## every test and every long sweep, property tests with fresh seeds
	$(BIN)/python -m pytest -n auto --dist worksteal -m "" --timeout 1200 --hypothesis-profile nightly

mutants: $(VENV)/ready  ## deliberate breaks, each of which a test must notice; ONLY=name for one
	$(BIN)/python -m tests.mutants $(ONLY)

torture: $(VENV)/ready  ## the long campaigns: faults, disturbances, kills, fuzz, days, ..; ONLY=name for one
	$(BIN)/python -m tests.torture $(ONLY)

lint: $(VENV)/ready  ## style, types and the import contract
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/ready  ## timings, as ratios within one run
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks

# A fresh clone's tests are compiled once, not by each worker for itself: 7 s of processor each.
$(VENV)/compiled: $(VENV)/ready
	-$(BIN)/python -m pytest --collect-only -q > /dev/null
	touch $@

$(VENV)/ready: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

bundle: $(VENV)/ready  ## one archive in dist/ that installs on a PC without a network
	sh .ci/bundle/make.sh $(BIN)/python

lock:  ## pin every dependency by hash, for all supported pythons; those of a run by themselves
	$(COMPILE) --extra dev --extra build --output-file requirements.lock
	$(COMPILE) --extra offline --constraint requirements.lock --output-file requirements-run.lock

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
