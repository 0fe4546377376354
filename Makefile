# Each target sets up what it needs in .venv by itself; nothing has to be activated.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/ready
PORTIONS := . $(patsubst %/pyproject.toml,%,$(wildcard plugins/*/pyproject.toml examples/*/pyproject.toml))
# More than one thread of tests, each with one thread of its own.
TEST_ARGS ?= -n 2 --dist loadscope
DEMO_ARGS ?= algo=splatam dataset=synthetic/room0 preset=fast
export OMP_WAIT_POLICY ?= passive
export NUMBA_THREADING_LAYER ?= omp

.PHONY: help demo test bench lint clean
help:
	@echo "make demo    SplaTAM on a synthetic room: trajectory, map and figures in outputs/demo"
	@echo "make test    every test of the core, the plugins and the example"
	@echo "make bench   measured workloads against the committed baseline"
	@echo "make lint    ruff and mypy"

demo: $(READY)
	$(RUN) -m xrdslam $(DEMO_ARGS) run_dir=outputs/demo

test: $(READY)
	$(RUN) -m pytest $(TEST_ARGS)

bench: $(READY)
	$(RUN) -m benchmarks

lint: $(READY)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache

$(READY): setup.py constraints.txt $(addsuffix /pyproject.toml,$(PORTIONS))
	@$(PYTHON) -c 'import sys; sys.exit("xrdslam needs Python 3.11 or newer: make PYTHON=python3.11") if sys.version_info < (3, 11) else None'
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt \
		--editable ".[dev]" $(foreach portion,$(filter-out .,$(PORTIONS)),--editable ./$(portion))
	touch $@
