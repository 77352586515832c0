# make bench    measure the claims of the HHT paper, compare the solvers; the report goes to reports/latest
# make test     style, types, arrows between the rooms, tests
# make bench-chain  whole solves and memory on chains of 1 to 10,000 links, beside Exudyn's
# make bench-engine  time per step beside hand-written C and Exudyn, compile times, starts, the reference solvers at equal error:
#               reports/latest/speed.html, which the report links (a quarter of an hour)
# make bench-wing  every solver on the flexible, stiff and contact scenes at equal error, beside Exudyn on three of them:
#               reports/latest/wing.md, figures in reports/latest/wing (more than half an hour)
# make validate   every solver and form on every problem: the table reports/published/solvability.md (about an hour)
# make test-faults  the store and the runner of campaigns under faults: 50 kills, signals, disks that fail, power that is
#               lost at any write, flipped bits, clocks that jump, workers that hang, abort, flood, leak (needs a C compiler)
# make test-slow  the slow lane: rows of acceptance that take minutes, every problem where `make test` takes a sample
# make fuzz     10,000 random mechanisms, solved in every way: none hangs, crashes or is silently wrong (SEED=N draws those of N
#               again; twenty minutes on two cores)
# make faults   plant every fault of tests/faults into a copy of the sources: which check finds it (a quarter of an hour on two cores)
# make docs     the pages of docs/, the gallery and the docstrings as a site: build/docs/index.html
# make pictures  the pictures of README and docs/ (a minute)
# make loops    compile the loops of the integrator anew, after a change of their sources (a minute; needs Numba)
# make clean    remove what these made
#
# Another Python: make test PYTHON=python3.13

PYTHON ?= python3
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/installed
FAULTS := $(addprefix tests/campaign/,$(addsuffix .py,test_run_faults test_disk_faults test_damage test_execute test_store test_interruption test_cluster test_without_guard))
PIP := $(BIN)/python -m pip -qq --disable-pip-version-check

# Compiled functions are kept between runs, so that a second run does not compile again; Python's bytecode too, which
# a variable of the caller may forbid: the tests start hundreds of processes.
export PYTHONDONTWRITEBYTECODE :=
export HHTBENCH_CACHE ?= $(CURDIR)/$(VENV)/cache
export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/$(VENV)/cache/xla
export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS ?= 0.1

.DELETE_ON_ERROR:
.PHONY: bench bench-chain bench-engine bench-wing test test-faults test-slow fuzz validate faults docs pictures loops clean

# The report is written also when a claim fails; the exit code then says so.
bench: $(STAMP)
	@mkdir -p reports/latest
	$(BIN)/hhtbench verify paper --jobs $(JOBS) --report reports/latest; verified=$$?; \
	$(BIN)/hhtbench run --campaign quick --jobs $(JOBS) --store reports/latest/campaign.sqlite && \
	$(BIN)/hhtbench report --store reports/latest/campaign.sqlite --folder reports/latest && exit $$verified

# Types are checked beside the tests, on a core that has nothing to do at their end; what is wrong with them is told last.
# A shell lets what it has sent to the background ignore Ctrl-C: hence the trap.
test: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	@$(BIN)/mypy > $(VENV)/types.log 2>&1 & types=$$!; trap 'kill $$types 2>/dev/null' INT TERM; \
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile; tested=$$?; \
	wait $$types; typed=$$?; cat $(VENV)/types.log; exit $$((tested | typed))

test-faults: $(STAMP)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m "" $(FAULTS)

test-slow: $(STAMP)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m long tests --ignore=tests/campaign

fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz --jobs $(JOBS) $(if $(SEED),--seed $(SEED))

# Exudyn is the optional extra "bench"; without it the ratios are missing.
bench-chain: $(STAMP)
	-@$(PIP) install exudyn==1.13.6
	$(BIN)/python -m tests.performance.chain

# The exit code says whether a limit is broken.  QUICK=--quick: the reference solvers on three problems only.
bench-engine: $(STAMP)
	-@$(PIP) install exudyn==1.13.6
	@mkdir -p reports/latest
	$(BIN)/python -m tests.performance.engine $(QUICK)

# The store is new each time: one run measures all.
bench-wing: $(STAMP)
	-@$(PIP) install exudyn==1.13.6
	@mkdir -p reports/latest
	@rm -f reports/latest/wing.sqlite
	$(BIN)/hhtbench run --campaign tests/performance/wing/campaign.toml --jobs $(JOBS) --store reports/latest/wing.sqlite
	$(BIN)/hhtbench report --store reports/latest/wing.sqlite --folder reports/latest/wing
	$(BIN)/python -m tests.performance.wing reports/latest/wing.sqlite reports/latest/wing.md

validate: $(STAMP)
	@mkdir -p reports/latest
	$(BIN)/hhtbench validate --all --jobs $(JOBS) --store reports/latest/validation.sqlite --out reports/published/solvability.md

faults: $(STAMP)
	$(BIN)/python -m tests.faults --jobs $(JOBS) --sound

docs: $(STAMP)
	@$(PIP) install sphinx==9.0.4 furo==2025.12.19 myst-parser==5.2.0 sphinx-gallery==0.22.1
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

pictures: $(STAMP)
	$(BIN)/python docs/pictures/draw.py

loops: $(STAMP)
	$(BIN)/python -m hhtbench.lowering.compile.compiled_loops solvers.hht.run.engine solvers.explicit.march

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis reports/latest

# An editable install sees new entry points only when it is installed again: hence pyproject.toml.
$(STAMP): pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null || { \
		echo "hhtbench needs Python 3.11, 3.12 or 3.13; $(PYTHON) is: $$($(PYTHON) --version 2>&1 | head -n 1)." >&2; \
		echo "Name another one: make PYTHON=python3.12" >&2; exit 1; }
	@echo "installing into $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(PIP) install --no-compile -r requirements.lock # what is imported is compiled then: a quarter of the files
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@
