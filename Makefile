# Two commands do everything, set-up included: `make demo` and `make test`.
PYTHON ?= python3.11
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.merlfit-installed

.PHONY: demo test bench bench-gpu hard-cases tables lint types install schema clean

install: $(READY)

$(READY): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: install
	$(BIN)/merlfit demo -o demo-out

schema: install
	$(BIN)/python -m merlfit.fitting.export

test: install
	$(BIN)/python -m pytest -n 2 --dist loadfile

# 40 minutes on two cores; results/bench/. `python -m tests.bench --all` takes all materials; one section: its name.
bench: install
	$(BIN)/python -m tests.bench

bench-gpu: install
	$(BIN)/python -m tests.bench gpu

hard-cases: install
	$(BIN)/python -m tests.hard_cases

# Hours: every committed table of results/ that needs no genuine measurement.
tables: install
	for table in hard_cases tier_errors zonal_failure energy energy_splits grazing_exponent; do \
		$(BIN)/python -m tests.$$table || exit 1; done

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/pyright

clean:
	rm -rf $(VENV) build *.egg-info demo-out
