# make demo   trains a policy on LatticeWorm-v0 and films it      make test   every check
# Both start from a bare CPython 3.11 or newer with pip, and reuse .venv when it is up to date.
PYTHON ?= python3
JOBS ?= 2
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: demo test clean

demo: $(STAMP)
	$(BIN)/python -m agents.demo

test: $(STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n $(JOBS)

clean:
	rm -rf .venv

$(STAMP): pyproject.toml .ci/constraints.txt
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("lattice_gym needs Python 3.11 or newer, this is " + sys.version.split()[0] + ": make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -c .ci/constraints.txt -e '.[train,video,dev]'
	touch $@
