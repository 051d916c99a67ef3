# Everything needed without ROS: `make demo` and `make test` set up .venv by themselves.

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DOCS := $(VENV)/.docs
# Files in the order of test/conftest.py: that by number of tests leaves the few long tests of the browser to the end.
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

# The first interpreter that is new enough and can make virtual environments. That of the distribution comes first:
# it is built with optimisation, and on Ubuntu it is that of ROS.
PYTHON ?= $(firstword $(shell for python in /usr/bin/python3 python3.12 python3.11 python3 python3.13 python3.14; do \
	$$python -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$python; done; true))

# A sourced ROS would put its own packages and pytest plugins before those of .venv.
unexport PYTHONPATH
# Without its cache pytest rewrites the assertions of every file again, in each worker.
unexport PYTHONDONTWRITEBYTECODE
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help venv demo test quick thorough gate audit lint types format docs transcripts clean

help:
	@echo 'make demo    calibrate on the bag that comes with the package'
	@echo 'make test    run the tests'
	@echo 'make quick   run the tests that are not marked slow'
	@echo 'make thorough  run the long ones: whole diagnoses whose parts `make test` tests'
	@echo 'make gate    hold accuracy and consistency against the figures that are kept'
	@echo 'make lint    ruff: rules and formatting'
	@echo 'make types   mypy'
	@echo 'make format  let ruff format the code'
	@echo 'make docs    build the documentation as a web site, build/site/index.html'
	@echo 'make transcripts  run the commands of the documentation and compare what they print; takes minutes'
	@echo 'make audit   compare the installed versions with the published vulnerabilities'
	@echo 'make venv    set up .venv alone; its bin/gyrocal is the command'
	@echo 'make clean   remove .venv and the caches'

# The kernels are compiled where there is a compiler; modules of Python when they are first imported.
$(READY): setup.py pyproject.toml $(wildcard gyrocal_ros/kernels/*.p[xy][dx])
	@test -n '$(PYTHON)' || { echo 'Python 3.11 or newer with venv is needed (Debian, Ubuntu: apt install python3-venv)' >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[dev]'
	@touch $@

venv: $(READY)

demo: $(READY)
	$(BIN)/gyrocal demo

test: $(READY)
	$(PYTEST) -m 'not thorough'

quick: $(READY)
	$(PYTEST) -m 'not slow'

thorough: $(READY)
	$(PYTEST) -m thorough

audit: $(READY)
	$(BIN)/python -m pip install --quiet pip-audit
	$(BIN)/pip-audit --strict --skip-editable --progress-spinner off

gate: $(READY)
	$(BIN)/gyrocal bench --quick

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

types: $(READY)
	$(BIN)/mypy gyrocal_ros test

$(DOCS): $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@

docs: $(DOCS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo 'build/site/index.html'

transcripts: $(READY)
	$(BIN)/python test/transcripts.py

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache *.egg-info build
