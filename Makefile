# rfpipe: `make` lists the targets. Needs Python >= 3.11 and make; all packages are installed into .venv.

PYTHON ?= python3
VENV := .venv
INSTALLED := $(VENV)/.installed
PIP := $(VENV)/bin/python -m pip
# the settings of a rig, for aim, calibrate and serve
RIG ?= config/bench.yaml
# the settings of the thesis' figures, in config/ and figures/; at full size figures_full
FIGURES ?= figures
LOCK_OPTIONS := --upgrade --universal --python-version 3.11 --generate-hashes --no-header \
  --no-annotate --quiet
# one worker more than cores, since tests often wait; bytecode saves each of them 8 s of imports
PYTEST := env -u PYTHONDONTWRITEBYTECODE pytest -n 3 --dist worksteal
# more options for snakemake, as in: make run ARGS="--dry-run"
ARGS ?=

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
export PATH := $(CURDIR)/$(VENV)/bin:$(PATH)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
# `make unlock run` unlocks first, also under -j
.NOTPARALLEL:
.PHONY: help install run thesis figures aim calibrate serve unlock test test-all validators dist \
  release lint format docs bench benchmark measured config lock clean

help: ## list the targets
	@echo "rfpipe: acquire, store and relight the light transport between a projector and a camera"
	@echo
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo
	@echo "Start with 'make run'. Settings: config/README.md."

install: $(INSTALLED) ## install the pinned packages and rfpipe into .venv

$(INSTALLED): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "make: $(PYTHON) must be Python >= 3.11 with the venv module (on Debian: python3-venv);" \
	    "name another one with 'make PYTHON=python3.12 ...'" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet --require-hashes --requirement requirements.lock
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@# otherwise each of a run's hundreds of jobs compiles the sources if bytecode isn't written
	$(VENV)/bin/python -m compileall -q src
	@touch $@

run: $(INSTALLED) ## run the default workflow (config/config.yaml) and print the report's path
	@rfpipe run $(ARGS) || { status=$$?; \
	  echo "make: the run ended early. Where a signal or a kill ended it, 'make run' with the same" \
	    "ARGS goes on there." >&2; exit $$status; }

thesis: $(INSTALLED) ## run the thesis' full size (config/thesis.yaml) in the folder thesis/
	@rfpipe run --directory thesis --configfile config/thesis.yaml $(ARGS)
	@snakemake --snakefile figures/Snakefile --directory thesis --configfile figures/thesis.yaml $(ARGS)

figures: $(INSTALLED) ## make every figure and table of the thesis, reduced, in the folder figures/
	@python -m figures check
	@rfpipe run --directory figures --configfile config/$(FIGURES).yaml $(ARGS)
	@snakemake --snakefile figures/Snakefile --directory figures \
	  --configfile figures/$(FIGURES).yaml $(ARGS)

aim: $(INSTALLED) ## show a rig's camera live in a browser, until Ctrl-C: make aim RIG=config/rig.yaml
	@rfpipe aim $(RIG)

calibrate: $(INSTALLED) ## calibrate a rig: make calibrate RIG=config/rig.yaml (docs/rig.md)
	@rfpipe calibrate $(RIG)

serve: $(INSTALLED) ## run a rig's acquisition server until Ctrl-C: make serve RIG=config/rig.yaml
	@rfpipe serve $(RIG)

unlock: $(INSTALLED) ## unlock folders that a killed Snakemake has locked
	@snakemake --unlock $(ARGS)
	@if [ -d thesis ]; then \
	  snakemake --directory thesis --configfile config/thesis.yaml --unlock; fi
	@if [ -d figures/results ]; then \
	  snakemake --directory figures --configfile config/$(FIGURES).yaml --unlock; fi

test: $(INSTALLED) ## run the quick tests: at most 5 minutes on 2 cores
	$(PYTEST) -m "not slow and not needs"

test-all: $(INSTALLED) ## run all tests; skipped ones name the missing system packages (tests/machine/needs.py)
	$(PYTEST)

validators: $(INSTALLED) ## install the validators of published runs into .venv-validators
	uv venv --quiet --allow-existing --python $(VENV)/bin/python .venv-validators
	uv pip install --quiet --require-hashes --python .venv-validators/bin/python \
	  --requirement validators.lock

dist: $(INSTALLED) ## build the sdist and the wheel into dist/
	rm -rf dist
	uv build --quiet --no-build-isolation --python $(VENV)/bin/python

release: dist ## build, check and try a release on each Python found here: at most 5 minutes each
	env -u PYTHONDONTWRITEBYTECODE pytest -v tests/release tests/unit/test_deployment.py

lint: $(INSTALLED) ## check style, types, layers and the workflow
	ruff check .
	ruff format --check .
	mypy
	lint-imports
	snakefmt --check Snakefile figures/Snakefile workflow/rules
	snakemake --lint
	hadolint Containerfile

format: $(INSTALLED) ## format the sources and the workflow
	ruff check --fix .
	ruff format .
	snakefmt Snakefile figures/Snakefile workflow/rules

docs: $(INSTALLED) ## build all pages, the gallery and the reference as a site: build/docs/index.html
	@rm -rf build/docs
	python -m sphinx --quiet --fresh-env --fail-on-warning --keep-going --doctree-dir build/doctrees \
	  --conf-dir docs/site . build/docs
	@echo build/docs/index.html

bench: $(INSTALLED) ## run the speed benchmarks; writes results/bench/*.csv (benchmarks/README.md)
	@for script in benchmarks/bench_*.py; do echo "$$script"; \
	  python -m "benchmarks.$$(basename "$$script" .py)"; done

measured: $(INSTALLED) ## rewrite the tables of docs/measured.md and README (a night)
	@python -m figures.opening docs/images/bottle.png
	@rfpipe run
	@rfpipe run --directory thesis --configfile config/thesis.yaml
	@rfpipe run --directory large --configfile config/large.yaml
	@python -m benchmarks.large
	@python -m benchmarks.measured $(ARGS)

benchmark: $(INSTALLED) ## run every method on every scene (hours); continues docs/benchmark/*.csv
	@python -m benchmarks.methods $(ARGS)

config: $(INSTALLED) ## write schemas, rigs and config/all.yaml from the settings' models
	python -m rfpipe.config.schema

lock: $(INSTALLED) ## resolve pyproject.toml into requirements.lock and validators.lock
	uv pip compile pyproject.toml --extra dev $(LOCK_OPTIONS) --output-file requirements.lock
	uv pip compile --group validators $(LOCK_OPTIONS) --output-file validators.lock

clean: ## remove caches and build files; results and .venv stay
	rm -rf .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis build dist
	find src tests workflow benchmarks figures -name __pycache__ -type d -prune -exec rm -rf {} +
