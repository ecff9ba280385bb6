#!/usr/bin/env bash
# Compiles the C++ core of a package into VENV: `VENV=.venv bash .ci/core.sh softgrip_model`. One build of an environment at a time.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/stage.sh
: "${VENV:=.venv}"

exec {lock}>"$VENV/.building"
if ! flock -n "$lock"; then
  echo "== waiting: another build into $VENV goes on"
  flock "$lock"
fi
stage "compiling the C++ of $1 (from nothing: minutes)" \
  pip install --no-deps --no-build-isolation -e "ros2_ws/src/$1"
