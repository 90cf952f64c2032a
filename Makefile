# `make run` and `make test` set up all they need: git, make and python3 (3.11 or newer, with venv) suffice.
PYTHON ?= python3
BIN := .venv/bin
# An inherited virtual environment or uv setting must not decide what is built here.
UV := env -u VIRTUAL_ENV -u UV_PYTHON -u UV_PROJECT_ENVIRONMENT -u UV_PROJECT -u PYTHONPATH \
	UV_PYTHON_DOWNLOADS=never .tools/bin/uv
# Kept bytecode spares every process that a test starts a second or more of compiling.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup run tank survey test test-slow test-ray test-train test-checkers check results perf clean
.DEFAULT_GOAL := help

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: .venv/.synced ## Build .venv, with .venv/bin/dream in it

.tools/bin/uv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "dream needs Python 3.11 or newer, got $$($(PYTHON) --version 2>&1). Try: make PYTHON=python3.12 ..." >&2; exit 1; }
	@echo "setting up ..."
	@rm -rf .tools
	@env -u PYTHONPATH $(PYTHON) -m venv .tools
	@.tools/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.8,<1"

.venv/.synced: pyproject.toml uv.lock | .tools/bin/uv
	@$(UV) sync --quiet --locked --python "$$(.tools/bin/python -c 'import sys; print(sys._base_executable)')"
	@touch $@

run: setup ## Explore an oyster reef and write its report
	@$(BIN)/dream run --world reef/string

tank: setup ## Dive in a simulated tank, through programs that stand in for a BlueROV2
	@$(BIN)/dream dive --stand-in --world pool/arc --out runs

survey: setup ## Survey a reef, come back a year on, say what changed, and write it for others
	@at=runs/survey-$$(date +%Y-%m-%dT%H-%M-%S); export DREAM_ARCHIVE=$$at/surveys.gpkg; set -e; \
	$(BIN)/dream run --world reef/string --site examples/site.json --out $$at/before; \
	$(BIN)/dream survey add $$at/before/latest; \
	echo; echo "The same reef one simulated year on; its survey bears the date of today."; \
	$(BIN)/dream run --world reef/string+1y1 --start 1 --site examples/site.json --from-survey 1 --out $$at/after; \
	$(BIN)/dream survey add $$at/after/latest; \
	$(BIN)/dream survey compare 1 2 --out $$at/change; \
	$(BIN)/dream survey export 2 --run $$at/after/latest --to $$at/products

# Three at a time fill two cores: a BLAS with threads of its own would only wait on them, and beside a fourth the
# tests of what must happen within half a second can fail.
test: export OPENBLAS_NUM_THREADS := 1
test: setup ## Run the tests, and list what was skipped
	@$(BIN)/pytest -n 3 --dist loadscope -rfEs

test-slow: export OPENBLAS_NUM_THREADS := 1
test-slow: setup ## Run the tests that `make test` leaves out: all faults, the same bytes on every processor, new examples
	@$(BIN)/pytest -m rare -rfEs
	@$(BIN)/pytest -n 3 -m "hypothesis and not rare" --hypothesis-profile=search -rfE

test-ray: setup ## Run the tests that need Ray, an optional extra
	@$(UV) sync --quiet --locked --inexact --extra ray
	@$(BIN)/pytest tests/evaluation/test_engines.py

test-train: setup ## Run the tests of training, which need PyTorch, an optional extra
	@$(UV) sync --quiet --locked --inexact --extra train
	@$(BIN)/pytest tests/learning

test-checkers: setup ## Run the tests that read files with others' checkers and readers
	@$(UV) sync --quiet --locked --inexact --group checkers
	@$(BIN)/pytest tests/live/test_rerun.py tests/survey/test_products_files.py::test_a_cf_checker_finds_no_fault

check: setup ## Lint, types and format
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

results: setup ## Write docs/results/README.md from the released results
	@$(BIN)/dream results results/test results/paper results/sweep --out docs/results/README.md --figures docs/results

perf: setup ## Measure speed and accuracy beside named peers; some forty minutes
	@$(UV) sync --quiet --locked --inexact --group perf
	@$(BIN)/python perf/render.py
	@$(BIN)/python perf/edges.py
	@$(BIN)/python perf/completion.py
	@$(BIN)/python perf/gain.py
	@$(BIN)/python perf/vehicle.py
	@$(BIN)/python perf/estimation.py
	@$(BIN)/python perf/map.py --kilometre
	@$(BIN)/python perf/map.py --memory
	@$(BIN)/python perf/map.py
	@$(BIN)/python perf/navigation.py

clean: ## Remove what setup built
	@rm -rf .venv .tools
