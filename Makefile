# SPDX-License-Identifier: Apache-2.0
# One command each; `make help` lists them.
SHELL := /bin/bash
PYTHON ?= $(shell command -v python3.12 || command -v python3.11 || command -v python3)
# LOCK=oldest: the versions that Ubuntu 24.04 has, in an environment of their own
LOCK ?= newest
VENV := $(if $(filter oldest,$(LOCK)),.venv-oldest,.venv)
REQUIREMENTS := $(if $(filter oldest,$(LOCK)),requirements-oldest.lock,requirements.lock)
BIN := $(VENV)/bin
# the environments would compile all of each other's cores again in one folder
BUILD := SKBUILD_BUILD_DIR='build/$(filter oldest,$(LOCK))/{wheel_tag}'
SRC := ros2_ws/src
TYPED := rclpy ament_index_python embedded_ros $(filter-out softgrip_bringup softgrip_cmake softgrip_interfaces softgrip_mcap_vendor,$(notdir $(wildcard $(SRC)/*)))
VENDORED := $(SRC)/softgrip_mcap_vendor
UV_LOCK := $(BIN)/uv pip compile -q --universal --python-version 3.11 --no-header --no-annotate --generate-hashes
SEED ?= 1
OUT ?= out
STAMP := $(VENV)/.setup
# what only some need, each with a lock of its own: requirements-<name>.lock
EXTRAS := parts study docs panel rerun s3
CORES := softgrip_model softgrip_emulator softgrip_vision
CPP = $(shell find $(CORES:%=$(SRC)/%/include) $(CORES:%=$(SRC)/%/src) $(wildcard $(SRC)/*/test/cpp) -name '*.[ch]pp')
#: cores that make lint has clang-tidy look at. softgrip_model takes three minutes more on a clean checkout, and a change of one
#: header there is a change of all its sources: `make tidy` looks at all three
TIDY_CORES := softgrip_emulator softgrip_vision
WITH_VENV := PATH="$(CURDIR)/$(BIN):$$PATH"
# Hundreds of processes import the same sources; where Python may keep no byte code each compiles them again, half of its start.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup $(EXTRAS:%=%-setup) cores model plant tracker cpp-tests long-tests tidy format demo cell test lint faults soak fuzz crash bench docs calculix site docs-test lock mutants sbom audit keys udev test-ros2 clean

help:  ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 14

setup: $(STAMP) $(CORES:%=$(VENV)/.core-of-%)  ## everything the suite needs, into .venv (system packages through apt when allowed)
	@$(if $(filter setup,$(MAKECMDGOALS)),echo "Ready in $(VENV). Next: make demo; for commands of your own: source $(VENV)/bin/activate",:)

$(STAMP): $(REQUIREMENTS) requirements-capture.lock requirements-sources.lock embedded/pyproject.toml $(wildcard $(SRC)/*/setup.cfg $(SRC)/*/package.xml) .ci/setup.sh .ci/packages.sh
	@echo "Setting $(VENV) up: the first time 3 to 9 minutes, most of it compiling"
	@PYTHON=$(PYTHON) VENV=$(VENV) REQUIREMENTS=$(REQUIREMENTS) $(BUILD) bash .ci/setup.sh
	@touch $@

parts-setup:  ## build123d and what else makes parts to print of a profile (docs/parts.md), 660 MB
study-setup:  ## Dask for `sweep` and Gymnasium for softgrip_gym (docs/virtual.md)
docs-setup:  ## Sphinx and what else makes the documentation's site, 40 MB
rerun-setup:  ## rerun-sdk for `export --rerun` (docs/archive.md), 500 MB
s3-setup:  ## s3fs for archives in S3 (docs/archive.md), and moto, the server that tests ask
panel-setup:  ## NiceGUI and what else makes the operator's page (docs/panel.md), 90 MB; chromium for its tests where apt may

$(EXTRAS:%=%-setup): %-setup: $(VENV)/.%

# set-up installs its own versions again, and an extra may want a newer one
$(EXTRAS:%=$(VENV)/.%): $(VENV)/.%: requirements-%.lock $(STAMP) | setup
	@. .ci/stage.sh; stage "Python packages of $<" \
	  $(BIN)/python -m pip --disable-pip-version-check install -q --no-deps --require-hashes --only-binary :all: -r $<
	@touch $@

panel-setup: $(VENV)/.browser

$(VENV)/.browser: .ci/browser.sh | setup
	@bash .ci/browser.sh
	@touch $@

cores: model plant tracker  ## rebuild the C++ cores

# softgrip_model's, the emulator's plant and the marker tracker
model: core-of-softgrip_model
plant: core-of-softgrip_emulator
tracker: core-of-softgrip_vision
core-of-%:
	@$(BUILD) VENV=$(VENV) bash .ci/core.sh $*

# set-up has built the cores as they were then
.SECONDEXPANSION:
$(VENV)/.core-of-%: $$(shell find $(SRC)/$$*/src $(SRC)/$$*/include $(SRC)/$$*/CMakeLists.txt $(SRC)/softgrip_cmake/cmake -type f) | $(STAMP)
	@if [ -e $@ ]; then echo "== the C++ of $* has changed"; $(MAKE) core-of-$*; fi
	@touch $@

# unit tests of the C++ cores: built apart from the cores, without Python
cpp-tests: setup $(addprefix cpp-tests-of-,softgrip_model softgrip_emulator)  ## unit tests of the C++ cores

cpp-tests-of-%: | $(STAMP)
	@$(WITH_VENV) cmake -S $(SRC)/$* -B $(OUT)/cpp/$* -G Ninja -DSOFTGRIP_TESTS_ONLY=ON >/dev/null
	@$(WITH_VENV) MAKEFLAGS= cmake --build $(OUT)/cpp/$*  # ninja would ask make for leave to run, by files that are closed to it
	@$(WITH_VENV) ctest --test-dir $(OUT)/cpp/$* --output-on-failure

demo: setup $(VENV)/.panel  ## one shift of the emulated cell, its table, page and summary in out/demo; SEED=2 for another cell, ARGS="speed:=1.0" in real time
	@$(WITH_VENV) python tools/demo.py $(OUT)/demo --seed $(SEED) $(ARGS)

cell: setup $(VENV)/.panel  ## the emulated cell in real time, until Ctrl-C
	@mkdir -p $(OUT)/cell
	@$(WITH_VENV) ros2 launch softgrip_bringup cell.launch.yaml out:=$(OUT)/cell seed:=$(SEED)

# pytest-xdist 3.8 waits for ever, with loadfile, for the tests of a process that crashed if another takes its place
SIDE_BY_SIDE := --dist loadfile --max-worker-restart 0
# Tests that run in real time (a whole cell, the drives' nodes): two at a time, and nothing beside them.
REAL_TIME := tests/system tests/faults $(SRC)/softgrip_driver/test/real_time

test: setup parts-setup study-setup panel-setup s3-setup  ## lint, then every test; LOCK=oldest with the oldest versions that are supported
	$(MAKE) -j 2 $(if $(filter oldest,$(LOCK)),,lint) cpp-tests
	$(BIN)/python -m pytest -n 4 $(SIDE_BY_SIDE) -m "not long" $(addprefix --ignore ,$(REAL_TIME))
	$(BIN)/python -m pytest -n 2 $(SIDE_BY_SIDE) -m "not long" $(REAL_TIME)

long-tests: setup study-setup panel-setup rerun-setup  ## whole ways and one case more (boxes to first grasp, a shift by clicks, other drives, all roles, fifty bags, wheels, Rerun's own reader); minutes
	$(BIN)/python -m pytest -m long
	$(BIN)/python -m pytest tests/replay/test_rerun_file.py

lint: setup  ## ruff and mypy, strict; clang-format, clang-tidy of two cores; the documentation with every link and name
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@echo "clang-format of the C++"; $(BIN)/clang-format --dry-run --Werror $(CPP)
	@if [ -x $(BIN)/clang-tidy ]; then echo "clang-tidy of what changed"; $(WITH_VENV) python tools/tidy.py $(TIDY_CORES); fi
	$(BIN)/python tools/vocabulary.py
	$(BIN)/python tools/pages/links.py
	$(MAKE) site
	$(BIN)/python tools/message_stubs.py $(OUT)/stubs
	MYPYPATH=$(OUT)/stubs $(BIN)/mypy $(foreach package,$(TYPED),-p $(package))

format: setup  ## format Python and C++
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(CPP)

tidy: setup  ## clang-tidy on what changed in the C++ cores since it passed; the first time some minutes
	@$(WITH_VENV) python tools/tidy.py

clean:  ## remove what was built
	rm -rf out build docs/reference/generated $(SRC)/*/build .mypy_cache .ruff_cache

faults: setup  ## every fault of the drives with its time to safe, every process killed and frozen; on an otherwise idle machine
	SOFTGRIP_QUIET_MACHINE=1 $(BIN)/python -m pytest -q -n0 $(SRC)/softgrip_driver/test/test_fault_matrix.py \
	  $(SRC)/softgrip_driver/test/test_backend_contract.py tests/faults tests/system/test_many_cells.py
	SOFTGRIP_EVERY_PROCESS=1 $(BIN)/python -m pytest -q -n0 -s tests/system/test_process_faults.py

soak: setup  ## ten minutes of random faults
	SOFTGRIP_SOAK_SECONDS=600 $(BIN)/python -m pytest -q -n0 $(SRC)/softgrip_driver/test/real_time/test_soak.py

FUZZ_SECONDS ?= 60

fuzz: setup  ## bytes into every parser: atheris on both ends of the wires, 100,000 mutated streams, 100,000 of hypothesis on each
	$(BIN)/python tools/fuzz.py emulator --seconds $(FUZZ_SECONDS)
	$(BIN)/python tools/fuzz.py driver --seconds $(FUZZ_SECONDS)
	$(BIN)/python tools/fuzz.py emulator --streams 100000
	$(BIN)/python tools/fuzz.py driver --streams 100000
	SOFTGRIP_FUZZ_EXAMPLES=100000 $(BIN)/python -m pytest -q -n 2 --timeout 7200 $(SRC)/softgrip_driver/test/test_protocol.py \
	  $(SRC)/softgrip_emulator/test/test_fuzz.py -k "no_stream_breaks or any_bytes_in_any_pieces"

mutants: setup  ## deliberate errors that tests must notice, score by area; AREA=guards one area, ARGS=--check the list only
	$(BIN)/python tools/mutants $(if $(AREA),--area $(AREA)) $(ARGS)

crash: setup  ## the recorder killed a hundred times, its file cut a hundred times, every call of its writer failed once
	SOFTGRIP_EVERY_CALL=1 $(BIN)/python -m pytest -q -n0 $(SRC)/softgrip_bag/test/test_every_call_fails.py
	$(BIN)/python benchmarks/bag/recorder_crash.py

bench: setup parts-setup study-setup panel-setup  ## every benchmark, one JSON line a claim, into out/bench.jsonl and a picture
	@mkdir -p $(OUT)
	$(BIN)/python benchmarks/run_all.py $(OUT)/bench.jsonl

# scripts of tools/docs that ask CalculiX
SOLVED := gdfe_cable_calculix gdfe_finger_calculix gdfe_redesign parts_calculix

docs: setup parts-setup study-setup docs-setup  ## write the documents that scripts make, then the site into out/site
	@for script in $(filter-out $(SOLVED:%=tools/docs/%.py),$(wildcard tools/docs/*.py)); do echo "== $$script"; $(BIN)/python $$script || exit 1; done
	$(MAKE) site

calculix: setup parts-setup  ## solve again what CalculiX solved: recorded references and tables of docs/gdfe.md and docs/parts.md; wants ccx and gmsh, an hour
	@{ command -v ccx && command -v gmsh; } >/dev/null || { echo "expected ccx and gmsh on the PATH: apt-get install calculix-ccx gmsh"; exit 1; }
	@for script in $(SOLVED:%=tools/docs/%.py); do echo "== $$script"; $(BIN)/python $$script || exit 1; done

site: setup docs-setup study-setup panel-setup  ## the documentation's site alone, into out/site; a warning is an error
	@. .ci/stage.sh; stage "the reference, from the code" $(BIN)/python tools/docs/reference.py
	@echo "== the pages"
	$(BIN)/python -m sphinx -W --keep-going -c docs -d $(OUT)/site-trees . $(OUT)/site
	@echo "$(OUT)/site/index.html"

docs-test: setup $(EXTRAS:%=%-setup)  ## every code block of every page, also the long ones; then the site
	SOFTGRIP_LONG_BLOCKS=1 $(BIN)/python -m pytest -q -n0 tests/documents
	$(MAKE) site

lock:  ## write the locks again, with the hash of every file that may be installed
	$(BIN)/python -m pip install -q uv
	$(UV_LOCK) requirements.in -o requirements.lock
	$(UV_LOCK) requirements-oldest.in -o requirements-oldest.lock
	$(UV_LOCK) --no-deps -c requirements.lock $(VENDORED)/requirements.in -o $(VENDORED)/requirements.lock
	for extra in capture sources $(EXTRAS); do $(UV_LOCK) --no-deps requirements-$$extra.in -o requirements-$$extra.lock || exit 1; done

sbom: setup  ## what the suite is made of, as CycloneDX, into out/sbom.json
	@mkdir -p $(OUT)
	$(BIN)/python tools/sbom.py $(OUT)/sbom.json

audit: setup  ## known holes in what the locks name, where a package index can be reached
	$(BIN)/python tools/audit.py

KEYS ?= $(HOME)/.softgrip/keys

keys: setup  ## the cell's keys, where there are none, for secure:=true; KEYS=folder ARGS="--rotate"
	@$(WITH_VENV) ros2 run softgrip_security keys $(KEYS) $(ARGS)

UDEV_RULES := /etc/udev/rules.d
# what name_ports has written
UDEV_NAMES ?= 61-softgrip-names.rules
SUDO := $(if $(filter 0,$(shell id -u)),,sudo)

udev:  ## the rules for a bench's serial ports, into /etc/udev/rules.d: latency of USB adapters, rights, and the names that name_ports wrote (UDEV_NAMES=file)
	$(SUDO) install -D -m 644 $(SRC)/softgrip_driver/udev/60-softgrip.rules $(UDEV_RULES)/60-softgrip.rules
	@if [ -e $(UDEV_NAMES) ]; then $(SUDO) install -D -m 644 $(UDEV_NAMES) $(UDEV_RULES)/61-softgrip-names.rules; fi
	@if udevadm verify --help >/dev/null 2>&1; then udevadm verify $(UDEV_RULES)/6[01]-softgrip*.rules; fi  # systemd 254 and later
	@if udevadm control --ping 2>/dev/null; then $(SUDO) udevadm control --reload && $(SUDO) udevadm trigger; \
	else echo "udev does not run here: plug the adapters in again once it does"; fi

test-ros2:  ## on a sourced ROS 2 Jazzy: colcon build, then the tests of all packages and of tests/ on the real rclpy
	@test -n "$$ROS_DISTRO" || { echo "Source a ROS 2 Jazzy first: source /opt/ros/jazzy/setup.bash"; exit 1; }
	cd ros2_ws && colcon build --merge-install --cmake-args -DCMAKE_BUILD_TYPE=Release
	source ros2_ws/install/setup.bash && python3 -m pytest -m "not long" $(addprefix --ignore ,$(REAL_TIME)) $(SRC) tests
	source ros2_ws/install/setup.bash && python3 -m pytest -m "not long" $(REAL_TIME)
