# `make demo`, `make test` and `make docs` each work alone: they create .venv and install what they need, once.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
# Test processes: one a core and one for every 4 GB of available memory, whichever are fewer.
WORKERS ?= $(shell $(PYTHON) .ci/workers.py)
# Annotated shapes are checked in tests; not in commands, whose defaults stand in for arguments yet to be given.
CHECKED := geometry camera targets tracks triangulation epipolar calibration landmarks validation metrics runs evidence body pointing detection io report
TYPED := $(shell echo $(CHECKED:%=jaxpoint.%) beartype.beartype | tr ' ' ',')

.PHONY: demo test lint docs bench-quick

demo: $(VENV)/.core
	$(BIN)/jaxpoint demo --out demo-run --force --open

test: $(VENV)/.dev
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --max-worker-restart 0 --dist loadfile --jaxtyping-packages="$(TYPED)"

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# Pages in site/, which open from the disk: site/index.html. The variable silences an advertisement of the theme.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

# Beside Ceres (libceres-dev, cmake and a C++ compiler); fails where a ratio got worse than the committed baseline's.
bench-quick: $(VENV)/.dev
	$(BIN)/python experiments/benchmarks/bundle_adjustment.py --quick

$(VENV)/.core: pyproject.toml | $(VENV)/pyvenv.cfg
	$(PIP) install --editable .
	touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/pyvenv.cfg
	$(PIP) install --editable '.[dev]'
	touch $@

$(VENV)/.docs: pyproject.toml | $(VENV)/pyvenv.cfg
	$(PIP) install --editable '.[docs]'
	touch $@

$(VENV)/pyvenv.cfg:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "jaxpoint needs Python 3.11 or later; name one: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 3; }
	$(PYTHON) -m venv $(VENV)
