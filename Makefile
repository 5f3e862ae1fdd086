# Needs python3 (3.10 or newer) and make; everything else goes into .venv.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out/
PYTEST_ARGS ?= -n auto --maxprocesses 8
# Speed first, then accuracy, then what takes an hour and more.
BENCHMARKS ?= speed cold certificate env rod_speed render_speed play_speed spring elastica fem_gradient swift studies \
  bullet against_felupe accuracy coarse contact machines rod_force increments statements dismissal

# make takes what follows a space for another target, and a shell for another folder to remove.
ifneq ($(words $(VENV)) $(words $(OUT)),1 1)
$(error VENV = $(VENV), OUT = $(OUT), allowed are paths without spaces)
endif
BIN := $(VENV)/bin
IN_OUT := $(OUT:/=)/
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input

.PHONY: help demo bullet test test-slow coverage soak docs notebooks lint format typecheck live bench clean

help:
	@echo "make demo       retract configs/scenes/ten_veins.yaml as in 2009 and with swift, side by side, into $(OUT)"
	@echo "make bullet     install PyBullet where there is no wheel of it, compiling for ten minutes"
	@echo "make test       run the tests;  make test-slow: the slow ones too;  make coverage: which lines no test reaches"
	@echo "make soak       try everything very often, for a day; it goes on where it was stopped; SOAK=\"files --share 0.1\" does a part"
	@echo "make docs       build the documentation's site, site/index.html;  make notebooks: execute its notebooks"
	@echo "make lint       ruff;  make format: ruff, rewriting;  make typecheck: mypy"
	@echo "make live       make docs/live/ten_veins.html again"
	@echo "make bench      measure speed and accuracy, for a day; BENCHMARKS=\"speed cold\" does a part"
	@echo "make clean      remove $(VENV) and caches"
	@echo "PYTHON=/path/to/python3 chooses the interpreter, VENV=folder where it is installed, OUT=folder where results go"

demo: $(VENV)/.installed
	$(BIN)/retract compare ten_veins --out $(OUT)

# CPython 3.12 and newer, and most machines that are not Linux on x86-64, have no wheel of PyBullet. NumPy is
# there before it is built, and it is not built in isolation: else it is built without NumPy.
bullet: $(VENV)/.installed
	@$(BIN)/python -c 'import pybullet' 2> /dev/null || { \
	  $(PIP) install --quiet --only-binary :all: --constraint constraints.txt pybullet 2> /dev/null || { \
	    command -v $(firstword $(CXX)) > /dev/null || \
	      { echo "error: PyBullet has to be compiled here, which needs a C++ compiler; on Debian: apt install g++ python3-dev" >&2; exit 1; }; \
	    echo "compiling PyBullet, some 11 minutes on two cores"; \
	    $(PIP) install --quiet --constraint constraints.txt setuptools wheel && \
	    $(PIP) install --quiet --no-build-isolation --no-binary pybullet --constraint constraints.txt pybullet; }; }
	@$(BIN)/python -c 'import gymnasium as gym, pybullet, retract_env; assert pybullet.isNumpyEnabled(), "PyBullet was built without NumPy"; env = gym.make("TissueRetract-v0", resolution="coarse", grasp="spring"); env.reset(seed=0); env.step(env.action_space.sample()); print("PyBullet works: TissueRetract-v0 has made a step")'

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS)

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "slow or not slow" $(PYTEST_ARGS)

# Without the tests of a full disk: there it is the measurement's own files that find no room.
coverage: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS) -k "not disk" --cov --cov-report=term --cov-report=html:$(IN_OUT)coverage

soak: $(VENV)/.installed-dev
	$(BIN)/python -m soak --out $(IN_OUT)soak $(SOAK)

# Strict: a page or a heading that a link does not find is an error. (--quiet would count no warnings.) The variable hides an
# announcement of the theme's.
docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# In CI's length, which the notebooks' first cells say.
notebooks: $(VENV)/.installed-docs
	$(BIN)/python -m pytest -m notebook tests/test_notebooks.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

typecheck: $(VENV)/.installed-dev
	$(BIN)/mypy

# The page that docs/view.md shows.
live: $(VENV)/.installed
	$(BIN)/retract plan ten_veins --planner ctc --robust --no-pictures --out $(IN_OUT)ctc
	$(BIN)/retract plan ten_veins --planner swift --robust --no-pictures --out $(IN_OUT)swift
	$(BIN)/retract view $(IN_OUT)ctc $(IN_OUT)swift --out docs/live/ten_veins.html

# Without those that need what no extra has, or fit what the package carries to motions that take hours.
bench: $(VENV)/.installed-dev
	@for name in $(BENCHMARKS); do echo "== benchmarks.$$name"; case $$name in env|bullet) \
	    $(BIN)/python -c 'import pybullet' 2> /dev/null || { echo "skipped: PyBullet is missing, make bullet"; continue; };; esac; \
	  $(BIN)/python -m benchmarks.$$name || exit 1; done
	@echo "left out: against_pyelastica, eased, rod_motions, rod_grip, rod_distance, scenario_distance; their docstrings say what they need"

clean:
	rm -rf $(VENV) build site *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: an install is repeated only after one of these files changed.
$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	@echo "installing into $(VENV), some minutes the first time"
	@$(PIP) install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.created pyproject.toml constraints.txt
	@echo "installing into $(VENV) with the developers' tools, some minutes the first time"
	@$(PIP) install --quiet --constraint constraints.txt --editable ".[dev]"
	@touch $(VENV)/.installed $@

$(VENV)/.installed-docs: $(VENV)/.installed-dev
	@$(PIP) install --quiet --constraint constraints.txt --editable ".[dev,docs]"
	@touch $@

$(VENV)/.created:
	@command -v $(PYTHON) > /dev/null || \
	  { echo "error: $(PYTHON) not found; set PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "error: Python 3.10 or newer is needed, $(PYTHON) is $$($(PYTHON) -V 2>&1); set PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
	  { echo "error: $(PYTHON) cannot make virtual environments; on Debian: apt install python3-venv" >&2; rm -rf $(VENV); exit 1; }
	@$(PIP) install --quiet "pip>=23"
	@touch $@
