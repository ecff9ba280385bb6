# SPDX-License-Identifier: Apache-2.0
"""Starts an executable of a package: ``python -m embedded_ros.child NAME module:function [arguments]``."""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys

PARENT_VARIABLE = "EMBEDDED_LAUNCH_PID"
_PR_SET_PDEATHSIG = 1


def end_with_launch() -> None:
    """On Linux, have the kernel end this process when the launch that started it is killed."""
    parent = os.environ.pop(PARENT_VARIABLE, "")
    if parent and sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        try:
            os.kill(int(parent), 0)  # it is not always our parent: a launch-prefix may stand between
        except ProcessLookupError:
            raise SystemExit("the launch that started this process is gone") from None


def main() -> None:
    """Run the function as the console script of its package would."""
    name, target = sys.argv[1], sys.argv[2]
    sys.argv = [name, *sys.argv[3:]]
    end_with_launch()
    module, _, function = target.partition(":")
    sys.exit(getattr(importlib.import_module(module), function)())


if __name__ == "__main__":
    main()
