# SPDX-License-Identifier: Apache-2.0
"""Without pyarrow, DuckDB and fsspec: bags are recorded, replayed and reported; archives say what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from softgrip_bag.errors import BagError
from softgrip_bag.extras import INSTALL, MODULES, importing
from softgrip_bag.offers import OfferedQos
from softgrip_bag.writer import BagWriter, Topic

PACKAGE = Path(__file__).resolve().parents[1] / "softgrip_bag"
HIDDEN = "import sys\n" + "".join(f"sys.modules[{name!r}] = None\n" for name in MODULES)
#: std_msgs/String "hi" as little-endian CDR.
HI = bytes.fromhex("00010000 03000000 686900")
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def without(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python code where none of the modules can be imported."""
    command = [sys.executable, "-c", HIDDEN + code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    writer = BagWriter(tmp_path / "bag", {"softgrip_machine": {"system": "test"}})
    writer.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    writer.write("/a", 2_000, 1_500, HI)
    return writer.close()


def test_everything_but_archives_is_imported_without_them() -> None:
    modules = [
        ".".join(("softgrip_bag", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        for path in sorted(PACKAGE.rglob("*.py"))
        if "archive" not in path.relative_to(PACKAGE).parts and path.name != "lerobot.py"
    ]
    assert "softgrip_bag.nodes.commands.archive" in modules
    done = without(f"import importlib\nfor name in {modules}: importlib.import_module(name)")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("command", "arguments", "purpose"),
    [
        ("commands.query", ["--list"], "query"),
        ("commands.query", ["SHOW TABLES", "--in", "nowhere"], "query"),
        ("nodes.commands.archive", ["{bag}", "--to", "{out}"], "archive"),
        ("nodes.commands.export", ["{bag}", "--parquet", "--output", "{out}"], "Parquet"),
        ("nodes.commands.export", ["{bag}", "--lerobot", "{out}"], "LeRobot's format"),
    ],
)
def test_a_command_that_needs_them_says_what_to_install(
    command: str, arguments: list[str], purpose: str, bag: Path, tmp_path: Path
) -> None:
    given = [one.format(bag=bag, out=tmp_path / "out") for one in arguments]
    done = without(f"from softgrip_bag.{command} import main\nraise SystemExit(main(sys.argv[1:]))", *given)
    assert done.returncode == 2, done.stderr
    (said,) = done.stderr.strip().splitlines()
    assert said.startswith(f"{purpose}: expected pyarrow, duckdb, fsspec, found no module ")
    assert INSTALL in said


def test_tables_as_csv_need_none_of_them(bag: Path, tmp_path: Path) -> None:
    code = "from softgrip_bag.nodes.commands.export import main\nraise SystemExit(main(sys.argv[1:]))"
    done = without(code, bag, "--csv", "--output", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "a.csv").read_text().splitlines()[1].endswith("hi")


def test_another_missing_module_is_no_extra() -> None:
    with pytest.raises(ModuleNotFoundError), importing("archive"):
        import softgrip_no_such_module  # noqa: F401, PLC0415  missing on purpose
    with pytest.raises(BagError, match="archive: expected pyarrow"), importing("archive"):
        raise ModuleNotFoundError("No module named 'pyarrow.parquet'", name="pyarrow.parquet")
