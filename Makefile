# Two commands do everything on a fresh machine: `make demo` and `make test`.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TESTABLE := $(VENV)/.testable

TIANSHOU := .venv-tianshou

.PHONY: demo test test-slow check-all reliability tianshou lint clean

demo: $(INSTALLED) ## set up, and reproduce Figure 1 into a new folder under runs/
	$(BIN)/upslope reproduce fig1

test: $(TESTABLE) lint ## set up, and pass the fast tests
	$(BIN)/pytest -n 2 --dist loadfile

test-slow: $(TESTABLE) ## whole-length training, examples, and further variants of the fast tests
	$(BIN)/pytest -m slow

check-all: $(TESTABLE) lint ## everything: all tests, all examples, Tianshou, Figure 1's quick form, reliability; about 1.5 hours
	$(BIN)/python -m checks

reliability: $(TESTABLE) ## kills, signals, damaged files, full disks; ten minutes
	$(BIN)/python -m reliability

lint: $(TESTABLE)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

tianshou: $(TIANSHOU)/.installed ## the example of a library whose pins need an environment of its own
	$(TIANSHOU)/bin/python examples/tianshou_dqn.py --quick

$(TIANSHOU)/.installed: pyproject.toml tianshou-constraints.txt
	$(PYTHON) -m venv $(TIANSHOU)
	$(TIANSHOU)/bin/pip install --quiet --constraint tianshou-constraints.txt torch tianshou --editable .
	touch $(TIANSHOU)/.installed

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable .
	touch $(INSTALLED)

# The tools, and other libraries' learners and environments; gymnax asks for an older Gymnasium than it needs.
$(TESTABLE): $(INSTALLED)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev,clients,families]'
	$(BIN)/pip install --quiet --constraint constraints.txt --no-deps gymnax
	touch $(TESTABLE)

clean:
	rm -rf $(VENV) $(TIANSHOU) .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
