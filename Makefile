# Everything a fresh machine needs: Python >= 3.11, make and a package index.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
unexport PYTHONDONTWRITEBYTECODE  # the tests start hundreds of processes, each of which would compile the project again
.DELETE_ON_ERROR:
.PHONY: demo test test-rest test-all lint types floors bench reliability docs pictures clean help

help:  ## what can be made
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

define installed
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "hil needs Python 3.11 or newer; try: make PYTHON=python3.11 demo")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '$(1)'
endef

$(VENV)/run.stamp: pyproject.toml constraints.txt
	$(call installed,.)
	@touch $@

$(VENV)/dev.stamp: pyproject.toml constraints.txt
	$(call installed,.[dev])
	@touch $(VENV)/run.stamp $@

# One more than there are processors: every sixth minute of tests is a real process or port that is waited for.
SIDE_BY_SIDE = -n $$(($$(nproc) < 4 ? $$(nproc) + 1 : 4)) --dist worksteal

demo: $(VENV)/run.stamp  ## the published night on the simulated bench, to a report
	$(BIN)/hil demo

test: $(VENV)/dev.stamp  ## every behaviour once, in minutes
	$(BIN)/python -m pytest -q $(SIDE_BY_SIDE) -m "not slow"

test-rest: $(VENV)/dev.stamp  ## what `make test` leaves out: full matrices, statistics over many seeds, what takes long
	$(BIN)/python -m pytest -q $(SIDE_BY_SIDE) -m slow

test-all: test test-rest  ## every test

lint: $(VENV)/dev.stamp  ## format and lint
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(VENV)/dev.stamp  ## strict type check
	$(BIN)/mypy

floors: $(VENV)/dev.stamp  ## imports only go down: drivers, procedures, hil
	$(BIN)/lint-imports

bench: $(VENV)/dev.stamp  ## the numbers in docs/benchmarks.md
	$(BIN)/python -m pytest -q benchmarks --benchmark-only --benchmark-disable-gc -p no:randomly

reliability: $(VENV)/dev.stamp  ## the numbers in docs/reliability.md, in a few hours
	$(BIN)/python -m benchmarks.reliability.kill points
	$(BIN)/python -m benchmarks.reliability.kill instants --take 200 --seed 1
	$(BIN)/python -m benchmarks.reliability.kill twice --take 150 --seed 1
	$(BIN)/python -m benchmarks.reliability.kill resuming
	$(BIN)/python -m benchmarks.reliability.kill power --take 500 --seed 2
	unshare --map-root-user --mount $(BIN)/python -m benchmarks.reliability.disks
	$(BIN)/python -m benchmarks.reliability.flips bytes
	$(BIN)/python -m benchmarks.reliability.flips rows
	$(BIN)/python -m benchmarks.reliability.starved memory
	$(BIN)/python -m benchmarks.reliability.starved descriptors
	$(BIN)/python -m benchmarks.reliability.suspend
	$(BIN)/python -m benchmarks.reliability.combined lies
	$(BIN)/python -m benchmarks.reliability.combined pairs
	$(BIN)/python -m benchmarks.reliability.contradictions
	$(BIN)/python -m benchmarks.reliability.contradictions --clean 1000
	$(BIN)/python -m benchmarks.reliability.ledger_cost
	$(BIN)/python -m benchmarks.reliability.long_night
	$(BIN)/python -m benchmarks.reliability.rehearse --nights 1000 --seed 1
	$(BIN)/python -m benchmarks.twin_calibration --nights 200
	$(BIN)/python -m benchmarks.coverage run --keep coverage.jsonl

docs: $(VENV)/run.stamp  ## the documentation as HTML in docs/site; no network
	$(BIN)/hil docs --site docs/site

pictures: $(VENV)/dev.stamp  ## pictures of report, reconciliation, plots and live page, in docs/pictures; needs Chromium
	$(BIN)/python docs/pictures.py
	$(BIN)/python docs/screenshots.py docs/pictures

clean:  ## remove the virtual environment, the demo, the pictures and the site
	rm -rf $(VENV) demo docs/pictures docs/site
