# Two commands for a newcomer: `make demo` drives the mission in the loopback, `make test` passes the tests.
# Needs python3 >= 3.11 with venv, pip and make; everything else is installed from the lock into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo
NAME ?= main-job

.PHONY: demo test long matrix check evidence lock clean

demo: $(VENV)/installed
	$(BIN)/aritra demo --out $(OUT)

test: $(VENV)/installed
	scripts/test

long: $(VENV)/installed
	scripts/test long

matrix: $(VENV)/installed
	scripts/test -m matrix

check: $(VENV)/installed
	scripts/check

evidence: $(VENV)/installed
	$(BIN)/python scripts/evidence $(NAME)

$(VENV)/installed: requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "aritra needs Python 3.11 or newer: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

lock:
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --all-extras --python-version 3.11 \
		--no-header --no-emit-index-url pyproject.toml -o requirements.lock

clean:
	rm -rf $(VENV) out .pytest_cache .ruff_cache .hypothesis
