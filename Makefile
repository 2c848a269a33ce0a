# make demo   trains a policy on LatticeWorm-v0 and films it; run again it continues.
#             FRESH=1 starts over, VIDEO=0 does not film.
# make test   every check: ruff, mypy, import-linter and all tests, in about 4 minutes on two cores.
# make check  the fast part of them, within a minute: all but the tests marked slow.
# All start from a bare CPython 3.11 or newer with pip, and reuse .venv when it is up to date.
PYTHON ?= python3
JOBS ?= 2
FRESH ?= 0
VIDEO ?= 1
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: demo test check lint clean

demo: $(STAMP)
	$(BIN)/python -m agents.demo $(if $(filter-out 0,$(FRESH)),--fresh) $(if $(filter 0,$(VIDEO)),--no-video)

# A file of tests is run by one process, so that no two compile the same scene at once; tests/conftest.py orders them.
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

test: lint
	$(PYTEST)

check: lint
	$(PYTEST) -m "not slow"

lint: $(STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

clean:
	rm -rf .venv

$(STAMP): pyproject.toml .ci/constraints.txt
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("lattice_gym needs Python 3.11 or newer, this is " + sys.version.split()[0] + ": make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -c .ci/constraints.txt -e '.[train,video,dev]'
	touch $@
