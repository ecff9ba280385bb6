#!/usr/bin/env bash
# The browser that the panel's tests open (Debian: chromium; elsewhere one of its names on the PATH). `make panel-setup` calls it.
set -euo pipefail
find_one() { for name in "$@"; do command -v "$name" >/dev/null && return 0; done; return 1; }
if find_one chromium chromium-browser google-chrome && find_one chromedriver chromium.chromedriver; then exit 0; fi
sudo=()
if [ "$(id -u)" -ne 0 ]; then sudo=(sudo -n); fi
if command -v apt-get >/dev/null && { [ "$(id -u)" -eq 0 ] || sudo -n true 2>/dev/null; }; then
  echo "== system packages: chromium chromium-driver (for the tests of the operator's page)"
  DEBIAN_FRONTEND=noninteractive "${sudo[@]}" apt-get update -q -y >/dev/null
  # On Ubuntu these packages only install a snap, which a container cannot run.
  DEBIAN_FRONTEND=noninteractive "${sudo[@]}" apt-get install -y -q --no-install-recommends chromium chromium-driver >/dev/null && exit 0
fi
echo "   no Chromium with chromedriver on this machine, and none could be installed: the page works, its browser tests will fail." >&2
echo "   Type this once: sudo apt-get install chromium chromium-driver" >&2
