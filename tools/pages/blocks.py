# SPDX-License-Identifier: Apache-2.0
"""Run the code blocks of a page as a reader does: in order, in one folder, Python blocks in one interpreter.

A comment in the line above a block says what else is to be known:

    <!-- output -->            what the block before prints: every line, numbers to their last digit; ... for any text
    <!-- file: my.yaml -->     the block is a file
    <!-- typed: A|B -->        asks for lines: these are typed; beside a cell Enter is pressed as often as it asks
    <!-- long -->              takes long: run by `make docs-test`
    <!-- background -->        goes on while the blocks below run, and is ended after the last
    <!-- cell -->              typed beside the one running cell that all pages share; with `WORD from PATTERN` the
                               word is what the pattern last finds in the page's other terminals, such as a token
    <!-- by: FILE::TEST -->    a test of its own types it from the page, since it takes a person or a bench
    <!-- elsewhere: why -->    needs what is not here, such as a servo; only the names in it are checked
    <!-- shown: what -->       a drawing, a formula, the layout of a folder: nothing that anybody types

Comments of their own:

    <!-- hidden: COMMAND -->   run where it stands: it prepares the folder, such as with a bag, or checks a file
    <!-- aside: COMMAND -->    the same, where long blocks are run
    <!-- beside: COMMAND -->   the same, and goes on until the page ends
    <!-- hands: WORDS -->      what a person does at the running cell (tools/pages/hands.py)
    <!-- stands: A for B -->   from here on A is typed where the page has B, such as an emulated port for a device

`python tools/pages/blocks.py` lists how many blocks are run, and which are not and why.
"""

from __future__ import annotations

import argparse
import code
import collections
import contextlib
import io
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import CodeType
from typing import Any

import yaml
from markdown_it import MarkdownIt

sys.path.append(str(Path(__file__).parent))

import links
import shell_lines

ROOT = Path(__file__).resolve().parents[2]
#: What a reader has in the folder that the commands are typed in.
TOP = ("Makefile", "benchmarks", "docs", "embedded", "examples", "ros2_ws", "tests", "tools")
TOP += (".ci", ".venv", "pyproject.toml", *sorted(path.name for path in ROOT.glob("requirements*")))
LANGUAGES = ("sh", "python", "yaml", "text")
BACKGROUND_START_S = 400.0
_PARSER = MarkdownIt("commonmark").enable("table")
_MARK = re.compile(r"\s*<!-- (?P<mark>[a-z]+)(?:: (?P<value>.*?))? -->")
MARKS = ("output", "file", "typed", "long", "background", "cell", "by", "elsewhere", "shown")
#: Comments of their own; the others stand above a block.
ALONE = ("hidden", "aside", "beside", "hands", "stands")
#: Blocks that only `make docs-test` runs.
LONG_MARKS = ("long", "background", "cell", "aside", "beside", "hands")
NOT_RUN = ("by", "elsewhere", "shown")
MAX_ENTERS = 100
#: What a service says that did not do what it was asked for; `ros2 service call` ends with 0 all the same.
_REFUSED = "success=False"
_AT_HOME = re.compile(r"~/\.(?:softgrip|aws)")
#: Added to the domain of a page's commands: another one, named OTHER_DOMAIN, for what `stands` puts there.
_OTHER_DOMAIN = 100
_TAKEN = re.compile(r"(?P<word>\S+) from (?P<pattern>.+)")
_NUMBER = re.compile(r"[-+]?\d+(?:\.(\d+))?(?:e[-+]?\d+)?")


class BlockError(AssertionError):
    """A block did not do what its page says."""


@dataclass(frozen=True)
class Block:
    """One block of code.

    Attributes:
        line: of its first line in the page.
        mark, value: of the comment above it.
    """

    page: Path
    line: int
    language: str
    text: str
    mark: str = ""
    value: str = ""

    @property
    def place(self) -> str:
        """Return where it is."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks_of(page: Path) -> list[Block]:
    """Return the blocks of a page in order, and what prepares for them.

    Raises:
        BlockError: a block without a known language, or one that has to say what it is and does not.
    """
    source = page.read_text(encoding="utf-8")
    lines = source.splitlines()
    found = []
    for at, line in enumerate(lines):
        mark = _MARK.fullmatch(line)
        if mark and mark["mark"] in ALONE:
            found.append(Block(page, at + 1, "sh", mark["value"], mark["mark"]))
    for token in _PARSER.parse(source):
        if token.type in {"fence", "code_block"} and not token.info.startswith(("{", "math")):  # of the site alone
            assert token.map is not None
            mark = _MARK.fullmatch(lines[token.map[0] - 1]) if token.map[0] else None
            name, value = (mark["mark"], mark["value"] or "") if mark and mark["mark"] in MARKS else ("", "")
            found.append(_checked(Block(page, token.map[0] + 2, token.info.strip(), token.content, name, value)))
    return sorted(found, key=lambda block: block.line)


def _checked(block: Block) -> Block:
    if block.language not in LANGUAGES:
        raise BlockError(f"{block.place}: expected ``` and one of {', '.join(LANGUAGES)}, found '{block.language}'")
    if block.language in {"yaml", "text"} and not block.mark:
        raise BlockError(f"{block.place}: expected a comment above that says what it is, found none")
    if block.mark in NOT_RUN and not block.value:
        raise BlockError(f"{block.place}: expected a reason, <!-- {block.mark}: why -->, found none")
    if block.mark == "by":
        _check_test(block)
    return block


def _check_test(block: Block) -> None:
    """Check that the test that a block names is there, and reads the block's page."""
    file, _, test = block.value.partition("::")
    path = ROOT / file
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if f"\ndef {test}(" not in text or block.page.name not in text:
        raise BlockError(f"{block.place}: expected a test {block.value} that reads {block.page.name}, found none")


def needs_cell(page: Path) -> bool:
    """Return whether commands of a page are typed beside a running cell."""
    return any(block.mark in {"cell", "hands"} for block in blocks_of(page))


class Reader:
    """Types the blocks of one page.

    Args:
        folder: empty one to work in.
        long: run blocks that take long as well.
        cell: environment variables of the commands that are typed beside the running cell, such as its domain;
            None where none runs.
    """

    def __init__(self, folder: Path, *, long: bool = False, cell: Mapping[str, str] | None = None) -> None:
        self._folder, self._long, self._cell = folder, long, cell
        self._stands: list[tuple[str, str]] = []
        self._names: dict[str, Any] = {"__name__": "__main__"}
        self._printed = ""
        self._background: list[subprocess.Popen[str]] = []
        for name in TOP:
            (folder / name).symlink_to(ROOT / name)

    def run(self, page: Path) -> int:
        """Run the blocks; returns how many were run.

        Raises:
            BlockError: one failed or printed something else.
        """
        count = 0
        with contextlib.chdir(self._folder):
            try:
                for block in blocks_of(page):
                    count += self._do(block)
            finally:
                self._end()
        return count

    def _do(self, block: Block) -> bool:
        if block.mark in NOT_RUN or (block.mark in LONG_MARKS and not self._long):
            check_names(block)
            self._printed = ""
            return False
        if block.mark == "stands":
            here, _, written = block.text.partition(" for ")
            self._stands.append((written, here))
        elif block.mark == "file":
            self._write(block)
        elif block.mark == "output":
            if self._printed:
                compare(block, self._printed)
        elif block.language == "python":
            self._printed = self._python(block)
        elif block.language == "sh":
            self._shell(block)
        return True

    def _write(self, block: Block) -> None:
        check_names(block)
        path = self._folder / block.value
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text, encoding="utf-8")

    def _python(self, block: Block) -> str:
        printed = io.StringIO()
        try:
            with contextlib.redirect_stdout(printed):
                exec(compile("\n" * (block.line - 1) + block.text, str(block.page), "exec"), self._names)  # noqa: S102  the page's own
        except Exception as error:
            raise BlockError(f"{block.place}: {type(error).__name__}: {error}") from error
        return printed.getvalue()

    def _shell(self, block: Block) -> None:
        environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "COLUMNS": "120"}
        environment |= self._cell or {}
        environment["OTHER_DOMAIN"] = str(int(environment.get("ROS_DOMAIN_ID", "0")) + _OTHER_DOMAIN)
        if _AT_HOME.search(block.page.read_text(encoding="utf-8")):
            environment["HOME"] = str(self._folder)  # what the page keeps there is not this user's
        command = ["bash", "-euo", "pipefail", "-c", self._typed(block)]
        if block.mark in {"background", "beside"}:
            self._start(command, environment, block)
            return
        lines = {"cell": "\n" * MAX_ENTERS, "typed": block.value.replace("|", "\n") + "\n"}
        done = subprocess.run(
            command, input=lines.get(block.mark, ""), capture_output=True, text=True, env=environment, check=False
        )
        if done.returncode or (block.mark == "cell" and _REFUSED in done.stdout):
            raise BlockError(
                f"{block.place}: exit code {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
            )
        self._printed = done.stdout + done.stderr

    def _typed(self, block: Block) -> str:
        """Return what is typed: the block, with what stands for devices and the words that other terminals show."""
        if block.mark == "hands":
            return f"python tools/pages/hands.py {block.text}"
        text = block.text
        if taken := _TAKEN.fullmatch(block.value) if block.mark == "cell" else None:
            logs = "".join(log.read_text() for log in sorted(self._folder.glob("background-*.log")))
            found = re.findall(taken["pattern"], logs)
            if not found:
                raise BlockError(
                    f"{block.place}: expected {taken['pattern']} in another terminal, found\n{logs[-2000:]}"
                )
            text = text.replace(taken["word"], found[-1])
        for written, here in self._stands:
            text = text.replace(written, here)
        return text

    def _start(self, command: list[str], environment: Mapping[str, str], block: Block) -> None:
        """Start what goes on, and wait for the words that the page says it is ready with."""
        log = (self._folder / f"background-{len(self._background)}.log").open("w+")
        process = subprocess.Popen(
            command, stdout=log, stderr=subprocess.STDOUT, text=True, env=environment, start_new_session=True
        )
        self._background.append(process)
        deadline = time.monotonic() + BACKGROUND_START_S
        while block.value not in Path(log.name).read_text():  # beside: none
            if process.poll() is not None or time.monotonic() > deadline:
                raise BlockError(
                    f"{block.place}: expected '{block.value}', found\n{Path(log.name).read_text()[-2000:]}"
                )
            time.sleep(0.2)

    def _end(self) -> None:
        for process in self._background:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)


class _Prompt(code.InteractiveConsole):
    """Python's prompt, line by line; what a line completes is compiled and not run."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        self._block = block

    def runcode(self, code: CodeType) -> None:
        """Run nothing."""

    def showsyntaxerror(self, *_: object, **__: object) -> None:
        """Say which line cannot be typed."""
        typed = "\n".join(self.buffer)
        why = "an empty line may be missing, or one too many"
        raise BlockError(f"{self._block.place}: Python's prompt does not take\n{typed}\n{why}")


def check_at_prompt(block: Block) -> None:
    """Check that a block of Python can be pasted at Python's prompt, with Enter once more behind it.

    There an empty line ends a function or a loop, and nothing else does.

    Raises:
        BlockError: it cannot.
    """
    prompt = _Prompt(block)
    for line in [*block.text.splitlines(), ""]:
        incomplete = prompt.push(line)
    if incomplete:
        raise BlockError(f"{block.place}: expected a block that ends, found one that Python's prompt waits for more of")


def compare(block: Block, printed: str) -> None:
    """Check that what was printed has the lines of an output block, in their order.

    Raises:
        BlockError: a line is missing.
    """
    lines = [line.rstrip() for line in printed.splitlines()]
    at = 0
    for expected in filter(str.strip, block.text.splitlines()):
        if expected.strip() == "...":
            continue
        match = next((i for i in range(at, len(lines)) if alike(expected, lines[i])), None)
        if match is None:
            raise BlockError(f"{block.place}: expected the line\n  {expected}\nin what was printed:\n{printed}")
        at = match + 1


def alike(expected: str, printed: str) -> bool:
    """Return whether a line is the expected one: words alike, numbers within one and a half of the last digit."""
    if "..." in expected:
        pattern = ".*".join(map(re.escape, " ".join(expected.split()).split("...")))
        return re.fullmatch(pattern, " ".join(printed.split())) is not None
    numbers = [list(_NUMBER.finditer(line)) for line in (expected, printed)]
    words = [" ".join(_NUMBER.sub("#", line).split()) for line in (expected, printed)]
    if words[0] != words[1] or len(numbers[0]) != len(numbers[1]):
        return False
    return all(abs(float(a[0]) - float(b[0])) <= 1.5 * 10.0 ** -len(a[1] or "") for a, b in zip(*numbers, strict=True))


def check_names(block: Block) -> None:
    """Check that the commands of a block that cannot be run here exist, with the options that it gives them.

    Raises:
        BlockError: one does not.
    """
    import named  # noqa: PLC0415  it asks embedded/'s parsers, and pages are also typed where only ROS 2 is

    if block.mark == "shown" or block.mark in ALONE:
        return
    if block.language == "python":
        compile(block.text, block.place, "exec")
    elif block.language == "yaml":
        _raise(block, named.parameter_problem(yaml.safe_load(block.text)))
    elif block.language == "sh":
        for words in shell_lines.commands_of(block.text):
            _raise(block, named.problem_of(words))


def text_problems(page: Path) -> Iterator[str]:
    """Yield what is wrong with code in the running text of a page: commands, modules and files that are not there."""
    import named  # noqa: PLC0415  as above

    for token in _PARSER.parse(page.read_text(encoding="utf-8")):
        for child in token.children or []:
            problem = named.text_problem(child.content) if child.type == "code_inline" else ""
            if problem:
                assert token.map is not None
                yield f"{page.relative_to(ROOT)}:{token.map[0] + 1}: `{child.content}`: {problem}"


def _raise(block: Block, problem: str) -> None:
    if problem:
        raise BlockError(f"{block.place}: {problem}")


def pages() -> list[Path]:
    """Return every page of the repository."""
    return links.pages()


def main() -> int:
    """Print how many blocks are run, and why the others are not."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    blocks = [block for page in pages() for block in blocks_of(page) if block.mark not in ALONE]
    counts = collections.Counter(block.mark or "run" for block in blocks)
    print(", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
    for block in blocks:
        if block.mark in NOT_RUN:
            print(f"{block.place}: {block.mark}: {block.value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
