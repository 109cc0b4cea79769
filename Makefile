# Each target does all set-up on a fresh machine: a virtual environment, the pinned packages, then the work.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
READY  := $(VENV)/.ready

.PHONY: demo build wheels wheels-test release test docs docs-serve slow lint types check bench bench-fleet bench-live regression soak fuzz faults accuracy campaign steps rows recorded public-logs sensitivity mutants pages clean help

help:            ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 12

PIP_INSTALL = PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check
UPLOT = src/replant/report/assets/uplot

$(READY): pyproject.toml constraints.txt hatch_build.py
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --editable '.[dev]'
	command -v $${CC:-cc} >/dev/null || $(PIP_INSTALL) ziglang  # else edits of a kernel could not be compiled
	test -d $(UPLOT) || $(PIP_INSTALL) --no-deps uplot-python  # without npm: of this package one file is used
	touch $@

build: $(READY)  ## compile the kernels: after an edit of one; in seconds
	cd tools && ../$(BIN)/python -m translator.library $(ARGS)

$(VENV)/.wheels: $(READY)
	$(PIP_INSTALL) auditwheel ziglang
	touch $@

wheels: $(VENV)/.wheels  ## wheels for Linux, macOS and Windows, from this machine; in dist
	$(BIN)/python tools/wheels.py

wheels-test: $(VENV)/.wheels  ## install the wheel of this system without a compiler, and identify a plant with it; that for ARM under QEMU
	$(BIN)/python tools/wheels.py --try

release: $(VENV)/.wheels  ## VERSION=0.2.0: version, changelog, tests, wheels, commit and tag; nothing is uploaded
	$(BIN)/python tools/release.py $(VERSION)

demo: $(READY)   ## identify a simulated actuator while it runs; plots in out/demo
	$(BIN)/replant demo

# two workers more than a small machine has cores: many tests wait; stolen work keeps the tests of a module together, and
# with them what they share
# hundreds of tests start a program: without compiled modules each start compiles all of them
test slow: export PYTHONDONTWRITEBYTECODE =
test: $(READY)   ## lint, types, doctests, tests; some minutes
	+$(MAKE) -j 2 lint types
	$(BIN)/pytest -n 4 --dist worksteal

docs: $(READY)   ## the site, every block of it executed; in out/docs/html
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python -m sphinx -W --keep-going -d out/docs/doctrees docs out/docs/html $(ARGS)

docs-serve: docs ## the same on http://127.0.0.1:8000
	$(BIN)/python -m http.server 8000 --bind 127.0.0.1 --directory out/docs/html

slow: $(READY)   ## the tests that take longer: the cases that `make test` leaves out, Dask, kills, the built site
	$(BIN)/pytest -n 4 --dist worksteal -m "slow or hypothesis"

lint: $(READY)   ## style, format, spelling, workflow, imports, docstrings, pages; seconds
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/typos docs/ src *.md
	$(BIN)/zizmor --offline --quiet --no-progress .github
	$(BIN)/lint-imports --no-cache --no-logo
	$(BIN)/python tools/imports.py
	$(BIN)/python tools/docstrings.py
	$(BIN)/python tools/pages.py
	$(BIN)/python tools/constants_page.py --check
	$(BIN)/python tools/architecture.py --check
	$(BIN)/python tools/release.py --check

types: $(READY)  ## mypy strict
	$(BIN)/mypy

$(VENV)/.peers: $(READY)
	$(PIP_INSTALL) --editable '.[peers]'
	touch $@

bench: $(VENV)/.peers  ## speed, as ratios to C and to other libraries measured in the same run; writes docs/performance.md
	$(BIN)/python benchmarks $(ARGS)

regression: $(READY)  ## speed beside C, wide logs beside narrow ones, with a wide margin; a few seconds
	$(BIN)/python benchmarks/kernels.py --limit 2 --entries 4 8 --repetitions 15
	$(BIN)/python benchmarks/wide_logs.py

bench-fleet: $(READY)  ## fleets: samples a second beside update_many, workers, memory, odd rigs; ARGS="--rigs 20"
	$(BIN)/python benchmarks/fleet $(ARGS)

bench-live: $(READY)  ## live: throughput over TCP and MQTT, latency over UDP, memory
	$(BIN)/python benchmarks/live.py

soak: $(READY)   ## 1,000 hours of rig time with random faults; a day through a session: memory, estimate, checkpoint
	$(BIN)/python benchmarks/soak $(ARGS)

fuzz: $(READY)   ## mutants of checkpoints and files, calls and command lines with hostile numbers: half an hour, or SECONDS=; ARGS="--only hdf5"
	cd tests && ../$(BIN)/python -m fuzz --seconds $(or $(SECONDS),600) $(ARGS)

faults: $(READY)  ## let every call of a live session fail that can, one a session: an hour; needs gcc
	$(BIN)/python tests/failing $(ARGS)

accuracy: $(READY)  ## accuracy, Monte Carlo beside what is promised; writes docs/accuracy.md, its tables and out/accuracy; ARGS="--scenario K" renews one
	$(BIN)/python benchmarks/accuracy $(ARGS)

campaign: $(READY)  ## the default on 1,000 random plants, and 500 field records; SEED=2 gives others
	$(BIN)/python benchmarks/campaign --seed $(or $(SEED),1) $(ARGS)

steps: $(READY)  ## the structure search and `fit` on 60 step tests, and the time of a search; SEED=2 gives others
	$(BIN)/python benchmarks/steps --seed $(or $(SEED),1) $(ARGS)

rows: $(READY)  ## several inputs: known plants beside maximum likelihood, feedback, random plants; SEED=2 gives others
	$(BIN)/python benchmarks/rows --seed $(or $(SEED),1) $(ARGS)

recorded: $(READY)  ## `run` beside `fit` on every recorded log
	$(BIN)/python benchmarks/recorded.py

public-logs: $(READY)  ## `fit` and `run` on public logs beside an output-error fit; MIRROR=folder of git directories
	$(BIN)/python benchmarks/public_logs --mirror $(or $(MIRROR),out/mirror) $(ARGS)

sensitivity: $(READY)  ## halve and double each tuned constant on a battery of records; an hour of a core; out/sensitivity.jsonl
	$(BIN)/python benchmarks/sensitivity $(ARGS)

mutants: $(READY)  ## lines changed one at a time, which the tests have to notice: an hour; ARGS="--sample 20 --areas logs"
	$(BIN)/python tools/mutants.py $(ARGS)

pages: $(READY)  ## what is made from the source: picture of the folders, page of the tuned constants
	$(BIN)/python tools/architecture.py --picture docs/pictures/architecture.svg
	$(BIN)/python tools/constants_page.py

clean:           ## remove everything that was generated
	rm -rf $(VENV) $(UPLOT) src/replant/kernels/compiled out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
