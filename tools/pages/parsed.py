# SPDX-License-Identifier: Apache-2.0
"""Give a command line to the parser of the command itself, and go no further."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from unittest import mock

#: What argparse says of a line that only lacks something, as in running text.
_INCOMPLETE = "the following arguments are required"


class RefusedLineError(ValueError):
    """A command's own parser refuses its line; the message is the parser's."""


class _Understood(BaseException):
    """Ends a command after its line was parsed; no handler of the command takes it for an error of its own."""


def parse(main: Callable[[], Any], words: Sequence[str], *, whole: bool = True) -> argparse.Namespace:
    """Return what a command's own parser makes of the words behind its name.

    Args:
        main: the command, which takes its words from sys.argv; it runs as far as its parser.
        words: the words.
        whole: False where the words may lack something that is required; then the result may be empty.

    Raises:
        RefusedLineError: an option, a choice or a value that the command does not take.
    """
    complaint = io.StringIO()
    understood: list[argparse.Namespace] = []
    asked: list[argparse.ArgumentParser] = []
    arguments = mock.patch.object(sys, "argv", ["command", *words])
    quiet = contextlib.redirect_stdout(io.StringIO())
    with _stopped_behind_the_parser(understood, asked), contextlib.redirect_stderr(complaint), quiet, arguments:
        try:
            main()
        except _Understood:
            return understood[0]
        except SystemExit as end:
            said = complaint.getvalue().strip()
            if not whole and _INCOMPLETE in said:
                said = _unknown_option(words, asked)
            if not end.code or not said:  # 0: --help
                return argparse.Namespace()
            raise RefusedLineError(said.splitlines()[-1] if said else f"no line of its own: {words}") from None
    raise RefusedLineError("expected a command that parses its line, found none")


def _unknown_option(words: Sequence[str], asked: Sequence[argparse.ArgumentParser]) -> str:
    """Return which option is in no help text, empty for none."""
    known = "".join(parser.format_help() for parser in asked)
    missing = [
        word
        for word in words
        if word.startswith("--") and not re.search(rf"{re.escape(word.partition('=')[0])}(?![\w-])", known)
    ]
    return f"unrecognized arguments: {' '.join(missing)}" if missing else ""


@contextlib.contextmanager
def _stopped_behind_the_parser(
    understood: list[argparse.Namespace], asked: list[argparse.ArgumentParser]
) -> Iterator[None]:
    parse_known = argparse.ArgumentParser.parse_known_args

    def stop(parser: argparse.ArgumentParser, args: Any = None, namespace: Any = None) -> Any:
        asked.append(parser)
        found, rest = parse_known(parser, args, namespace)
        if parser is not asked[0]:  # of a verb, called by that of the command
            return found, rest
        if rest and rest[0] != "--ros-args":
            parser.error(f"unrecognized arguments: {' '.join(rest)}")
        understood.append(found)
        raise _Understood

    with mock.patch.object(argparse.ArgumentParser, "parse_known_args", stop):
        yield
