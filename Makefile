# make setup | demo | test | drill | prove | check | bench        ARGS="..." is passed through
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV_VERSION := 0.13.8
EXTRAS ?= all
ARGS ?=

.PHONY: setup demo test test-fast drill prove docs-check check format bench constraints clean

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml constraints.txt
	@PYTHON="$(PYTHON)" UV_VERSION="$(UV_VERSION)" EXTRAS="$(EXTRAS)" bash compose/setup.sh

demo: setup
	@$(BIN)/spotter demo $(ARGS)

# Everything: what computes on all cores at once, then what runs a few real processes, then what runs whole systems.
# Workers for two cores: three where tests compute, four where most of them wait, two where each starts a whole system.
# ARGS="-k word" or a path runs those tests by themselves.
# $(call pytest,MARKS,OPTIONS): up to three tests that failed beside others that want the same two cores run once more,
# by themselves, and have to pass there; the first failure stays in the output.
define pytest
@$(BIN)/pytest $(2) -m "$(1)" || { [ $$? -eq 1 ] && echo "  test: failed in company; once more, by themselves" && \
	[ "$$($(BIN)/pytest -q --collect-only --last-failed --last-failed-no-failures none -m "$(1)" | grep -c ::)" -le 3 ] && \
	$(BIN)/pytest --last-failed --last-failed-no-failures none -m "$(1)"; }
endef

# The tests' own modules are compiled once, and not by each worker of each part, whatever the shell says.
test test-fast: export PYTHONDONTWRITEBYTECODE :=
# One thread for each process, as services have: those of numpy in three workers only wait for each other.
test test-fast: export OMP_NUM_THREADS := 1
test test-fast: export OPENBLAS_NUM_THREADS := 1

test: setup
ifeq ($(strip $(ARGS)),)
	$(call pytest,not system and not netns,-q --numprocesses 3 --dist loadfile --no-loadscope-reorder)
	$(call pytest,system and not netns and not whole,-q --live-files --numprocesses 4 --dist loadfile)
	$(call pytest,netns or whole,-q --live-files --numprocesses 2 --dist loadfile)
else
	@$(BIN)/pytest $(ARGS)
endif

test-fast: setup
	@$(BIN)/pytest -q --numprocesses 3 --dist loadfile --no-loadscope-reorder -m "not slow and not system and not netns" $(ARGS)

# Breaks the demo in every way that the plan lists, against deadlines; wants a machine that is not busy. While it drives:
# ARGS="--file spotter_tools/drill/drive.toml", or emergency.toml.
drill: setup
	@$(BIN)/spotter drill $(ARGS)

# Test drives in simulated time: the fixed part of the proving ground; ARGS="--out proof" for all with pictures,
# ARGS=--kept for those that pass and have to go on passing.
prove: setup
	@$(BIN)/spotter prove $(or $(ARGS),--subset)

# Every command of the documents from a fresh clone, what each command says when something is missing, and the page of it.
docs-check: setup
	@$(BIN)/python docs/check.py $(ARGS)
	@$(BIN)/python docs/situations.py --check
	@$(BIN)/python docs/troubleshooting.py --check

check: setup
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy

format: setup
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

bench: setup
	@$(BIN)/python -m benchmarks $(ARGS)

# Exact versions and hashes for every extra, for x86-64 and aarch64 alike.
constraints:
	@$(BIN)/uv pip compile --universal --generate-hashes --all-extras --no-header --no-annotate \
		--python-version 3.11 pyproject.toml -o constraints.txt --quiet

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis
