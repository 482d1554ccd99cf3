# `make demo` and `make test` are all that a newcomer needs. Everything runs in .venv, which is made on first use.
PYTHON ?= python3
BIN := .venv/bin
DEMO := demo
# two processes: the suite is bound by compute, and more would fight over two cores
JOBS ?= 2

.PHONY: demo test check lint bench golden clean

.venv/arfx-installed.json: pyproject.toml setup.py constraints.txt tools/make_venv.py
	$(PYTHON) tools/make_venv.py

demo: .venv/arfx-installed.json
	$(BIN)/arfx demo -o $(DEMO) --overwrite

test: .venv/arfx-installed.json
	$(BIN)/python -m pytest -n $(JOBS) -rs

lint: .venv/arfx-installed.json
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check: lint test

bench: .venv/arfx-installed.json
	$(BIN)/arfx bench
	$(BIN)/python tools/bench_job.py

golden: .venv/arfx-installed.json
	$(BIN)/python -m tests.golden.regenerate

clean:
	rm -rf .venv build dist *.egg-info $(DEMO) .mypy_cache .ruff_cache .pytest_cache
