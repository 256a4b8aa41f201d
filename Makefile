# `make help` lists the targets. Everything lands in .venv and build/.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP_TOLD := $(BIN)/python -m pip --disable-pip-version-check
PIP := $(PIP_TOLD) --quiet
COMPILE = $(BIN)/python -m compileall -q -j 0 swarmd patterns drivers sim config
# What lists of pyproject.toml name, one a line; pip reads groups only from 25.1 on, and a new
# environment may hold an older one.
LISTED = $(BIN)/python -c 'import functools, sys, tomllib; file = tomllib.load(open("pyproject.toml", "rb")); \
  print(*(one for name in sys.argv[1:] for one in functools.reduce(dict.get, name.split("."), file)), sep="\n")'
# pip alone compiles one file after the other, and the tests of packages too.
# $(call install,WORDS,LISTS,MORE): one line tells how far pip is.
install = { { { $(LISTED) $(2); printf '%s\n' $(3); } | $(PIP_TOLD) install --no-compile --constraint constraints.txt \
  --requirement /dev/stdin || touch $(VENV)/failed; } | $(BIN)/python .ci/show-install $(1); } && ! rm $(VENV)/failed 2>/dev/null
COMPILE_PACKAGES = { $(BIN)/python -m compileall -qq -j 0 -x '/tests?/' $(VENV)/lib || true; }
# $(call timed,WORDS,COMMAND): one line tells how long it took.
timed = began=$$(date +%s); $(2) && echo "  $(1): $$(($$(date +%s) - began)) s"
# Two makes must not install at the same time, and `make demo` installs in the background.
LOCKED := $(if $(shell command -v flock),flock $(VENV)/lock)
# Not $(MAKE), which `make -n` would run, too.
REST := env -u MAKEFLAGS make --no-print-directory
# Lists that are installed while the kernels are compiled; by default they wait until they are needed.
BESIDE ?=
ARGS ?=
# The lanes of the tests, by their marks: `make test` runs SHORT, and `make test-all` the others, too.
SHORT = not (integration or long) or smoke
# Test files at a time. The short lane computes: one for each core. Six for the rest: at most four wait
# for processes, since with six of these daemons on slow cores stall for more than 1 s, which refuses
# their runs; two compute, at a lower priority (tests/support/scheduling.py). 0: one after the other, in
# this process.
JOBS ?=

# Beside all checkouts, since the first build takes six minutes on two cores; tests find it there.
ROUTER := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/swarmd/ros2_router

.PHONY: help demo behaviour instructions short-forms kernels wheels archive release earlier test test-all test-long test-robot evidence check static wheel bringup format docs reference names bench budget network network-scale films ros2-router zenohd lock clean sequences arm64 night
.DELETE_ON_ERROR:

help:
	@echo "make demo      seven simulated robots gather; the first time installs, for some 15 s"
	@echo "make test      what decides and computes, three minutes  (ARGS='-k scan' picks some, JOBS=0 one by one)"
	@echo "make test-all  all tests: make test, then processes, long simulations and studies  (STALLS=1 stops their processes at random moments)"
	@echo "make test-robot  the tests of the robot wing: what runs on a robot, without swarmctl and the simulation"
	@echo "make kernels   compiles the kernels again, after an edit of one"
	@echo "make wheels    wheels with kernels for x86-64 and aarch64, in dist"
	@echo "make archive   archives from which robots install without a network, in dist"
	@echo "make release   sdist, wheels, notes and checksums of the tag at HEAD, in dist; uploads nothing (URL=https://...)"
	@echo "make earlier   the wheel of an earlier version, for the tests in which two versions meet; some seconds, once"
	@echo "make check     format, lint, types, the site, and the wheel tried in a fresh environment"
	@echo "make docs      the site of the documentation, in build/site; open index.html, no network needed"
	@echo "make reference writes the parts of pages that are made from the code: short ones where they stand, all in build/pages"
	@echo "make names     writes tests/docs/public_names.txt again, the names and signatures on which users build"
	@echo "make format    formats the code and applies the fixes of the linter"
	@echo "make bench     the measurements, beside their goals (ARGS=latency picks one)"
	@echo "make budget    each budget: a ratio to a yardstick of the same run, in three minutes"
	@echo "make instructions  costs in instructions beside those of the last tag, by callgrind; some minutes  (ARGS='--against REV')"
	@echo "make arm64     tests, traces and a daemon on an emulated arm64; as root, half an hour at first"
	@echo "make network   are the answers of swarmctl true on a bad radio; as root, half an hour"
	@echo "make network-scale  packets, bytes, CPU and memory of 10, 20 and 40 robots; as root"
	@echo "make sequences  every sequence of orders and events on the real robot; ARGS=\"robot --replay run,stop\" repeats one; some six hours of a core"
	@echo "make behaviour  the ledger of how robots drive, which make test compares; a minute  (ARGS='--against REV': by how much)"
	@echo "make short-forms  the kept digits of each pattern's short form again; some minutes"
	@echo "make night     the tables and figures of the pages that are older than the code; hours  (ARGS=--plan shows which, ARGS=paper makes one)"
	@echo "make evidence  long tests, then make night; hours on two cores"
	@echo "make films       a short film of each pattern; a few minutes"
	@echo "make ros2-router  a Zenoh router with the ros2dds plugin, for tests behind a bridge; needs cargo, cmake, libclang"
	@echo "make zenohd    a Zenoh router with the REST and storage plugins, and the example in Rust, for tests; needs cargo"
	@echo "make lock      writes constraints.txt again, with the newest versions that fit"
	@echo "make clean     removes .venv, build and caches"
	@echo "PYTHON=python3.12 picks the interpreter."

# The first time robots move before the kernels are there: these are compiled meanwhile, in a process
# group that Ctrl-C ends, too. Processes that start late must not mix interpreted and compiled code.
demo: $(VENV)/interpreted
	@if [ $(VENV)/installed -nt $(VENV)/interpreted ]; then exec $(BIN)/swarmctl demo $(ARGS); fi; \
	  echo "Kernels are compiled and matplotlib is installed while the robots move; the next start has both."; \
	  setsid nice -n 19 $(REST) $(VENV)/installed >$(VENV)/rest.log 2>&1 & rest=$$!; \
	  trap "kill -- -$$rest 2>/dev/null" INT TERM; \
	  SWARMD_COMPILED=0 $(BIN)/swarmctl demo $(ARGS); status=$$?; \
	  if [ $$status -gt 128 ]; then kill -- -$$rest 2>/dev/null; exit $$status; fi; \
	  ! kill -0 $$rest 2>/dev/null || echo "Waiting for the compiler; after Ctrl-C the next make goes on."; \
	  wait $$rest || echo "the kernels were not installed: see $(VENV)/rest.log; the next make tries again" >&2; \
	  exit $$status

# After an edit of a file that setup.py names.
kernels: $(VENV)/tools
	@$(BIN)/python setup.py --quiet build_ext --inplace

wheels: $(VENV)/made
	@.ci/build-wheels $(BIN)/python

# ARGS="--python FILE --sha256 HEX" takes that Python along instead of Debian's, as for Debian 11.
archive: wheels
	@for machine in x86_64 aarch64; do \
	  $(BIN)/python .ci/build-archive $$machine dist/swarmd-*-abi3-*_$$machine.whl $(ARGS) || exit 1; done

# URL=https://FORGE/OWNER/swarmd is the address of the project on its forge; by default that of origin.
release: $(VENV)/tools
	@$(BIN)/python .ci/release $(URL)

# The version that tests/swarm/test_versions.py lets meet this one: 0.2.0, whose users update first. A
# release sets the commit of the version before it. In the user's cache, for all checkouts.
EARLIER := a8e6a8de6c46af36f6e38027e279cc1feb1f0326

earlier: $(VENV)/tools
	@.ci/build-earlier $(BIN)/python $(EARLIER)

# Compiled first: hundreds of processes would each compile what was edited, where
# PYTHONDONTWRITEBYTECODE is set (a start of swarmd takes 0.46 s of CPU then, and 0.21 s else). 50: the
# slowest tests that are shown.
test test-long test-robot: export PYTHONDONTWRITEBYTECODE =
# Pages and files of the tests are UTF-8, whatever the locale of the shell is.
test test-long test-robot: export PYTHONUTF8 = 1
# Threads of OpenBLAS wait for each other by computing, and there are more processes than cores.
test test-long test-robot: export OPENBLAS_NUM_THREADS = 1
# What is tested or timed is done, not taken from the store of runs.
test test-long test-robot check docs wheel bench budget instructions arm64: export SWARMD_RUN_STORE = off
# $(call tested,JOBS,MORE,BEFORE): pytest with so many files at a time. ARGS of test-all (ALL) may pick no
# test of a lane, with which pytest exits with 5.
tested = $(COMPILE) tests && { $(3) $(BIN)/python -m pytest -n $(or $(JOBS),$(1)) --dist loadfile --no-loadscope-reorder $(2) \
  $(if $(ARGS),$(if $(ALL),|| [ $$? -eq 5 ])); }

# YOUNG=1: as on a machine that booted 5 s ago, as .ci/run does.
test: kernels
	@$(call tested,2,--durations 20 -m "$(SHORT)" $(ARGS),$(if $(YOUNG),.ci/young))

# All lanes, also behind a red one; the last line of its output sums them up.
test-all: $(VENV)/tools
	@$(BIN)/python .ci/lanes $(MAKE) test test-long

# The rest alone.
test-long: kernels
	@$(call tested,6,--durations 50 -m "not ($(SHORT))" $(ARGS))

# The folders of the robot wing in tests/support/wings.py.
test-robot: kernels
	@$(call tested,6,$$($(BIN)/python -m tests.support.wings) $(ARGS))

# The tests marked `evidence` and all examples of the property tests, then every table that is old.
evidence: $(VENV)/tools
	@$(BIN)/python -m pytest -n $(or $(JOBS),6) --dist loadfile -m "evidence or hypothesis" \
	  --hypothesis-profile evidence --timeout 3600 $(ARGS)
	@$(MAKE) --no-print-directory ARGS= night

# Every job whose sources have changed since its results were made; the same command resumes.
# ARGS=--plan shows the jobs, ARGS="paper learning" makes these, ARGS="--shard 1/4" a fourth of all.
night: kernels
	@$(BIN)/python -m studies.night $(ARGS)

# Every sequence up to a length, judged by the rules of docs/evidence/motion.md; the same command resumes.
# ARGS="robot events --depth 5" goes further, for some CPU-hours.
sequences: kernels
	@$(BIN)/python -m tests.sequences $(ARGS)

# The ledger of behaviours, which `make test` compares; a minute. ARGS="--against REV" says by how much
# robots drive otherwise than in a commit, ARGS=--check which ones drive otherwise than the ledger says.
behaviour: kernels
	@$(BIN)/python -m studies.behaviour $(ARGS)

# The short forms of all patterns, by which `make test-all` shows that a table is old; some minutes.
short-forms: kernels
	@$(BIN)/python -m studies.outcomes --keep-short $(ARGS)

# DONE=wheel leaves out what was checked before, as .ci/run does.
check: $(filter-out $(DONE),static docs wheel bringup)

static: $(VENV)/tools
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# Without isolation: the installation of the tools has built swarmd with what pyproject.toml names.
wheel: $(VENV)/tools
	.ci/try-wheel $(BIN)/python

# The ROS 2 package of drivers/swarmd_bringup.
bringup: $(VENV)/tools
	.ci/try-bringup $(BIN)/python

# A warning, such as a link that leads nowhere, is an error. All pages are read again, since a change of
# one may break links of others.
docs: $(VENV)/docs
	$(BIN)/sphinx-build -q --fail-on-warning --keep-going --fresh-env -c docs -d build/doctrees . build/site

# From plugins, YAML files, schemas, command lines and docstrings. Git has the short parts, which a test
# compares with the code.
reference: $(VENV)/tools
	@PYTHONPATH=. $(BIN)/python docs/site/reference.py

# A test compares the file with the code, so the diff of a change shows the names that it takes away.
names: $(VENV)/tools
	@PYTHONPATH=. $(BIN)/python docs/site/reference.py --names

format: $(VENV)/tools
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/tools
	@$(BIN)/python -m benchmarks $(ARGS)

# Debian 12 by qemu-user, in build/arm64.
arm64: $(VENV)/tools
	@.ci/try-arm64 $(BIN)/python $(ARGS)

# Every row of the budgets in three minutes.
budget: $(VENV)/tools
	@$(BIN)/python -m benchmarks.budget

# Needs no quiet machine. The first comparison with a commit builds it: two CPU-minutes.
instructions: kernels
	@$(BIN)/python -m benchmarks.instructions $(ARGS)

# Every verb at 28 pairs of delay and loss, then the long tests of splits, storms and flapping, in
# network namespaces. ARGS="--rtt 200 500 --loss 0 --json answers.jsonl" picks cells of the matrix.
network: $(VENV)/tools
	@$(COMPILE) tests
	@$(BIN)/python -m benchmarks.network_matrix $(ARGS)
	@$(BIN)/python -m pytest -m evidence --timeout 3600 tests/network_faults

network-scale: $(VENV)/tools
	@$(COMPILE) tests
	@$(BIN)/python -m benchmarks.network_scale $(ARGS)

# A short film of each pattern, in build/films; ARGS=patterns replaces those of the pages.
films: $(VENV)/tools
	@$(BIN)/python -m studies.films $(ARGS)

$(VENV)/made:
	@command -v $(PYTHON) >/dev/null || { echo \
	  "no $(PYTHON) here; swarmd needs Python 3.11 or newer, try: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo \
	  "$(PYTHON) is $$($(PYTHON) -V 2>&1); swarmd needs 3.11 or newer, try: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo \
	  "$(PYTHON) cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	@rm -rf $(VENV)
	@echo "Making $(VENV) with $$($(PYTHON) -V); this happens once."
	@$(call timed,environment,$(PYTHON) -m venv $(VENV))
	@touch $@

# What a simulated swarm needs. editable_mode=compat: the folder in a .pth; the finder of setuptools
# takes 16 ms of each start. CPython runs the kernels, and compiles what it imports.
$(VENV)/interpreted: $(VENV)/made pyproject.toml setup.py constraints.txt
	@echo "Installing swarmd into $(VENV), with the packages that a simulated swarm needs."
	@rm -rf swarmd.egg-info  # of an earlier wheel: its entry points would hide those of this checkout
	@$(call install,packages,project.dependencies project.optional-dependencies.sim,setuptools)
	@$(call timed,swarmd,SWARMD_COMPILED=0 $(PIP) install --no-compile --no-deps --no-build-isolation --config-settings editable_mode=compat --editable .)
	@touch $@

$(VENV)/installed: $(VENV)/interpreted
	@$(LOCKED) $(REST) $(VENV)/complete
	@touch $@

# The kernels are compiled while packages are downloaded. The shell lets a program in the background
# ignore Ctrl-C.
$(VENV)/complete: $(VENV)/interpreted
	@echo "Installing the rest: the kernels, and packages that draw, film, record and serve pages."
	@$(call install,tools that build it,build-system.requires)
	@$(BIN)/python setup.py --quiet build_ext --inplace >$(VENV)/kernels.log 2>&1 & trap "kill $$!" INT TERM; \
	  $(call install,packages that draw and record,$(addprefix project.optional-dependencies.,plot web record) $(BESIDE)); \
	  status=$$?; $(COMPILE_PACKAGES); \
	  kill -0 $$! 2>/dev/null && echo "  kernels: the compiler is at work"; wait; exit $$status
	@$(COMPILE)
	@touch $@

# Built in the cache, so that Cargo.lock and what is compiled serve every checkout.
# $(call build_router,TOOLS,PACKAGES,OPTIONS)
define build_router
	@for tool in $(1); do command -v $$tool >/dev/null || { echo \
	  "no $$tool here; $@ needs cargo, as rustup installs it, and on Debian: apt install $(2)" >&2; exit 1; }; done
	@mkdir -p $(ROUTER)/src $(ROUTER)/example/src
	@for file in Cargo.toml src/main.rs; do \
	  cmp -s tests/support/zenoh_router/$$file $(ROUTER)/$$file || cp tests/support/zenoh_router/$$file $(ROUTER)/$$file; \
	  cmp -s examples/zenoh/rust/$$file $(ROUTER)/example/$$file || cp examples/zenoh/rust/$$file $(ROUTER)/example/$$file; done
	@cargo build --quiet --manifest-path $(ROUTER)/Cargo.toml --target-dir $(ROUTER)/target $(3)
endef
# The whole program is put in place at once, since tests may be using the one before.
# $(call put_program,BUILT,NAME)
put_program = @cmp -s $(ROUTER)/target/$(1) $(ROUTER)/$(2) || \
	  { cp $(ROUTER)/target/$(1) $(ROUTER)/new && mv $(ROUTER)/new $(ROUTER)/$(2); }

ros2-router:
	$(call build_router,cargo cmake c++,cmake g++ libclang-dev,--release --features ros2dds)
	$(call put_program,release/zenoh-router,ros2-router)

# Not optimized, and without TLS: five minutes of processor time at first, on a busy machine.
zenohd:
	$(call build_router,cargo cc,gcc,--workspace --features zenohd)
	$(call put_program,debug/zenoh-swarm,zenoh-swarm)
	$(call put_program,debug/zenoh-router,zenohd)

$(VENV)/tools: $(VENV)/installed
	@echo "Installing the tools for tests and checks."
	@$(call install,tools,dependency-groups.dev) && $(COMPILE_PACKAGES)
	@touch $@

$(VENV)/docs: $(VENV)/tools
	@echo "Installing the tools for the site."
	@$(call install,tools,dependency-groups.docs) && $(COMPILE_PACKAGES)
	@touch $@

# The newest versions that fit the oldest Python of a supported system, Debian 12's, in a fresh
# environment; run the checks before committing them.
lock:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:3] != (3, 11, 2))' || { echo \
	  "make lock: $(PYTHON) is $$($(PYTHON) -V 2>&1); it must be 3.11.2 of Debian 12, try: make lock PYTHON=/usr/bin/python3" >&2; exit 1; }
	rm -rf build/lock && $(PYTHON) -m venv build/lock
	build/lock/bin/pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	build/lock/bin/pip install --quiet --disable-pip-version-check '.[sim,plot]' --group dev --group docs
	sed -n '/^#/p' constraints.txt > build/constraints.txt
	build/lock/bin/pip freeze | grep -v '^swarmd' >> build/constraints.txt
	mv build/constraints.txt constraints.txt

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find swarmd patterns drivers sim config tests benchmarks studies examples -name __pycache__ -type d -prune -exec rm -rf {} +
