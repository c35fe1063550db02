# `make reproduce` and `make test` are all a fresh machine needs; both build .venv from the lock first.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BUDGET ?= smoke
VENV := .venv
RUN := $(VENV)/bin/python
TWO := -n 2 --dist loadfile  # tests in two processes, a file in one of them

SWEEP ?=
SITE ?=

.PHONY: reproduce test test-fast test-system test-slow lint sweep site contents pictures frontend lock clean

reproduce: $(VENV)/.installed  ## execute the notebooks headlessly (BUDGET=smoke, laptop or full)
	$(RUN) -m qdil notebooks --budget $(BUDGET)

test: $(VENV)/.installed lint  ## lint, types and tests (a browser, kills and sweeps: test-system)
	$(RUN) -m pytest $(TWO)

test-fast: $(VENV)/.installed  ## the tests that need neither Brax nor another process, nor compile much: under a minute
	$(RUN) -m pytest $(TWO) -m "not slow and not system and not physics and not compiles"

test-system: $(VENV)/.installed  ## browsers, several hosts, sweeps, kills, the README's commands: a quarter of an hour
	$(RUN) -m pytest -m "system and not slow"

test-slow: $(VENV)/.installed  ## whole runs on all robots, a dozen kills, the bench: many minutes
	$(RUN) -m pytest -m slow

lint: $(VENV)/.installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

$(VENV)/.installed: environment.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --require-hashes --no-deps -r environment.lock
	$(RUN) -m pip install --quiet --no-deps --no-build-isolation --config-settings editable_mode=compat --editable .
	touch $@

sweep: $(VENV)/.installed  ## train what is missing (SWEEP="envs=walker2d studies=main seeds=1,2,3", or methods=true,gail)
	$(RUN) -m snakemake --snakefile workflow/Snakefile --cores all --nolock --rerun-incomplete --rerun-triggers mtime \
		--retries 1 --config budget=$(BUDGET) $(SWEEP)

site: $(VENV)/.installed  ## the executed notebooks as web pages in build/site (SITE=smoke, laptop or full: that budget's)
	$(RUN) -m qdil.series.site $(if $(SITE),--budget $(SITE))

contents: $(VENV)/.installed  ## write the generated tables into the README and docs
	$(RUN) -m qdil.series.readme

pictures: $(VENV)/.installed  ## draw the pictures of the README and docs/performance.md into docs/pictures
	$(RUN) -m qdil.series.pictures

frontend:  ## bundle the explorer's script and three.js into qdil/explorer/static (needs Node.js 20 or later, and npm)
	cd qdil/explorer/frontend && npm ci --no-audit --no-fund && npm run build

lock:  ## resolve the pinned, hashed environment anew (needs uv)
	uv pip compile pyproject.toml --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
		--no-header --extra all --quiet --output-file environment.lock

clean:
	rm -rf $(VENV) build .pytest_cache .mypy_cache .ruff_cache
