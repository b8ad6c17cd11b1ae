# Needs only Python 3.11 or later with venv, and make. Everything is built into .venv.

# The interpreter: make PYTHON=python3.12 demo picks one.
CANDIDATES = python3.14 python3.13 python3.12 python3.11 python3 python
SUITABLE = import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(shell for p in $(CANDIDATES); do if $$p -c '$(SUITABLE)' >/dev/null 2>&1; then echo $$p; break; fi; done)

BIN = .venv/bin
LOWEST = .venv-lowest
# What is imported is compiled then; all that is installed would take longer than the installation.
INSTALL = -m pip install --quiet --disable-pip-version-check --no-compile

# The libraries below NumPy need no threads of their own here: the problems are small.
export OPENBLAS_NUM_THREADS = 1
# Many tests start the program anew: compiling its source each time would cost more than what it does.
unexport PYTHONDONTWRITEBYTECODE

# A process for each core; the tests of one file stay together, since they share what they prepare.
TESTS = -m pytest -n auto --dist loadfile --no-loadscope-reorder

.PHONY: help demo test test-all durations test-lowest check lint types examples study bench speed fuzz docs notebooks install dev clean

help:
	@echo "make demo         calibrate a simulated recording with known truth, from nothing"
	@echo "make test         run the quick tests, from nothing: the main jobs, and what is cheap of every part"
	@echo "make test-all     run all tests and checks"
	@echo "make test-lowest  the same with the lowest version of each dependency, in $(LOWEST)"
	@echo "make check        lint, format, types, import contract, examples in docstrings"
	@echo "make study        run the tests that take minutes"
	@echo "make bench        time what has a limit, beside the limits and other programs"
	@echo "make speed        the same against an older version; an error where a ratio fell by a fifth"
	@echo "make fuzz         try 100 000 damaged files on every reader; takes hours, and goes on where it left off"
	@echo "make docs         build the documentation as a site, in site/"
	@echo "make notebooks    run the notebooks of the documentation anew"
	@echo "make clean        remove the environments and what the tools left behind"

demo: install
	@$(BIN)/gnomon demo

test: dev
	$(BIN)/python $(TESTS) --quick

# Both tiers at once: each process collects the tests and imports what they need once. The checks run beside them, in the
# time that tests wait for the disk and for each other.
test-all: dev
	@$(MAKE) --output-sync check & checks=$$!; $(BIN)/python $(TESTS); tests=$$?; wait $$checks && exit $$tests

# Which tests are quick: by CPU time, as tests/tiers.py says. After large changes, on a machine that does nothing else.
durations: dev
	$(BIN)/python $(TESTS) --record-durations

test-lowest: $(LOWEST)/installed
	$(LOWEST)/bin/python $(TESTS)

check: lint types examples

lint: dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports

types: dev
	$(BIN)/pyright --pythonpath $(BIN)/python

examples: dev
	$(BIN)/python -m pytest --doctest-modules src

study: dev
	$(BIN)/python -m pytest -m slow

bench: dev
	$(BIN)/python $(INSTALL) --group bench
	$(BIN)/python benchmarks/limits.py

# Ends with an error where a ratio fell by a fifth since the table in benchmarks/results-against.md was kept.
speed: dev
	$(BIN)/python $(INSTALL) --group bench
	$(BIN)/python benchmarks/against.py 70de556 --runs 3 --check

fuzz: dev
	$(BIN)/python $(INSTALL) --group fuzz
	$(BIN)/python tests/hostile/fuzz.py

# MkDocs warns of its own next version, which this does not use.
docs: dev
	$(BIN)/python $(INSTALL) --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "site/index.html; with search: $(BIN)/python -m http.server -d site"

# Runs them anew, with their pictures; a cell that fails ends it.
notebooks: dev
	$(BIN)/python $(INSTALL) --group notebooks
	$(BIN)/python docs/make_notebooks.py

# Empty files in .venv say what is installed there, so that it is done once.
install: .venv/installed
dev: .venv/installed-dev

define NEW_ENVIRONMENT
	@if [ -z "$(PYTHON)" ] || ! $(PYTHON) -c '$(SUITABLE)' >/dev/null 2>&1; then \
		echo "gnomon needs Python 3.11 or later with the modules venv and ensurepip; found $(or $(PYTHON),none of: $(CANDIDATES))." >&2; \
		echo "Install one (Debian and Ubuntu: apt install python3-venv), or name it: make PYTHON=/path/to/python3 ..." >&2; \
		exit 1; \
	fi
	$(PYTHON) -m venv --clear $(@D)
	$(@D)/bin/python $(INSTALL) --upgrade "pip>=25.1"
	@touch $@
endef

.venv/python $(LOWEST)/python:
	$(NEW_ENVIRONMENT)

.venv/installed: pyproject.toml | .venv/python
	$(BIN)/python $(INSTALL) --editable .
	@touch $@

.venv/installed-dev: pyproject.toml | .venv/python
	$(BIN)/python $(INSTALL) --editable . --group dev
	@touch .venv/installed $@

$(LOWEST)/installed: pyproject.toml .ci/lowest.py | $(LOWEST)/python
	$(LOWEST)/bin/python .ci/lowest.py >$(LOWEST)/constraints.txt
	$(LOWEST)/bin/python $(INSTALL) --constraint $(LOWEST)/constraints.txt --editable . --group dev
	@touch $@

clean:
	rm -rf .venv $(LOWEST) build dist site .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests benchmarks -name __pycache__ -type d -exec rm -rf {} +
