# One command each. Everything is set up in .venv on first use; nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test coverage test-long lint format types bench lock clean

# pip compiles what it installs, but not what it leaves where it is: a quarter of a second at every start where Python is told to
# keep nothing.
$(READY): pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	$(BIN)/python -m compileall -q plotter planning output
	touch $@

demo: $(READY)
	mkdir -p demo
	$(BIN)/plotter plot samples/rosette.svg --port sim --speed 8 --picture demo/rosette.png
	@echo "picture of what the virtual board drew: demo/rosette.png"

test: lint types
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not long"

# The same tests under a tracer, which takes half as long again.
coverage: $(READY)
	$(BIN)/python -m pytest -n 2 --dist worksteal --cov --cov-report=term -m "not long"

test-long: $(READY)
	$(BIN)/python -m pytest -n 2 -m long

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)
	$(BIN)/python -m benchmarks

# Renews the locked versions; needs `uv` (pip install uv).
lock:
	uv pip compile --quiet --universal --python-version 3.11 --extra dev --extra text pyproject.toml -o requirements.lock

clean:
	rm -rf $(VENV) build demo out .mypy_cache .ruff_cache .pytest_cache .hypothesis
