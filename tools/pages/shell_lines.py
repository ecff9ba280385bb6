# SPDX-License-Identifier: Apache-2.0
"""Split what stands in a shell block into its simple commands, each a list of words."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator

#: What stands for the output of `$(...)`, whose inside is a command of its own.
SUBSTITUTED = "SUBSTITUTED"
#: Before a command, and no part of it.
PREFIXES = ("sudo", "time")
_INNER = re.compile(r"\$\(([^()]*)\)")
_ASSIGNMENT = re.compile(r"[A-Za-z_]\w*=")
_REDIRECTION = re.compile(r"[<>]+&?")
_SEPARATORS = {"&&", "||", ";", "|", "&", "(", ")"}


def commands_of(text: str) -> Iterator[list[str]]:
    """Yield the simple commands of a block, those inside `$(...)` first.

    Raises:
        ValueError: a quotation that is not closed.
    """
    outer = text.replace("\\\n", " ")
    while found := _INNER.search(outer):
        yield from commands_of(found[1])
        outer = outer[: found.start()] + SUBSTITUTED + outer[found.end() :]
    for line in outer.splitlines():
        yield from filter(None, map(_without_prefix, _split(line)))


def _split(line: str) -> Iterator[list[str]]:
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words: list[str] = []
    redirects = False
    for word in lexer:
        if word in _SEPARATORS:
            yield words
            words = []
        elif _REDIRECTION.fullmatch(word):
            redirects = True
        elif redirects:  # a file
            redirects = False
        else:
            words.append(word)
    yield words


def _without_prefix(words: list[str]) -> list[str]:
    while words and (words[0] in PREFIXES or _ASSIGNMENT.match(words[0])):
        words = words[1:]
    return words
