# Everything a clone needs: `make demo`, `make studio` and `make test` set up .venv by themselves, once.
# Another Python: make demo PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo studio test fast slow check fuzz kills clean

demo: $(READY)
	$(RUN)/preimage demo

studio: $(READY)
	$(RUN)/preimage studio --open

# A process a core, each with one thread: torch's threads would wait for one another. Bytecode is kept, also where the environment says
# otherwise, as it does in many containers: dozens of processes import preimage.
PYTEST = OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(RUN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile

test: fast slow

fast: $(READY)
	$(PYTEST) -m "not slow"

slow: $(READY)
	$(PYTEST) -m slow

# Damaged inputs and words that are off, ten thousand of them: about two hours on one core.
fuzz: $(READY)
	OMP_NUM_THREADS=1 $(RUN)/python tests/fuzz.py 10000

# A training killed at a hundred random moments, and the other verbs at some of theirs.
kills: $(READY)
	$(PYTEST) -m slow -k kill --kills 100

check: $(READY)
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/pyright

clean:
	rm -rf $(VENV) demo .pytest_cache .ruff_cache .hypothesis

# torch goes first and alone, so that no other package can bring in another build of it.
$(READY): constraints.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "preimage needs Python 3.11 or newer, and $(PYTHON) is older or missing: make $(MAKECMDGOALS) PYTHON=/path/to/python3" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(RUN)/python -m pip install --quiet --constraint constraints.txt torch
	$(RUN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	$(RUN)/python -m preimage.fast
	@touch $(READY)
