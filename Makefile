# Needs Python 3.11, 3.12 or 3.13, make and git. Everything runs in .venv, which the first target that
# needs it makes, with the exact versions of constraints.txt. Another Python: make PYTHON=python3.12

PYTHON ?= python3
CONFIG ?= configs/go1.py:laptop
WORKDIR ?= runs/laptop

VENV := .venv
BIN := $(VENV)/bin
# bytecode is written when a module is first imported: of all of them it takes half of the time
INSTALL := $(BIN)/python -m pip install -q --disable-pip-version-check --no-compile -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help train test check format notebooks clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

train: $(VENV)/.train  ## train a Go1 on two CPU cores, three to seven minutes with the set-up; ends with a film
	$(BIN)/python -m dynappo.train --config=$(CONFIG) --workdir=$(WORKDIR)

# A file stays in one of the two processes: its tests share compiled programs. conftest.py, not xdist, says
# which comes first. Bytecode is written whatever the environment says: some sixty processes import JAX
test: $(VENV)/.dev  ## run the tests, seven to fifteen minutes on two idle cores (the slow ones: .venv/bin/pytest -m slow; 2000 bad inputs: -m fuzz)
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

check: $(VENV)/.dev  ## lint, format, types and spelling: what must be clean before a commit
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright
	$(BIN)/codespell

format: $(VENV)/.dev  ## put the code into the project's format, and write dynappo/config/halves.py
	$(BIN)/python tests/write_halves.py
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

notebooks: $(VENV)/.dev  ## run notebooks 01 to 04 and write their outputs into them
	$(BIN)/python notebooks/execute.py

clean:  ## remove .venv, caches and builds (runs/ stays)
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache *.egg-info
	find dynappo configs experiments tests -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo \
	  "make: $(PYTHON) is older than Python 3.11; name a newer one: make PYTHON=python3.12" >&2; exit 1; }
	@echo "making $(VENV)"
	@$(PYTHON) -m venv $(VENV)

# Two stamps: training needs a third of what development needs
$(VENV)/.train: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing dynappo into $(VENV) (under a minute, once)"
	@$(INSTALL) -e '.[video]'
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing dynappo and its development tools into $(VENV) (a minute or two, once)"
	@$(INSTALL) -e '.[dev,video,web]'
	@touch $@ $(VENV)/.train
