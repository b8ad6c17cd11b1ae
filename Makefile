# Needs only Python 3.11 or later with venv, and make. Everything is built into .venv.

# The interpreter: make PYTHON=python3.12 demo picks one.
CANDIDATES = python3.14 python3.13 python3.12 python3.11 python3 python
SUITABLE = import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(shell for p in $(CANDIDATES); do if $$p -c '$(SUITABLE)' >/dev/null 2>&1; then echo $$p; break; fi; done)

BIN = .venv/bin
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check

# The libraries below NumPy need no threads of their own here: the problems are small.
export OPENBLAS_NUM_THREADS = 1

.PHONY: help demo test check study bench install dev clean

help:
	@echo "make demo   calibrate a simulated recording with known truth, from nothing"
	@echo "make test   run the tests, from nothing"
	@echo "make check  lint, format, types, import contract, examples in docstrings"
	@echo "make study  run the tests that take minutes"
	@echo "make bench  run the benchmarks"
	@echo "make clean  remove .venv and what the tools left behind"

demo: install
	@$(BIN)/gnomon demo

# A process for each core; the tests of one file stay together, since they share what they prepare.
test: dev
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

check: dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports
	$(BIN)/python -m pytest --doctest-modules src

study: dev
	$(BIN)/python -m pytest -m slow

bench: dev
	$(BIN)/python benchmarks/imu.py
	$(BIN)/python benchmarks/camera_imu.py
	$(BIN)/python benchmarks/images.py --quick
	$(BIN)/python benchmarks/noise.py --quick
	$(BIN)/python benchmarks/platter_rate.py

# Empty files in .venv say what is installed there, so that it is done once.
install: .venv/installed
dev: .venv/installed-dev

.venv/python:
	@if [ -z "$(PYTHON)" ] || ! $(PYTHON) -c '$(SUITABLE)' >/dev/null 2>&1; then \
		echo "gnomon needs Python 3.11 or later with the modules venv and ensurepip; found $(or $(PYTHON),none of: $(CANDIDATES))." >&2; \
		echo "Install one (Debian and Ubuntu: apt install python3-venv), or name it: make PYTHON=/path/to/python3 ..." >&2; \
		exit 1; \
	fi
	$(PYTHON) -m venv --clear .venv
	$(PIP) --upgrade "pip>=25.1"
	@touch $@

.venv/installed: pyproject.toml | .venv/python
	$(PIP) --editable .
	@touch $@

.venv/installed-dev: pyproject.toml | .venv/python
	$(PIP) --editable . --group dev
	@touch .venv/installed $@

clean:
	rm -rf .venv build dist .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests benchmarks -name __pycache__ -type d -exec rm -rf {} +
