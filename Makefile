# make demo   trains a policy on LatticeWorm-v0 and films it; run again it continues.
#             FRESH=1 starts over, VIDEO=0 does not film.
# make test   every check: ruff, mypy, import-linter and all tests, in about 6 minutes on two cores.
# make check  the fast part of them, within a minute: all but the tests marked slow.
# make clients  a short real run of every library in docs/clients.md, in an environment of its own, .venv-clients; writes that page.
# All start from a bare CPython 3.11 or newer with pip, and reuse .venv when it is up to date. CONSTRAINTS=.ci/lowest.txt takes the oldest
# releases that the bounds in pyproject.toml admit, and make suite runs all tests without the checks of style and types.
PYTHON ?= python3
JOBS ?= 2
FRESH ?= 0
VIDEO ?= 1
CONSTRAINTS ?= .ci/constraints.txt
BIN := .venv/bin
STAMP := .venv/.installed
CLIENTS := .venv-clients/bin/python

.PHONY: demo test suite check lint clients clean

demo: $(STAMP)
	$(BIN)/python -m agents.demo $(if $(filter-out 0,$(FRESH)),--fresh) $(if $(filter 0,$(VIDEO)),--no-video)

# A file of tests is run by one process, so that no two compile the same scene at once; tests/conftest.py orders them.
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

test: lint
	$(PYTEST)

suite: $(STAMP)
	$(PYTEST)

check: lint
	$(PYTEST) -m "not slow"

lint: $(STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

# Files of clients have a name of their own, so that no other run collects them; their libraries warn of much.
clients: .venv-clients/.installed
	$(CLIENTS) -m pytest -p tests.clients.page tests/clients --confcutdir=tests/clients -o python_files='client_*.py' -o filterwarnings=default

clean:
	rm -rf .venv .venv-clients

.venv-clients/.installed: pyproject.toml .ci/clients.txt
	$(PYTHON) -m venv .venv-clients
	$(CLIENTS) -m pip install -r .ci/clients.txt
	$(CLIENTS) -m pip install --no-deps -e .  # tianshou holds filelock below what this package asks for
	touch $@

$(STAMP): pyproject.toml $(CONSTRAINTS)
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("lattice_gym needs Python 3.11 or newer, this is " + sys.version.split()[0] + ": make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -c $(CONSTRAINTS) -e '.[train,video,dev]'
	touch $@
