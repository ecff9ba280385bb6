# SPDX-License-Identifier: Apache-2.0
# One command each; `make help` lists them.
SHELL := /bin/bash
PYTHON ?= $(shell command -v python3.12 || command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
SRC := ros2_ws/src
SEED ?= 1
STAMP := $(VENV)/.setup

.DEFAULT_GOAL := help
.PHONY: help setup model demo cell test lint bench docs lock test-ros2 clean

help:  ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 14

setup: $(STAMP)  ## everything the suite needs, into .venv (system packages through apt when allowed)

$(STAMP): requirements.lock embedded/pyproject.toml $(wildcard $(SRC)/*/setup.cfg $(SRC)/*/package.xml) .ci/setup.sh
	@PYTHON=$(PYTHON) VENV=$(VENV) bash .ci/setup.sh
	@touch $@

model:  ## rebuild the C++ cores
	flock /tmp/softgrip-model-build.lock $(BIN)/pip install -q --no-deps --no-build-isolation -e $(SRC)/softgrip_model

lint: setup  ## ruff and mypy, strict
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy embedded ros2_ws/src

clean:  ## remove what was built
	rm -rf out build $(SRC)/softgrip_model/build .mypy_cache .ruff_cache
