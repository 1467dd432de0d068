# Two commands for a newcomer: `make demo` drives the mission in the loopback, `make test` passes the tests.
# Needs python3 >= 3.11 with venv, pip and make; each installs what it needs into .venv, from its lock file.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo
NAME ?= main-job

.PHONY: demo install test long matrix arm64 check evidence docs lock clean

demo: $(VENV)/demo
	$(BIN)/aritra demo --out $(OUT)

install: $(VENV)/dev

test: $(VENV)/dev
	scripts/test

long: $(VENV)/dev
	scripts/test long

matrix: $(VENV)/dev
	scripts/test -m matrix

# over an hour, as root; Debian: apt-get install debootstrap qemu-user-static binfmt-support
arm64: $(VENV)/dev
	$(BIN)/python scripts/evidence friendly --only arm64 --full

check: $(VENV)/dev
	scripts/check

evidence: $(VENV)/dev
	$(BIN)/python scripts/evidence $(NAME)

docs: $(VENV)/dev
	$(BIN)/python scripts/docs

$(VENV)/%: requirements-%.lock pyproject.toml
	PYTHON=$(PYTHON) scripts/install $*

COMPILE = $(BIN)/uv pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header \
	--no-emit-index-url --group build pyproject.toml

lock: $(VENV)/dev
	$(BIN)/python -m pip install --quiet uv
	$(COMPILE) --all-extras -o requirements-dev.lock
	$(COMPILE) --extra demo -c requirements-dev.lock -o requirements-demo.lock
	$(COMPILE) -c requirements-dev.lock -o requirements.lock

clean:
	rm -rf $(VENV) out .pytest_cache .ruff_cache .hypothesis
