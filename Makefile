# `make demo`, `make quick` and `make test` work on a fresh clone: they need Python 3.11 or later, a C compiler, and the network once.

PYTHON ?= python3
VENV ?= .venv
WORKERS ?= 2
BIN = $(VENV)/bin
PYTEST = PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n $(WORKERS)
# A file's tests go to one worker, which makes what they share once; files that take the longest are begun first.
BY_FILE = --dist loadfile --no-loadscope-reorder
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo docs track style quick tidy test rest check table durations fuzz lint bench bench-growth bench-ocp bench-kkt bench-classics bench-mpc bench-loops bench-community bench-batches bench-contacts bench-identification bench-derivatives bench-gpu bench-learning bench-startup bench-results study laboratory mutants drawn golden schema clean

demo: $(VENV)/installed
	$(BIN)/mbsgen models/arm_pendulum.yaml -o build/arm_pendulum
	$(BIN)/mbsrun solve models/arm_reach.ocp.yaml -o build/arm_reach
	@echo "The generated C is in build/arm_pendulum, the solution with its pictures in build/arm_reach:"
	@ls build/arm_pendulum build/arm_reach

# All day: style, the types of files that differ from the commit before, and the tests that take no time. A minute.
CHANGED = $(shell { git diff --name-only --diff-filter=d HEAD~1; git ls-files --others --exclude-standard; } 2>/dev/null | \
    grep -E '^(generator/mbsgen|python/mbsrun|benchmarks|studies|website)/.*\.py$$')
quick: style
	$(if $(CHANGED),$(BIN)/mypy $(CHANGED))
	$(PYTEST) -m quick --dist worksteal

# Types are checked beside the tests, since mypy takes one core alone; what it finds is printed last.
TESTS = mkdir -p build; $(BIN)/mypy > build/types.txt 2>&1 & types=$$!; $(PYTEST) $(1) $(BY_FILE); tests=$$?; \
    wait $$types; types=$$?; cat build/types.txt; test $$tests -eq 0 -a $$types -eq 0

# What tests generate and compile is kept from run to run, by the content of its sources, until a week without use.
KEPT = $(CURDIR)/build/tests_cache
quick test rest: export MBS_TESTS_CACHE = $(KEPT)
tidy: $(VENV)/installed-dev
	@mkdir -p -m 700 $(KEPT)
	@XDG_CACHE_HOME=$(KEPT) $(BIN)/mbsrun cache --older-than 7
	@find $(KEPT) -maxdepth 1 -name '*.o' -mtime +7 -delete

# Before a change goes in: style, types, and all tests but the ones that take long. Ten minutes on two cores.
test: style tidy
	@$(call TESTS,-m "not rest")

# What `make test` leaves out: documents and the site, toolchains, studies, the longest tests. tests/durations.py lists it.
rest: tidy
	$(PYTEST) -m rest $(BY_FILE)

# Both in one run, from an empty cache: the tests of a file that take long share what the others have made.
check: style
	@$(call TESTS)

# Measures what each test takes, and renews the list of the slower ones: an hour on a quiet machine.
durations: $(VENV)/installed-dev
	rm -f build/durations.jsonl build/durations.quick.jsonl
	@mkdir -p build
	$(PYTEST) $(BY_FILE) --measure build/durations.jsonl || test $$? -eq 1
	$(BIN)/python -m tests.durations build/durations.jsonl
	$(PYTEST) -m quick $(BY_FILE) --measure build/durations.quick.jsonl || test $$? -eq 1
	$(BIN)/python -m tests.durations build/durations.quick.jsonl

# Runs every command on every kind of model: a quarter of an hour. `make rest` takes a sixth of the kinds.
table: $(VENV)/installed-dev
	WHOLE_TABLE=1 $(PYTEST) tests/test_commands.py --dist worksteal

# Runs the shipped closed loops: some minutes. Each ends with exit code 0 if its measures stay below their limits.
track: $(VENV)/installed
	for file in models/track/*.track.yaml; do \
	    name=$$(basename $$file .track.yaml); \
	    $(BIN)/mbsrun track models/track/$$name.ocp.yaml --settings $$file -o build/track/$$name || exit 1; \
	done

# Changes the files that ship, draws mechanisms and optimal control problems, and draws states for bounds, to find faults:
# some hours. FUZZ="--count 100" is quick, and goes to all searches; FUZZ_INPUTS="--kind models",
# FUZZ_MECHANISMS="--seed 1000", FUZZ_LOOPS="--seed 200", FUZZ_PROBLEMS="--seed 3000" and FUZZ_BOUNDS="--case F05" go to one.
fuzz: $(VENV)/installed-dev
	$(BIN)/python -m tests.fuzz inputs $(FUZZ) $(FUZZ_INPUTS)
	$(BIN)/python -m tests.fuzz mechanisms $(FUZZ) $(FUZZ_MECHANISMS)
	$(BIN)/python -m tests.fuzz loops $(FUZZ) $(FUZZ_LOOPS)
	$(BIN)/python -m tests.fuzz problems $(FUZZ) $(FUZZ_PROBLEMS)
	$(BIN)/python -m tests.fuzz mjcf $(FUZZ)
	$(BIN)/python -m tests.fuzz robots $(FUZZ)
	$(BIN)/python -m tests.fuzz bounds $(FUZZ) $(FUZZ_BOUNDS)

lint: style
	$(BIN)/mypy

style: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# Compares with others: two minutes on a quiet machine, after BENCH=--prepare, which generates and compiles everything,
# measures nothing, and takes half an hour on a machine that may be busy. BENCH=--quick needs no C++ compiler.
bench: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks $(BENCH)

# What robots with floating bases, and chains of up to 128 joints, take to generate, compile and call: some minutes,
# after BENCH=--prepare.
bench-growth: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.growth $(BENCH)

# Solves one task in six representations, ours and CasADi's ways in turn: ten minutes, after BENCH=--prepare, which
# compiles what CasADi writes. BENCH=--quick: a minute.
bench-ocp: $(VENV)/installed
	$(BIN)/python -m benchmarks.ocp $(BENCH)

# Solves problems from the literature by IPOPT with the project's linear solver and with MUMPS: a quarter of an hour.
# BENCH=--quick: three problems, half a minute.
bench-kkt: $(VENV)/installed
	$(BIN)/python -m benchmarks.kkt $(BENCH)

# Published problems of optimal control, and the same in plain CasADi: five minutes. BENCH=--quick: four of them, seconds.
bench-classics: $(VENV)/installed
	$(BIN)/python -m benchmarks.classics $(BENCH)

# Predictive control of a Panda by fatrop, acados and IPOPT: a minute. `python3 tests/acados.py build/acados` installs acados.
bench-mpc: $(VENV)/installed
	$(BIN)/python -m benchmarks.mpc $(BENCH)

# Kernels and motions of mechanisms with closed loops, beside Pinocchio, Simbody, Exudyn and MuJoCo: ten minutes, after
# BENCH=--prepare, which compiles the others' programs.
bench-loops: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.loops $(BENCH)

# Motions of the community's benchmark mechanisms to 3, 6, 9 and 12 digits, beside the same programs: five minutes.
bench-community: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.community $(BENCH)

# Kernels in batches, in lanes and one by one: three minutes.
bench-batches: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.batches $(BENCH)

# A humanoid on rigid contacts, beside MuJoCo: a minute.
bench-contacts: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.contacts $(BENCH)

# A Panda identified from made recordings: errors of masses, times, and how many regions of 95 % hold the truth: minutes.
bench-identification: $(VENV)/installed-bench
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.identification $(BENCH)

# Derivatives of the solutions of all shipped problems against differences of solves: ten minutes.
bench-derivatives: $(VENV)/installed
	$(BIN)/python -m benchmarks.derivatives $(BENCH)

# Kernels on a GPU of NVIDIA, beside frax, MJX and MuJoCo Warp where they are installed: minutes. Where there is none, it says so, and writes nothing.
bench-gpu: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.gpu $(BENCH)

# The price of calls inside JAX and PyTorch, and steps a second beside MuJoCo and MJX: five minutes. BENCH=--quick: a
# minute, without MJX, which compiles long.
bench-learning: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.learning $(BENCH)

# Processor time of commands from their start to their end, of this checkout: two minutes. BENCH="--before CHECKOUT"
# compares with another one.
bench-startup: $(VENV)/installed
	$(BIN)/python -m benchmarks.startup $(BENCH)

# Copies what these have measured to benchmarks/results, and writes its summary.
bench-results: $(VENV)/installed-bench
	$(BIN)/python -m benchmarks.summary
	$(BIN)/python -m benchmarks.readme

# The study of the paper with charts and laboratory, in one page: a day on two cores. STUDY="--sample 33" solves for
# a slice of the targets, CHARTS=--quick measures little else; stopped, it goes on where it was. A quarter of an hour
# shows how it looks: make study CHARTS=--quick STUDY="--sample 2 --quick --minutes 5".
SYSTEMS = $(filter-out models/arm_reach.ocp.yaml,$(wildcard models/*.ocp.yaml))
study: $(VENV)/installed-study
	$(BIN)/mbsrun chart kernels models/arm_pendulum.yaml -o build/charts $(CHARTS)
	$(BIN)/mbsrun chart simulation models/arm_pendulum.yaml -o build/charts $(CHARTS)
	$(BIN)/mbsrun chart optimisation models/arm_reach.ocp.yaml -o build/charts $(CHARTS)
	$(BIN)/mbsrun chart fidelity models/arm_pendulum.yaml -o build/charts $(CHARTS)
	@# 1: a criterion is not met, or the time is over, which is for the report to tell
	$(BIN)/mbsrun lab -o build/laboratory $(CHARTS) || test $$? -eq 1
	$(BIN)/python -m studies.docquier models/arm_reach.ocp.yaml -o build/study --export csv $(STUDY) \
	    $(SYSTEMS:%=--system %) --with build/charts --with build/laboratory || test $$? -eq 1

# Plants faults, one at a time, and runs the tests that must notice them: half an hour to two hours,
# by the machine. `python -m tests.mutants --only WORD` plants the faults alone whose name has this word.
mutants: $(VENV)/installed-dev
	$(BIN)/python -m tests.mutants --workers $(WORKERS)

# Plants a hundred faults that the machine draws, and runs the tests that execute them: an hour. Exit code 0 if 95 % die.
# Stopped, it goes on where it was. `python -m tests.mutants.sights` measures anew which tests execute what.
drawn: $(VENV)/installed-dev
	$(BIN)/python -m tests.mutants --drawn 100 --seed $(or $(SEED),40) --workers $(WORKERS)

# The laboratory, whole: half an hour on one core. Verdicts, maps and their tables go into docs/laboratory.
laboratory: $(VENV)/installed-study
	$(BIN)/mbsrun lab -o build/laboratory || test $$? -eq 1
	cp build/laboratory/verdicts.md build/laboratory/verdicts.csv build/laboratory/map_*.csv \
	    build/laboratory/map_*.png docs/laboratory

# The site: pages, references, and a gallery whose examples are run. Ten minutes; then only what has changed is run.
docs: $(VENV)/installed-dev
	$(BIN)/python -m website -o build/site

# Renews generated/: a sample, and the hashes of all that the other models generate.
golden: $(VENV)/installed-dev
	$(BIN)/python -m tests.golden

schema: $(VENV)/installed-dev
	@mkdir -p build
	$(BIN)/python -m mbsgen.model.file.schema > build/model.schema.json
	mv build/model.schema.json models/model.schema.json
	$(BIN)/python -m mbsgen.subjects.schema > build/subject.schema.json
	mv build/subject.schema.json models/subject.schema.json
	for kind in problem simulation trial; do \
		$(BIN)/python -m mbsrun.schemas $$kind > build/$$kind.schema.json && \
		mv build/$$kind.schema.json models/$$kind.schema.json || exit 1; done

# The environment stays; remove $(VENV) by hand to start from nothing.
clean:
	rm -rf build dist .mypy_cache .ruff_cache .hypothesis
	find generator python studies tests -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/installed: pyproject.toml | $(VENV)/bin/python
	$(PIP) --editable .
	@touch $@

$(VENV)/installed-dev: pyproject.toml | $(VENV)/bin/python
	$(PIP) --editable '.[dev]'
	@touch $@ $(VENV)/installed

$(VENV)/installed-study: pyproject.toml | $(VENV)/bin/python
	$(PIP) --editable '.[study]'
	@touch $@ $(VENV)/installed

$(VENV)/installed-bench: pyproject.toml | $(VENV)/bin/python
	$(PIP) --editable '.[bench]'
	@touch $@ $(VENV)/installed

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	{ echo "$(PYTHON) is older than Python 3.11; name a newer one: make PYTHON=python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }
