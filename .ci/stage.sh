# SPDX-License-Identifier: Apache-2.0
# Sourced: `stage LABEL COMMAND...` says what is done, every 20 s how long it has taken so far, and at the end how long it took.
# `pip ...` is that of VENV.

stage() {
  local label=$1 since=$SECONDS code=0 clock never
  shift
  echo "== $label"
  exec {never}<> <(:) # a pipe that nobody writes to: `read` waits at it without a process of its own
  (while ! read -r -t 20 -u "$never" _; do echo "   still at it after $((SECONDS - since)) s"; done) &
  clock=$!
  "$@" || code=$?
  kill "$clock" 2>/dev/null || true
  wait "$clock" 2>/dev/null || true
  exec {never}>&-
  if [ "$code" -eq 0 ]; then echo "   done in $((SECONDS - since)) s"; else echo "   failed after $((SECONDS - since)) s" >&2; fi
  return "$code"
}

pip() { "$VENV/bin/python" -m pip --disable-pip-version-check -q "$@"; }
