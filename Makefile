# make demo | test | check | fuzz | bench | hard | calibrated | looks | errors | golden | wheel | clean      (a bare Python >= 3.11 is all it needs; PYTHON= chooses one)
PYTHON ?= python3
BIN := .venv/bin
# Test processes: the suite is bound by compute, and more would fight over two cores.
JOBS ?= 2
TESTS ?= tests
# Of make fuzz. Case N of seed S is the same everywhere: the minute of make check is how 10,000 begin.
CASES ?= 10000
SEED ?= 0
# -v undoes the -q of pyproject.toml, so that the closing line is pytest's full one; -rfEs names what fails and gives the reason of every skip.
PYTEST = $(BIN)/python -m pytest -v -rfEs -n $(JOBS) --dist worksteal --durations 10

.PHONY: help demo test check lint fuzz bench hard calibrated looks errors golden wheel clean distclean venv

help:
	@echo "make demo    makes a sample clip, puts a model on its marker, writes demo/"
	@echo "make test    all tests (TESTS=tests/unit for some)"
	@echo "make check   formatting, lint, types, all tests, a minute of hostile inputs: what CI runs"
	@echo "make fuzz    new random examples of every property; 10,000 hostile inputs, faults, kills and signals (CASES=, SEED=)"
	@echo "make bench   cost of whole jobs against a plain decode and encode, in one run"
	@echo "make hard    every hard scene, stated hard case, sweep and clip towards a singularity: one table, hard/table.md"
	@echo "make errors  measures the errors of all levels that are shipped: a table, plots and arfx/plan/default_errors.json"
	@echo "make calibrated  some 300 random clips: is the light's direction as far off as is stated? calibrated/table.md"
	@echo "make looks   does the light hold on clips as telephones film them? each against its truth, looks/table.md"
	@echo "make golden  renders the expected pictures of sample_scenes/ anew; look at them before committing"
	@echo "make wheel   a wheel for this Python that carries compiled code, in dist/"
	@echo "make clean   removes what was built or made; make distclean also .venv"

# Decides by the contents of pyproject.toml and constraints.txt whether there is anything to do; quick and offline if not.
venv:
	@$(PYTHON) tools/make_venv.py

demo: venv
	$(BIN)/arfx demo -o demo --overwrite

test: venv
	$(PYTEST) $(TESTS)

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check: lint
	$(PYTEST) $(TESTS)
	$(BIN)/python -m tests.fuzz --seconds 60 --seed $(SEED)

fuzz: venv
	$(PYTEST) tests/property --hypothesis-profile default
	$(BIN)/python -m tests.fuzz --cases $(CASES) --seed $(SEED)

bench: venv
	$(BIN)/arfx bench
	$(BIN)/python tools/bench_job.py

hard: venv
	$(BIN)/python -m tests.hard

errors: venv
	$(BIN)/python tools/measure_errors.py -o out/errors --write

calibrated: venv
	$(BIN)/python -m tests.calibrated

looks: venv
	$(BIN)/python -m tests.looks

golden: venv
	$(BIN)/python -m tests.golden.regenerate

wheel: venv
	$(BIN)/python tools/build_wheel.py

clean:
	rm -rf build dist out demo hard calibrated looks .pytest_cache .mypy_cache .ruff_cache .hypothesis tests/golden/failed
	find arfx cli tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean
	rm -rf .venv *.egg-info
