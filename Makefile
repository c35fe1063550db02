# `make reproduce` and `make test` are all a fresh machine needs; both build .venv from the lock first.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BUDGET ?= smoke
VENV := .venv
RUN := $(VENV)/bin/python

.PHONY: reproduce test lint lock clean

reproduce: $(VENV)/.installed  ## execute the notebooks headlessly (BUDGET=smoke, laptop or full)
	$(RUN) -m qdil notebooks --budget $(BUDGET)

test: $(VENV)/.installed lint  ## lint, type check and every test
	$(RUN) -m pytest

lint: $(VENV)/.installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

$(VENV)/.installed: environment.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --require-hashes --no-deps -r environment.lock
	$(RUN) -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

lock:  ## resolve the pinned, hashed environment anew (needs uv)
	uv pip compile pyproject.toml --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
		--no-header --extra dev --quiet --output-file environment.lock

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache
