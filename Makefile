# Two commands set everything up on a fresh machine: make demo, make test.
PYTHON ?= python3
SEED ?= 1
# For make evaluate: DEMs, cases of each scenario at contour level and with pictures, processes.
DEMS ?= sim/terrain/santa_cruz_srtm_1s.tif
CASES ?= 1000
PICTURE_CASES ?= 200
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# For make answers: the cases, by kind or name, as ONLY="twins drive/hills*"; all unless given.
ONLY ?=

.PHONY: demo test test-all test-nightly test-system test-wheel examples notebook answers freeze-answers evaluate mutate docs reference figures lint format clean

demo: $(READY)
	$(BIN)/sim demo --seed $(SEED) --out demo

# Each worker runs one half of the files, so that tests of a file share its slow fixtures; who is done first takes over a part
# of the rest. In an order of its own each time, printed as a seed; in CI always the same.
ORDER ?= $(if $(CI),1,default)
PYTEST = PYTHONDONTWRITEBYTECODE= $(BIN)/pytest --randomly-seed=$(ORDER)

test: $(READY)
	$(PYTEST) -n 2 --dist worksteal

test-all: $(READY)
	$(PYTEST) -n 2 --dist worksteal -m "not system"

# As test-all, with twenty times as many examples for each property. Hours.
test-nightly: $(READY)
	$(PYTEST) -n 2 --dist worksteal -m "not system" --hypothesis-profile nightly --timeout 7200

# Tests against gpsd, a browser and systemd, installed if missing. Mostly waiting. In their order: a machine is installed,
# used and cleared away again.
test-system: $(READY)
	tests/system/packages
	$(BIN)/pytest -n 3 --dist loadfile -p no:randomly -m "system and not long"

# The code in the documentation: docstrings, the guide, its notebook; and a typed program that uses the wheel.
examples: $(READY)
	$(BIN)/pytest -n 2 --dist loadfile -m "not system" tests/examples

# The notebook anew, from the guide.
notebook: $(READY)
	$(BIN)/python docs/generate/notebook.py
# The wheel: built, installed into an environment of its own, and used from another folder. Compiles the kernels anew.
test-wheel: $(READY)
	$(BIN)/pytest tests/packaging -m long

# Puts small faults into modules and sees whether their tests notice; without MODULES into those that changed since their score.
mutate: $(READY)
	PYTHONPATH=tests/mutation $(BIN)/python -m mutate --jobs $(JOBS) $(MODULES)

# What the search answers now to some 300 cases, against the frozen answers; and these anew.
ANSWERS = set -f; PYTHONPATH=tests/answers $(BIN)/python -m frozen_answers --jobs $(JOBS)

answers: $(READY)
	@$(ANSWERS) $(ONLY)

freeze-answers: $(READY)
	@$(ANSWERS) $(ONLY) --freeze

EVALUATE = $(BIN)/sim evaluate $(addprefix --dem ,$(DEMS)) --seed $(SEED) --jobs $(JOBS)
SCENARIOS = $(sort $(basename $(notdir $(wildcard configs/scenarios/evaluate/*.toml))))
PICTURE_SCENARIOS = realistic dem_error outside
BOUND_SCENARIOS = paper realistic

evaluate: $(READY) $(SCENARIOS:%=evaluate-contour-%) $(BOUND_SCENARIOS:%=evaluate-bound-%) $(PICTURE_SCENARIOS:%=evaluate-image-%)

evaluate-contour-%: $(READY)
	$(EVALUATE) --scenario configs/scenarios/evaluate/$*.toml --cases $(CASES) --out evaluation/contour/$*

evaluate-bound-%: $(READY)
	$(EVALUATE) --scenario configs/scenarios/evaluate/$*.toml --cases $(CASES) --estimator-only --out evaluation/bound/$*

evaluate-image-%: $(READY)
	$(EVALUATE) --scenario configs/scenarios/evaluate/$*.toml --cases $(PICTURE_CASES) --level image --out evaluation/image/$*

# The site, in build/docs. Warnings are errors, links that lead nowhere among them, and nothing may be loaded from elsewhere.
docs: $(READY)
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs build/docs
	PYTHONPATH=docs $(BIN)/python -m generate.links build/docs

# What is committed of the documentation but comes from the code: pages and JSON Schema files, figures.
reference: $(READY)
	PYTHONPATH=docs $(BIN)/python -m generate.reference

figures: $(READY)
	PYTHONPATH=docs $(BIN)/python -m generate.figures

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "skyfix needs Python 3.11 or newer; name one with make PYTHON=python3.11" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) build demo .pytest_cache .mypy_cache .ruff_cache
