# SPDX-License-Identifier: Apache-2.0
"""Who answers the wizard: somebody at a terminal, or answers that were written down before."""

from __future__ import annotations

import sys
import termios
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import yaml

from softgrip_driver.errors import ConfigurationError


class Terminal(Protocol):
    """Answers questions. A question has a key, by which an answers file names it."""

    def print_line(self, text: str) -> None:
        """Read a line."""

    def ask(self, key: str, text: str, default: str = "") -> str:
        """Answer a question; with nothing, by its default."""

    def confirm(self, key: str, text: str) -> None:
        """Do something, then say so."""

    def try_again(self, key: str, problem: str) -> bool:
        """Return whether to do a step that failed once more, after its cause was removed."""


class TerminalPerson:
    """Somebody at a terminal."""

    def print_line(self, text: str) -> None:
        """Print a line."""
        print(text, flush=True)

    def ask(self, key: str, text: str, default: str = "") -> str:
        """Ask for a line; raises ConfigurationError where nobody is there."""
        shown = f" [{default}]" if default else ""
        try:
            return input(f"? {text}{shown}: ").strip() or default
        except EOFError as error:
            raise ConfigurationError(
                f"expected an answer to '{key}', found the input closed; give --answers FILE, or --yes for the defaults"
            ) from error

    def confirm(self, key: str, text: str) -> None:
        """Wait for Enter; one that was pressed before the question says nothing about it."""
        if sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        self.ask(key, f"{text}, then press Enter")

    def try_again(self, key: str, problem: str) -> bool:
        """Ask whether to try again."""
        self.print_line(f"! {problem}")
        return self.ask(f"{key}.again", "Try again? yes or no", "yes").lower() not in {"n", "no"}


class WrittenAnswers:
    """Answers of a file, and defaults where there is none; does what is asked for at once.

    Args:
        answers: key -> answer.
        takes_defaults: take the default of a question that has no answer.
    """

    def __init__(self, answers: Mapping[str, str], *, takes_defaults: bool) -> None:
        self._answers = answers
        self._takes_defaults = takes_defaults

    def print_line(self, text: str) -> None:
        """Print a line."""
        print(text, flush=True)

    def ask(self, key: str, text: str, default: str = "") -> str:
        """Return the written answer, else the default; raises ConfigurationError where there is neither."""
        answer = self._answers.get(key)
        if answer is None and self._takes_defaults and default:
            answer = default
        if answer is None:
            raise ConfigurationError(f"answers: expected one to '{key}' ({text}), found none; write `{key}: ...`")
        self.print_line(f"? {text}: {answer}")
        return answer

    def confirm(self, key: str, text: str) -> None:
        """Print what was asked for; it counts as done."""
        del key
        self.print_line(f"> {text}")

    def try_again(self, key: str, problem: str) -> bool:
        """Never."""
        del key
        self.print_line(f"! {problem}")
        return False


class GivenAnswers:
    """Answers that options of a command gave, before anybody else is asked.

    Args:
        answers: key -> answer.
        person: who answers the rest.
    """

    def __init__(self, answers: Mapping[str, str], person: Terminal) -> None:
        self._answers, self._person = answers, person

    def print_line(self, text: str) -> None:
        """Print a line."""
        self._person.print_line(text)

    def ask(self, key: str, text: str, default: str = "") -> str:
        """Return the option's answer, else the person's; raises ConfigurationError as the person does."""
        answer = self._answers.get(key)
        if answer is None:
            return self._person.ask(key, text, default)
        self.print_line(f"? {text}: {answer}")
        return answer

    def confirm(self, key: str, text: str) -> None:
        """Let the person do it."""
        self._person.confirm(key, text)

    def try_again(self, key: str, problem: str) -> bool:
        """Let the person decide."""
        return self._person.try_again(key, problem)


def read_answers(path: Path) -> dict[str, str]:
    """Return the answers of a YAML file, key -> answer.

    Raises:
        ConfigurationError: no such file, or no such answers.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigurationError(f"{path}: expected answers as `key: answer`, found: {error}") from error
    if not isinstance(data, dict) or not all(isinstance(value, str | int | float) for value in data.values()):
        raise ConfigurationError(f"{path}: expected answers as `key: answer`, found {type(data).__name__}")
    return {str(key): str(value) for key, value in data.items()}
