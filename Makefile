# The two jobs of a fresh machine: `make demo` shows the whole path with the light install, `make test`
# proves it with every extra. Both first make a virtual environment with the pinned versions and see
# to the GL libraries.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out

# Demo and tests start many processes: the bytecode of what they import is kept.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all dist check check-evals tables release-check docs licences mutation setup light gl clean

setup: $(VENV)/.ready gl
light: $(VENV)/.light gl

# What generates, detects, tracks and scores: no torch, no extras.
$(VENV)/.light: pyproject.toml requirements.lock
	$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if (3, 11) <= v <= (3, 13) else f"Python 3.11 to 3.13 is needed, this is {sys.version.split()[0]}: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV) || { echo "the venv module is missing: apt-get install python3-venv"; exit 1; }
	$(BIN)/python -m pip install --quiet --no-compile --constraint requirements.lock --editable .
	touch $@

$(VENV)/.ready: $(VENV)/.light
	$(BIN)/python -m pip install --quiet --requirement requirements.lock
	touch $@

gl:
	@sh tools/install-gl.sh

demo: light
	$(BIN)/egocap-sim generate validation-walk --out $(OUT)/walk
	$(BIN)/egocap-sim verify $(OUT)/walk
	$(BIN)/egocap track $(OUT)/walk --out $(OUT)/walk.track.npz
	$(BIN)/egocap-eval pose $(OUT)/walk --track $(OUT)/walk.track.npz
	$(BIN)/egocap-sim preview $(OUT)/walk --out $(OUT)/walk.png
	$(BIN)/egocap view $(OUT)/walk $(OUT)/walk.track.npz --save $(OUT)/walk.mp4

# One thread of the numeric libraries for each of the two processes. A process that dies ends the
# tests and names the one it was in: after a restart, pytest-xdist waits for ever.
test: export OMP_NUM_THREADS := 1
test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# The tests, without those of training, on each other supported Python of the PATH, pyenv or uv.
test-all: test
	sh tools/test-pythons.sh $(OUT)/pythons

# The wheel in out/dist, checked in a new environment from another folder.
dist: gl
	PYTHON=$(PYTHON) sh tools/build-wheel.sh $(OUT)/dist

check: setup
	$(BIN)/pyright

# A fixed small suite against recorded numbers; exit code 3 and a table when something got worse.
check-evals: setup
	$(BIN)/egocap-eval check --baseline evals/egocap_eval/baselines/ci.json

# The tables of README and docs, from evals/results.
tables: setup
	$(BIN)/egocap-eval tables

# For a release: no table differs from its result, and no result is stale.
release-check: setup
	$(BIN)/egocap-eval tables --check
	$(BIN)/egocap-eval refresh --dry-run

# Licences of the pinned packages, and a software bill of materials in out/bom.json.
licences: setup
	$(BIN)/python tools/licences.py requirements.lock $(OUT)/bom.json

# Mutants of the formula modules that no test notices, with scores; an hour on two cores, resumable.
mutation: setup
	$(BIN)/python tools/mutation.py $(OUT)/mutation

# The documentation, with its command and API reference, in out/site.
docs: setup
	$(BIN)/python -m pip install --quiet --requirement requirements-docs.lock
	$(BIN)/python -m mkdocs build --quiet

clean:
	rm -rf $(VENV) $(OUT)
