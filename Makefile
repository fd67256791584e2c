# make demo   fly a simulated flight with the real bridge, and draw it; installs what it needs into .venv
# make venv   install all commands with all that they may need into .venv: also laboratory, logs, web page, several processes
# make test   run the quick tests (3 to 5 minutes on two processors)
# make test-all   run all tests: also more cases, statistics, long waits, and tests of the tests' own tools
# make check  what CI runs: format, lint, types, layers, then all tests
# make docs   build the site of the documents into build/site/html; a broken link or a missing page fails
# make test-install  install on Debians with a real systemd, break, upgrade and remove it (as root; 10 to 20 minutes)
# make lock   renew requirements*.lock, the versions and hashes of what install.sh and a release install
# make release  sdist, wheel, Debian packages, container images and list of packages, into build/release (as root)
# make stored  keep files of this version for later versions' tests, in tests/stored
# make bench  run all benchmarks, and write the table in docs/figures.md; ONLY='start page' runs these and writes nothing
# make arm64  count the instructions of the bridge on an emulated arm64 computer, and write them in docs/figures.md
# make fuzz   feed damaged files and link bytes to every reader, SECONDS=600 per area by SEED=1; failures are kept in build/fuzz
# make gap-demo  hide five effects in simulated flights and find them
# make blind  hide effects in N=200 tables by SEED=1, let the gap workflow find them, write its scores to docs/figures.md
# make second hide effects in N tables of each kind by a second generator, by SEED=1, and score the gap workflow
# make others fly N=200 cases of eight flights with an effect on one of four sensors, by SEED=1; the truth is hidden
# make soak   fly HOURS=24 simulated hours with random faults and MINUTES=20 real ones on a busy computer, into docs/soak.md
# make faults fly FLIGHTS=700 simulated flights with faults, judged by what the autopilot receives (10 minutes)
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo venv gap-demo docs test test-all test-install lint check lock release stored bench arm64 fuzz blind second others faults soak mavproxy compile clean
.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help
help:
	@sed -n 's/^# make/make/p' Makefile

demo: .venv/.installed-demo compile
	$(BIN)/msp-sim fly configs/scenarios/demo.yaml --out flights/demo --force --speed 12

venv: .venv/.installed compile

# Tests are rewritten for pytest before they run, which takes a process 8 s unless their bytecode is kept.
unexport PYTHONDONTWRITEBYTECODE

# tests/conftest.py says how many processes, and what may run at the same time.
PYTEST := $(BIN)/python -m pytest --numprocesses auto

test: .venv/.installed-test compile mavproxy
	$(PYTEST) -m "not slow"

test-all: .venv/.installed-test compile mavproxy
	$(PYTEST)

test-install: .venv/.installed-test
	$(BIN)/python -m evaluation install
	$(BIN)/python -m evaluation package

docs: .venv/.installed-test
	$(BIN)/python docs/site/build.py

lint: .venv/.installed-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint
	$(MAKE) test-all

# What the service needs, and what its package is built with; the newest versions that go together. Then what the extra
# that an airframe may need adds to these (msp_range/extras.py).
lock: .venv/.installed-test
	echo 'setuptools>=77' | PATH="$$PATH:$(BIN)" uv pip compile pyproject.toml - --extra web --universal --python-version 3.11 \
		--only-binary :all: --no-emit-package colorama --generate-hashes --upgrade --quiet --no-annotate \
		--custom-compile-command 'make lock' --output-file requirements.lock
	PATH="$$PATH:$(BIN)" uv pip compile pyproject.toml --extra kalman --universal --python-version 3.11 \
		--only-binary :all: --generate-hashes --upgrade --quiet --no-annotate --constraint requirements.lock \
		$$(sed -n 's/^\([a-z0-9.-]*\)==.*/--no-emit-package \1/p' requirements.lock) --no-emit-package colorama \
		--custom-compile-command 'make lock' --output-file requirements-kalman.lock

release: .venv/.installed-test
	$(BIN)/python -m release

stored: .venv/.installed-test
	$(BIN)/python -m release.stored

bench: .venv/.installed-test compile
	$(BIN)/python -m evaluation bench $(ONLY)

arm64: .venv/.installed-test
	$(BIN)/python -m evaluation arm64 --write

SEED ?= 1
SECONDS ?= 600
fuzz: .venv/.installed-test compile
	$(BIN)/python -m evaluation fuzz --seconds $(SECONDS) --seed $(SEED)

N ?= 200
gap-demo: .venv/.installed
	$(BIN)/msp-lab demo --out flights/gap-demo --force

blind: .venv/.installed-test compile
	$(BIN)/python -m evaluation blind --out build/blind-$(SEED)-$(N) --count $(N) --seed $(SEED) --figures docs/figures.md

second: .venv/.installed-test compile
	$(BIN)/python -m evaluation second_hand $(if $(KINDS),--kinds $(KINDS)) --cases $(N) --seed $(SEED) --jobs 2 --out build/second-$(SEED)

others: .venv/.installed-test compile
	$(BIN)/python -m evaluation others --out build/others-$(SEED) --cases $(N) --nulls $$(( ($(N) + 3) / 4 )) --seed $(SEED)

FLIGHTS ?= 700
faults: .venv/.installed-test compile
	$(BIN)/python -m evaluation faults --flights $(FLIGHTS) --seed $(SEED) --out build/faults

# With the memory allocator as the service has it.
HOURS ?= 24
MINUTES ?= 20
soak: .venv/.installed-test compile
	env $$(sed -n 's/^Environment=//p' systemd/msp-range.service) $(BIN)/python -m evaluation soak --hours $(HOURS) --minutes $(MINUTES) --seed $(SEED) --write docs/soak.md

# Bytecode is made here, so that starts are quick also where PYTHONDONTWRITEBYTECODE is set.
compile: .venv/.installed-demo
	@$(BIN)/python -m compileall -q msp_range sim

.venv/bin/python:
	@command -v git >/dev/null || { echo "git is missing: apt install git"; exit 1; }
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: apt install python3"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or later is needed; found $$($(PYTHON) --version). Name another one: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.maxsize < 2**32)' || { echo "a 64-bit Python is needed"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "venv is missing: apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv .venv

# What is installed: each list holds the one before. The bytecode of the demo's packages is made where they are imported.
DEMO := sim,kalman
USERS := $(DEMO),lab,logs,web,fleet
TESTS := $(USERS),docs,test,bench
COMPILE := $(BIN)/python -m compileall -qq -j 0 -x /tests/ .venv/lib || true

# uv takes 8 s where pip takes 50. It does not know pip's configuration, so pip is next where uv finds no packages.
define install
@echo "Installing $(2) into .venv, in silence: $(3)."
@PATH="$$PATH:$(BIN)"; { command -v uv >/dev/null && uv pip install --quiet --python $(BIN)/python --editable '.[$(1)]'; } || \
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[$(1)]'
endef

.venv/.installed-demo: pyproject.toml | .venv/bin/python
	$(call install,$(DEMO),what the simulator needs,up to a minute)
	@touch $@

# Not all files of packages are for this version of Python, and compile.
.venv/.installed: pyproject.toml | .venv/bin/python
	$(call install,$(USERS),all commands,a minute or two)
	@$(COMPILE)
	@touch .venv/.installed-demo $@

.venv/.installed-test: pyproject.toml | .venv/bin/python
	@command -v uv >/dev/null || $(BIN)/python -m pip install --quiet uv
	$(call install,$(TESTS),all commands and what tests need,two minutes)
	@$(COMPILE)
	@touch .venv/.installed-demo .venv/.installed $@

# MAVProxy in an environment of its own, for the tests: it wants packages that the bridge does not.
mavproxy: .venv/.installed-test
	@$(BIN)/python tests/peers/mavproxy_env.py

clean:
	rm -rf .venv .venv-mavproxy build flights
