#!/usr/bin/env bash
# Sets the suite up on a fresh Debian 12 or Ubuntu 24.04; `make setup` calls it with PYTHON, VENV and REQUIREMENTS set.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/stage.sh
: "${PYTHON:=python3}" "${VENV:=.venv}" "${REQUIREMENTS:=requirements.lock}"

packages=(g++ git libeigen3-dev python3-dev python3-venv)
[ -r .ci/packages.txt ] && mapfile -t packages < <(grep -vE '^\s*(#|$)' .ci/packages.txt | sed 's/ *#.*//')

missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
  sudo=()
  if [ "$(id -u)" -ne 0 ]; then sudo=(sudo -n); fi
  line="apt-get install -y --no-install-recommends ${missing[*]}"
  if ! command -v apt-get >/dev/null || ! { [ "$(id -u)" -eq 0 ] || sudo -n true 2>/dev/null; }; then
    echo "Some system packages are missing and this user may not install them. Type this once, then try again:" >&2
    echo "    sudo apt-get update && sudo $line" >&2
    exit 1
  fi
  apt() { DEBIAN_FRONTEND=noninteractive "${sudo[@]}" "$@" >/dev/null; }
  stage "system packages: what there is" apt apt-get update -q -y
  stage "system packages: ${missing[*]}" apt $line -q
fi

# The interpreter: any CPython 3.11 or 3.12 that can compile an extension.
usable() {
  command -v "$1" >/dev/null && "$1" - <<'PY' 2>/dev/null
import pathlib, sys, sysconfig, venv, ensurepip
ok = (3, 11) <= sys.version_info[:2] <= (3, 12) and (pathlib.Path(sysconfig.get_paths()["include"]) / "Python.h").exists()
sys.exit(0 if ok else 1)
PY
}
for candidate in "$PYTHON" python3.12 python3.11 /usr/bin/python3 /usr/bin/python3.11 /usr/bin/python3.12; do
  if usable "$candidate"; then python=$candidate; break; fi
done
if [ -z "${python:-}" ]; then
  echo "Expected Python 3.11 or 3.12 with its headers, found $($PYTHON --version 2>&1). Install python3.12 and python3.12-dev, or call make with PYTHON=..." >&2
  exit 1
fi

if [ ! -x "$VENV/bin/python" ]; then
  stage "virtual environment with $("$python" --version)" "$python" -m venv "$VENV"
fi
# What compiles the cores comes first; all else is fetched and unpacked while they are compiled.
tools="$VENV/compiling.lock"
awk '/^[a-z]/ { is_tool = /^(cmake|ninja|packaging|pathspec|pybind11|scikit-build-core|setuptools)==/ } is_tool' "$REQUIREMENTS" >"$tools"
stage "Python packages that compiling takes" pip install --no-deps --require-hashes --only-binary :all: -r "$tools"
log="$VENV/packages.log"
VENV=$VENV REQUIREMENTS=$REQUIREMENTS setsid bash .ci/packages.sh >"$log" 2>&1 &
packages=$!
trap 'kill -- "-$packages" "$packages" 2>/dev/null || true' EXIT
for package in softgrip_model softgrip_emulator softgrip_vision; do
  bash .ci/core.sh "$package"
done
stage "Python packages of $REQUIREMENTS (begun before)" wait "$packages" || { cat "$log" >&2; exit 1; }
cat "$log"
stage "the stand-in for ROS 2" pip install --no-deps --no-build-isolation -e embedded
stage "this workspace" "$VENV/bin/python" -m embedded_ros.workspace ros2_ws/src
echo "== set up in $SECONDS s"
