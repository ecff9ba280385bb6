#!/usr/bin/env bash
# Installs the Python packages of REQUIREMENTS into VENV, what comes as sources and MediaPipe; .ci/setup.sh runs it beside the compiler.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/stage.sh

pip install --no-deps --require-hashes --only-binary :all: -r "$REQUIREMENTS"
pip install --no-deps --no-build-isolation --require-hashes -r requirements-sources.lock
# its own pins are older than they need to be, so without them
pip install --no-deps --require-hashes --only-binary :all: -r requirements-capture.lock ||
  echo "   no MediaPipe for this machine: ros2 run softgrip_design capture will say so"
