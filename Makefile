# Two commands do everything, set-up included: `make demo` and `make test`.
PYTHON ?= python3.11
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.merlfit-installed
UV := $(shell command -v uv)

.PHONY: report demo quick test proofs test-slow bench bench-convergence bench-posterior bench-gpu merl100 cost faults endurance cluster-cost spectral measured hard-cases tables lint types install schema docs docs-links package dist clean

install: $(READY)

$(READY): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(if $(UV),$(UV) venv --quiet --seed --python $(PYTHON),$(PYTHON) -m venv) $(VENV)
	$(if $(UV),$(UV) pip install --python $(BIN)/python,$(BIN)/python -m pip install --disable-pip-version-check) \
		--quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: install
	$(BIN)/merlfit demo -o demo-out

schema: install
	$(BIN)/python -m tests.result_schema

# The pages of docs/, without a network; a warning, a dead link among them, is an error.
docs: install
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going --jobs 2 -c docs . docs/_build/html
	@echo "docs/_build/html/index.html"

# Whether the links that leave the pages lead somewhere; needs a network.
docs-links: install
	$(BIN)/python -m sphinx --quiet --keep-going -D nb_execution_mode=off -b linkcheck -c docs . docs/_build/links

# Groups of tests that have passed with these very sources are left out (tests/proofs.py).
test: install
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow" \
		$$($(BIN)/python -m tests.proofs --left-out)

# An hour: what `make test` leaves out while its sources are as they were when it passed; results/proofs.json.
proofs: install
	$(BIN)/python -m tests.proofs

# A minute and a half: lint, types, and the tests that compile little.
quick: lint types
	$(BIN)/python -m pytest -q -n 2 -m "not slow" tests/test_architecture.py tests/test_readme.py tests/merl_io tests/scene/test_spheres.py \
		$(addprefix tests/fitting/test_,selection.py weights.py metrics.py threads.py outcome.py frontier.py residuals.py \
		result_fields.py damaged_results.py) \
		$(addprefix tests/model/test_,chebyshev.py geometry.py reflectance.py)

# What takes minutes a test; to be run by hand before a release.
test-slow: install
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m slow

# An hour on two cores; results/bench/. `python -m tests.bench SECTION` for one; `--few` for fewer materials and files.
bench: install
	$(BIN)/python -m tests.bench

# Half an hour: 12 materials from 20 random starting points each; goes on where it was stopped.
bench-convergence: install
	$(BIN)/python -m tests.bench convergence

# Hours: posteriors of all 100 reconstructions, 200 synthetic materials, 12 reconstructions in four halves each (these go
# on where they were stopped), nickel beside HP17.
bench-posterior: install
	$(BIN)/python -m tests.bench posterior
	$(BIN)/python -m tests.bench calibration
	$(BIN)/python -m tests.bench halves
	$(BIN)/python -m tests.bench nickel

# Hours: all 100 materials, the two-scale model with three objectives (half an hour), then every other model with
# compressive weights and with none, published parameters beside them; goes on where it was stopped.
merl100: install
	$(BIN)/python -m tests.merl100
	$(BIN)/python -m tests.merl100_rivals compressive
	$(BIN)/python -m tests.merl100_rivals none
	$(BIN)/python -m tests.rival_maps

bench-gpu: install
	$(BIN)/python -m tests.bench gpu

# Ten minutes: all 100 neural reconstructions fitted, and their pages; out/merl100/report/index.html.
report: install
	$(BIN)/python -m tests.report_site

# Half an hour; what it measures is committed and shipped.
cost: install
	$(BIN)/python -m tests.bench tiers
	$(BIN)/merlfit cost -o results/bench/cost
	mv results/bench/cost/frontier.json fitting/cost/frontier.json

# An hour: damaged files, full and vanishing disks, clocks that jump, killed batches, broken clusters; results/faults.md.
faults: install
	$(BIN)/python -m tests.faults

# Twenty minutes: spectral materials recovered from scattered directions; results/spectral.md.
spectral: install
	$(BIN)/python -m tests.spectral

# A quarter of an hour: genuine measurements fitted, and their spheres beside Mitsuba's; goes on where it was stopped.
# Albedos by Mitsuba are committed: three minutes, `python -m tests.measured_albedo`. Posteriors of halves of the files:
# hours, `python -m tests.measured_halves`. results/measured/.
measured: install
	$(BIN)/python -m tests.measured
	$(BIN)/python -m tests.measured_spheres

# A quarter of an hour of both cores: 500 fits in one process; results/endurance.md.
endurance: install
	$(BIN)/python -m tests.endurance

# Minutes: what a file costs the scheduler of a cluster; results/cluster.md.
cluster-cost: install
	$(BIN)/python -m tests.cluster_cost

hard-cases: install
	$(BIN)/python -m tests.hard_cases

# Hours: the tables of results/ about the physics; the others have targets of their own, or name their command.
tables: install
	for table in hard_cases tier_errors energy energy_splits grazing_exponent; do \
		$(BIN)/python -m tests.$$table || exit 1; done

# A source distribution and a wheel of it, as they are to be published; dist/. CI runs what README and docs/ show with this wheel.
package: install
	rm -rf dist
	$(BIN)/python -m build $(if $(UV),--installer uv) > $(VENV)/build.log 2>&1 || (cat $(VENV)/build.log; exit 1)
	$(BIN)/twine check --strict dist/*

# Four minutes: the demo as well, by that wheel, in an empty environment with no folder, setting or compiled program of yours.
dist: package
	set -e; there=$$(mktemp -d); trap 'rm -rf "$$there"' EXIT; \
	$(if $(UV),$(UV) venv --quiet --python $(PYTHON),$(PYTHON) -m venv) "$$there/env"; \
	$(if $(UV),$(UV) pip install --python "$$there/env/bin/python","$$there/env/bin/python" -m pip install) \
		--quiet --constraint constraints.txt dist/*.whl; \
	cd "$$there"; set -x; env -i HOME="$$there" PATH=/usr/bin:/bin env/bin/merlfit --version; \
	env -i HOME="$$there" PATH=/usr/bin:/bin env/bin/merlfit demo -o demo-out

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/pyright

clean:
	rm -rf $(VENV) build dist *.egg-info demo-out
