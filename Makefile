# `make run` sets up all it needs, and so do the others: git, make and python3 (3.11 or newer, with venv) suffice.
PYTHON ?= python3
BIN := .venv/bin
SETUP = @PYTHON="$(PYTHON)" sh scripts/setup.sh
# An inherited virtual environment or uv setting must not decide what is built here.
UV := env -u VIRTUAL_ENV -u UV_PYTHON -u UV_PROJECT_ENVIRONMENT -u UV_PROJECT -u PYTHONPATH \
	UV_PYTHON_DOWNLOADS=never .tools/bin/uv
# Kept bytecode spares every process that a test starts a second or more of compiling.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help run tank survey setup setup-tank setup-survey setup-dev setup-ray setup-train setup-checkers setup-perf \
	test test-slow test-bounds test-ray test-train test-checkers check results perf wheel release-check clean
.NOTPARALLEL:
.DEFAULT_GOAL := help

##@ To use it: each sets up what it needs

help: ## List the targets
	@awk -F ':.*## ' '/^##@ /{print (n++ ? "\n" : "") substr($$0, 5)} /^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' \
		$(MAKEFILE_LIST)

run: setup ## Explore an oyster reef and write its report
	@$(BIN)/dream run --world reef/string

tank: setup-tank ## Dive in a simulated tank, through programs that stand in for a BlueROV2
	@$(BIN)/dream dive --stand-in --world pool/arc --out runs

survey: setup-survey ## Survey a reef, come back a year on, say what changed, and write it for others
	@at=runs/survey-$$(date +%Y-%m-%dT%H-%M-%S); set -e; \
	dream() { echo "\$$ $(BIN)/dream $$*"; $(BIN)/dream "$$@"; }; \
	export DREAM_ARCHIVE=$$at/surveys.gpkg; echo "\$$ export DREAM_ARCHIVE=$$DREAM_ARCHIVE"; \
	dream run --world reef/string --protocol dream-v1 --site examples/site.json --out $$at/before; \
	dream survey add $$at/before/latest; \
	echo; echo "The same reef one simulated year on."; \
	dream run --world reef/string+1y1 --protocol dream-v1 --start 1 --site examples/site.json --from-survey 1 --out $$at/after; \
	dream survey add $$at/after/latest; \
	dream survey compare 1 2 --out $$at/change; \
	dream survey export 2 --run $$at/after/latest --to $$at/products

setup: ## Build .venv with .venv/bin/dream in it; EXTRAS="vlm live" adds extras to what is there
	$(SETUP) $(EXTRAS)

clean: ## Remove what setup built
	@rm -rf .venv .tools .setup

# What a target needs beside that; what is there is neither taken away nor looked at again.
setup-tank:
	$(SETUP) rov
setup-survey:
	$(SETUP) survey
setup-dev:
	$(SETUP) dev
setup-ray setup-train setup-checkers setup-perf: setup-%:
	$(SETUP) dev $*

##@ To develop it

# Three at a time fill two cores: a BLAS with threads of its own would only wait on them, and beside a fourth the
# tests of what must happen within half a second can fail.
test: export OPENBLAS_NUM_THREADS := 1
test: setup-dev ## Run the tests, and list what was skipped
	@$(BIN)/pytest -n 3 --dist loadscope --no-loadscope-reorder -rfEs

test-slow: export OPENBLAS_NUM_THREADS := 1
test-slow: setup-dev ## Run what `make test` leaves out: all faults, every processor, new examples, checked indices
	@$(BIN)/pytest -n 3 --dist loadscope -m rare -rfEs
	@$(BIN)/pytest -n 3 -m "hypothesis and not rare" --hypothesis-profile=search -rfE
	@$(MAKE) --no-print-directory test-bounds

# In a new folder: what numba has kept knows neither of this setting nor of changes in other files.
test-bounds: export OPENBLAS_NUM_THREADS := 1
test-bounds: setup-dev ## Run the tests of map, planners and simulator on kernels that check every index
	@kernels=$$(mktemp -d) && trap 'rm -rf "$$kernels"' EXIT && trap 'exit 130' INT && trap 'exit 143' TERM && \
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$$kernels $(BIN)/pytest -n 2 --dist loadscope -rfEs \
		tests/mapping tests/planning tests/sim

test-ray: setup-ray ## Run the tests that need Ray, an optional extra
	@$(BIN)/pytest tests/evaluation/test_engines.py

# Nets as small as those of the tests lose more by threads than they gain.
test-train: export OMP_NUM_THREADS := 1
test-train: setup-train ## Run the tests of training, which need PyTorch, an optional extra
	@$(BIN)/pytest tests/learning

test-checkers: setup-checkers ## Run the tests that read files with others' checkers and readers
	@$(BIN)/pytest tests/live/test_rerun.py tests/survey/test_products_files.py::test_a_cf_checker_finds_no_fault

check: setup-dev ## Lint, types and format
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

results: setup ## Write docs/results/README.md from the released results
	@$(BIN)/dream results results/test-v2 results/test results/paper results/sweep --out docs/results/README.md --figures docs/results

perf: setup-perf ## Measure speed and accuracy beside named peers; some forty minutes
	@$(BIN)/python perf/render.py
	@$(BIN)/python perf/gain.py
	@$(BIN)/python perf/vehicle.py
	@$(BIN)/python perf/estimation.py
	@$(BIN)/python perf/map.py --kilometre
	@$(BIN)/python perf/map.py --memory
	@$(BIN)/python perf/map.py
	@$(BIN)/python perf/navigation.py

wheel: setup ## Build dist/dream_auv-*.whl, which needs no clone
	@rm -rf dist
	@$(UV) build --quiet
	@ls dist/*.whl

release-check: wheel ## Install the wheel outside the clone and fly with it; PYTHONS="3.11 3.13" says on which
	@.tools/bin/python scripts/release_check.py dist/*.whl --pythons $(PYTHONS)
