# SPDX-License-Identifier: Apache-2.0
"""Show who may do what: ``ros2 run softgrip_security policy``, or of one identity with its name."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_security.errors import SecurityError
from softgrip_security.policy import SHIPPED, Grant, read_policy
from softgrip_security.tables import policy_tables


def main(argv: Sequence[str] | None = None) -> int:
    """Return 0, or 1 where the policy cannot be read."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("identity", nargs="?", help="show all grants of this one")
    parser.add_argument("--policy", type=Path, default=SHIPPED, help="default: the shipped access.yaml")
    parser.add_argument("--namespace", default="/", help="of the cell, default /")
    arguments = parser.parse_args(argv)
    try:
        policy = read_policy(arguments.policy, arguments.namespace)
        if arguments.identity is None:
            print(policy_tables(policy), end="")
        else:
            identity = policy.identity(arguments.identity)
            for grant in Grant:
                for name in identity.names(grant):
                    print(f"{grant:13} {name}")
    except SecurityError as error:
        print(f"policy: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
