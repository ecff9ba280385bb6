# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_description hand_file`: check a hand file, also with fingers; print its schema."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_description.commands.describe import profile_path
from softgrip_description.errors import HandError
from softgrip_description.hand import Hand, load_hand
from softgrip_description.json_schema import schema_path
from softgrip_model.profile import ProfileError, load

EPILOG = """examples:
  ros2 run softgrip_description hand_file check my_hand.yaml
  ros2 run softgrip_description hand_file check my_hand.yaml power my_fingers.yaml    do these fit its slots?
  ros2 run softgrip_description hand_file schema > hand.schema.json                   for the completion of an editor
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; exit code 1 with a reason when the file cannot be used."""
    options = _parser().parse_args(args)
    try:
        return int(options.work(options))
    except (HandError, ProfileError, OSError) as error:
        print(f"[hand_file] {error}", file=sys.stderr)
        return 1


def check(options: argparse.Namespace) -> int:
    """Print what the file describes, or what is wrong with it."""
    hand = load_hand(options.file)
    for name in options.fingers:
        profile = load(profile_path(name))
        hand.check_mounting({slot: profile.finger(slot) for slot in profile.slots})
    print(f"{options.file}: {summary(hand)}")
    return 0


def summary(hand: Hand) -> str:
    """Return what a hand has, in one line."""
    slots = ", ".join(f"{name} (up to {1e3 * slot.max_length_m:.0f} mm)" for name, slot in hand.slots.items())
    return f"hand {hand.name!r}: slots {slots}; tool centre points of {', '.join(hand.tool_centre_points_m) or 'none'}"


def schema(_: argparse.Namespace) -> int:
    """Print the schema."""
    print(schema_path("hand").read_text(encoding="utf-8"), end="")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_description hand_file",
        description="Check a hand file (docs/description.md).",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="check | schema")
    command = commands.add_parser("check", help=(check.__doc__ or "").splitlines()[0])
    command.add_argument("file", type=Path)
    command.add_argument("fingers", nargs="*", help="ids of shipped profiles, or profile files")
    command.set_defaults(work=check)
    commands.add_parser("schema", help="print the JSON schema").set_defaults(work=schema)
    return parser


if __name__ == "__main__":
    sys.exit(main())
