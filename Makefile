# make setup | demo | test | drill | check | bench        ARGS="..." is passed through
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV_VERSION := 0.13.8
EXTRAS ?= all
ARGS ?=

.PHONY: setup demo test test-fast drill check format bench constraints clean

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml constraints.txt
	@PYTHON="$(PYTHON)" UV_VERSION="$(UV_VERSION)" EXTRAS="$(EXTRAS)" bash compose/setup.sh

demo: setup
	@$(BIN)/spotter demo $(ARGS)

# Everything: what computes on all cores at once (three workers for two: one waits for a minute), then what runs real
# processes one after the other. ARGS="-k word" or a path runs those tests alone.
test: setup
ifeq ($(strip $(ARGS)),)
	@$(BIN)/pytest -q --numprocesses 3 --dist loadfile --no-loadscope-reorder -m "not system and not netns"
	@$(BIN)/pytest -m "system or netns"
else
	@$(BIN)/pytest $(ARGS)
endif

test-fast: setup
	@$(BIN)/pytest -q --numprocesses 3 --dist loadfile --no-loadscope-reorder -m "not slow and not system and not netns" $(ARGS)

# Breaks the demo in every way that common/drill/drills.toml lists, against deadlines; wants a machine that is not busy.
drill: setup
	@$(BIN)/spotter drill $(ARGS)

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
