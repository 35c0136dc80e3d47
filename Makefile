# `make demo` and `make test` need nothing but Python 3.11 or newer and make; all installs go to .venv.

PYTHON ?= python3
BIN := .venv/bin
# Byte code of a package is made as it is first imported, since most modules of most packages never are.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
# The tests start hundreds of processes, so byte code is kept, also where the environment asks for none.
unexport PYTHONDONTWRITEBYTECODE
PYTEST := $(BIN)/python -m pytest --numprocesses 2 --dist worksteal
# All filters that the tests run, at once: each worker would compile them anew.
COMPILE := PYTHONPATH=tests/replay $(BIN)/python tests/compiled_filters.py
SAMPLES := sample_logs/straight.mcap sample_logs/figure_eight.mcap

.PHONY: calibrated calibration coverage demo dist paper test nightly net golden extras lowest quick processors check lint style bench clocks judge attack lock samples schemas pictures readme inputs reference reproduce benchmark benchmark-settings pull_request claims docs clean

# Six simulated dives, and what they say of three changes: one helps, one does harm, one does nothing.
demo: .venv/run.stamp
	$(BIN)/insdvl-replay demo

# The two sample dives with the paper's settings: smaller sigma and faster convergence, as published.
paper: .venv/run.stamp
	$(BIN)/insdvl-replay run $(SAMPLES) --preset levy-klein --output replay --force --rerun

# Six minutes on two cores. Style, types and imports are looked at beside the tests, and told of if they fail.
test: .venv/test.stamp
	@$(MAKE) --no-print-directory style > .venv/style.log 2>&1 & style=$$!; \
	$(COMPILE) && $(PYTEST) -m "not nightly"; tests=$$?; \
	wait $$style || { cat .venv/style.log; exit 1; }; \
	exit $$tests

# At most an hour on two cores: the tests that `make test` leaves out, and the rates in benchmarks/RESULTS.md.
nightly: .venv/test.stamp tests/node/node_modules
	$(COMPILE)
	$(PYTEST) -m nightly
	$(MAKE) lowest
	$(MAKE) --jobs 2 --output-sync=target judge calibration
	$(BIN)/python tests/attacks/attack.py all --short --count 60

# Short work with the lowest versions of all packages that pyproject.toml allows, in an environment of its own.
LOWEST := build/lowest
lowest: .venv/run.stamp
	$(PYTHON) -m venv --clear $(LOWEST)
	$(BIN)/python tests/lowest.py list > $(LOWEST)/versions.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --only-binary :all: --requirement $(LOWEST)/versions.txt
	PYTHONPATH=$(CURDIR) $(LOWEST)/bin/python tests/lowest.py

# What the commands say of twelve dives, stored anew; git tells what has moved.
net: .venv/test.stamp
	$(BIN)/python tests/net/net.py --renew

# What some nightly tests need beside Python: a browser for the pages, and node with what Foxglove reads logs with.
extras:
	sh tests/extras.sh
	$(MAKE) tests/node/node_modules

# What stands on screens and what is said in errors and notes, stored anew; git tells what has moved.
golden: .venv/test.stamp
	PYTHONPATH=tests $(BIN)/python tests/words/test_messages.py
	PYTHONPATH=tests $(BIN)/python tests/cli/test_screens.py

# At most 40 s: the rooms of formulas, tables and words.
QUICK := core document geometry nav evaluation checks show words
quick: .venv/test.stamp
	$(PYTEST) -m "not nightly" $(QUICK:%=tests/%)

# All tests on each of four emulated processors, which takes four times as long as on this one.
processors: .venv/test.stamp
	$(BIN)/python tests/processors.py -m pytest --numprocesses 2 --dist worksteal -m "not nightly"

# The example archive against its gates, as a team's own job does it.
check: .venv/run.stamp
	$(BIN)/insdvl-replay check examples/archive/gates.toml --jobs 2

lint: style
	$(BIN)/python -m pytest --quiet -rP tests/project/test_house.py

# What `make lint` looks at and no test does.
style: .venv/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Makes logs of up to 3 GB in the temporary folder and removes them; takes some half an hour.
bench: .venv/bench.stamp
	$(BIN)/python benchmarks/reading.py
	$(BIN)/python benchmarks/containers.py
	PYTHONPATH=tests $(BIN)/python benchmarks/filtering.py
	PYTHONPATH=tests $(BIN)/python benchmarks/work.py
	$(BIN)/python benchmarks/outages.py
	$(BIN)/python benchmarks/nees_intervals.py
	$(BIN)/python benchmarks/batch.py
	$(BIN)/python benchmarks/lake.py
	$(BIN)/python benchmarks/whole_run.py

# What `calibrate` must be able to do, line by line; takes some ten minutes.
calibration: .venv/test.stamp
	PYTHONPATH=tests/calibration $(BIN)/python benchmarks/calibration.py

# How far files by unrelated clocks are off once they are brought together, where the truth is known; takes some 20 minutes.
clocks: .venv/test.stamp
	PYTHONPATH=tests $(BIN)/python benchmarks/clock_worlds.py

# How often the words on filters are right, in worlds whose truth is known; takes twenty minutes on two cores.
JUDGES := rule_worlds misfit_worlds scatter_judge judge onboard foreign noise trajectory_worlds where_worlds history_worlds steps
judge: .venv/test.stamp
	@failed=0; for part in $(JUDGES); do \
		PYTHONPATH=tests $(BIN)/python benchmarks/$$part.py || { echo "$$part: a rate is not as asked"; failed=1; }; \
	done; exit $$failed

# Damaged logs, bombs, hostile names, kills, swaps; takes some hour, and fails if there is a defect.
attack: .venv/test.stamp
	$(BIN)/python tests/attacks/attack.py all --write

# What share of the lines the tests of a commit run, in build/coverage.md; compiled functions are not counted. With ROOMS="tests/core
# tests/document", of these tests. It takes twice as long as `make test`.
ROOMS ?= tests
coverage: .venv/test.stamp
	rm -f build/.coverage*
	$(COMPILE)
	$(BIN)/python -m coverage run -m pytest --numprocesses 2 --dist worksteal -m "not nightly" $(ROOMS)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report --format=markdown > build/coverage.md
	@tail -n 1 build/coverage.md

# Source, wheel, and the list of their packages: what a release publishes.
dist: .venv/test.stamp
	rm -rf dist
	$(BIN)/python -m build --no-isolation --outdir dist .
	$(BIN)/python docs/generate/sbom.py build/sbom.cdx.json

# The wheels of constraints.txt, with their digests.
lock: .venv/run.stamp
	$(BIN)/python docs/generate/lock.py

# Made anew only when the simulation or the writer changes; tests hold them to SHA256SUMS.
samples: .venv/run.stamp
	sh sample_logs/make.sh $(BIN)/insdvl-replay
	sh examples/archive/make.sh $(BIN)/insdvl-replay

schemas: .venv/run.stamp
	$(BIN)/insdvl-replay schema config > schemas/config.schema.json
	$(BIN)/insdvl-replay schema report > schemas/report.schema.json
	$(BIN)/insdvl-replay schema inspection > schemas/inspection.schema.json
	$(BIN)/insdvl-replay schema study > schemas/study.schema.json
	$(BIN)/insdvl-replay schema comparison > schemas/comparison.schema.json
	$(BIN)/insdvl-replay schema trajectories > schemas/trajectories.schema.json
	$(BIN)/insdvl-replay schema calibration > schemas/calibration.schema.json
	$(BIN)/insdvl-replay schema check > schemas/check.schema.json
	$(BIN)/insdvl-replay schema history > schemas/history.schema.json
	$(BIN)/insdvl-replay schema start > schemas/start.schema.json
	$(BIN)/python docs/generate/row_messages.py

pictures: .venv/run.stamp
	$(BIN)/python docs/generate/pictures.py

readme: .venv/run.stamp
	$(BIN)/python docs/generate/readme.py
	$(BIN)/python docs/generate/screens.py

# The pages as a site, in build/site; a link that leads nowhere is an error.
docs: .venv/test.stamp
	$(BIN)/python docs/generate/site_pages.py build/pages
	$(BIN)/python -m mkdocs build --strict --quiet

# The page of the logs that can be used, by the tables of the types that are known.
inputs: .venv/run.stamp
	$(BIN)/python docs/generate/inputs.py

# The pages of docs/reference/, by what the program says of its commands, settings, tables and public names.
reference: .venv/run.stamp
	$(BIN)/python docs/generate/reference.py

# The parts that need the eight dives of the AUV Snapir, in ../shared/data/snapir or where DIVES says, stay as they are without them.
DIVES ?= ../shared/data/snapir
reproduce: .venv/run.stamp
	$(BIN)/python docs/generate/reproduction.py $(DIVES)

# Candidates of benchmarks/public on the public dives; only what is new is replayed. With ONLY=NAME, the details of one are printed.
# Logs and tables that are in the folder DATA are not fetched.
benchmark: .venv/run.stamp
	DATA=$(DATA) $(BIN)/python docs/generate/benchmark.py $(ONLY)

# The settings of the Snapir's dives for the benchmark, with the clocks of the published tables: five minutes.
benchmark-settings: .venv/run.stamp
	DATA=$(DATA) $(BIN)/python docs/generate/benchmark_settings.py

# What the changes of a pull request do on the eight dives, in docs/pull_request.md: eight minutes of one processor.
pull_request: .venv/run.stamp
	$(BIN)/python docs/generate/judged_pull_request.py $(DIVES)

# Filters of published papers on the public dives of ../shared/data; what has a result is kept. With ONLY=NAME, one is run again.
claims: .venv/run.stamp
	$(BIN)/python docs/generate/published_claims.py $(ONLY)

# How the DVLs of the three examples are built in, found from nothing; git tells what moved. The examples have these values: copy what
# moved. Dives 09 and 11 of the Snapir, whose DVL is noisy, are left out, and confirm it. Needs the logs of ../shared/data, or of DATA.
DATA ?= ../shared/data
UNKNOWN := --set dvl.lever_arm_m=[0,0,0] --set dvl.mounting_rpy_deg=[0,0,0] --set dvl.scale=1 --set dvl.latency_s=0 --set dvl.latency_of_dives_s=[]
QUIET := $(patsubst %,$(DATA)/snapir/snapir_%.mcap,01 02 05 07 08 12)
calibrated: .venv/run.stamp
	$(BIN)/insdvl-replay calibrate $(QUIET) -c examples/snapir.toml --preset fog $(UNKNOWN) --force -o examples/calibrated/snapir.toml
	$(BIN)/insdvl-replay calibrate $(DATA)/blueye_x3/auto_square.mcap -c examples/blueye_x3.toml $(UNKNOWN) --only arm,delay --force -o examples/calibrated/blueye_x3.toml
	$(BIN)/insdvl-replay calibrate $(DATA)/ufmil/run_1.mcap $(DATA)/ufmil/run_2.mcap -c examples/ufmil.toml $(UNKNOWN) --mounting unknown --force -o examples/calibrated/ufmil.toml

clean:
	rm -rf .venv demo replay checked build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache tests/node/node_modules

# What Foxglove reads logs with; where there is no npm, the test that needs it says so and is left out.
tests/node/node_modules: tests/node/package-lock.json
	if command -v npm > /dev/null; then \
	  npm ci --prefix tests/node --silent --no-audit --no-fund && touch $@ || echo "npm ci failed: its test is left out"; \
	fi

.venv/pyvenv.cfg:
	$(PYTHON) -m venv .venv

# The stamp holds the extra that was installed: tests need it at once, and pip looks for all packages each time it is called.
.venv/run.stamp: .venv/pyvenv.cfg pyproject.toml constraints.txt
	$(PIP) --editable ".$(EXTRA)"
	echo "$(EXTRA)" > $@

.venv/test.stamp: EXTRA := [test]
.venv/test.stamp: .venv/run.stamp
	grep --quiet test $< || $(PIP) --editable ".[test]"
	touch $@

.venv/bench.stamp: .venv/test.stamp
	$(PIP) --editable ".[test,bench]" || echo "GTSAM has no wheel for this machine: it is not measured"
	touch $@
