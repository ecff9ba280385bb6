# SPDX-License-Identifier: Apache-2.0
"""Whatever is wrong with a bag, a command says so and shows what there is."""

from __future__ import annotations

import csv
import errno
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.commands import export, info, play, replay, report
from softgrip_bag.nodes.messages import interface_text
from softgrip_bag.offers import OfferedQos
from softgrip_bag.reader import bag_files, offered_qos, read
from softgrip_bag.repair import repair
from softgrip_bag.schema_text import schema_text
from softgrip_bag.statistics import statistics
from softgrip_bag.writer import BagWriter, FileLimits, Topic

HI = bytes.fromhex("00010000 03000000 686900")
#: softgrip_interfaces/MountedFinger, as an older release might have had it.
OLD = "string finger\nstring serial\nuint8 state\n"
Command = Callable[[Sequence[str]], int]


def make(folder: Path, type_name: str = "std_msgs/msg/String", schema: str = "string data\n", data: bytes = HI) -> Path:
    bag = BagWriter(folder)
    bag.add_topic(Topic("/a", type_name, "", schema, (OfferedQos(),)))
    for index in range(3):
        bag.write("/a", 1_000_000_000 + index, 1_000_000_000 + index, data)
    return bag.close()


def commands(folder: Path) -> dict[str, tuple[Command, list[str]]]:
    return {
        "info": (info.main, []),
        "export": (export.main, ["--csv", "-o", str(folder / "tables")]),
        "play": (play.main, ["--rate", "0", "--wait", "0"]),
        "replay": (replay.main, ["--through", "kinematics_predictor", "--check"]),
        "report": (report.main, ["--json"]),
    }


@pytest.mark.parametrize("name", ["info", "export", "play", "replay", "report"])
@pytest.mark.parametrize("what", ["nothing", "a file that is no MCAP", "an empty folder"])
def test_no_bag_is_named_by_every_command(
    name: str, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.mcap"
    if what == "a file that is no MCAP":
        path.write_bytes(b"text, and no MCAP at all")
    elif what == "an empty folder":
        path.mkdir()
    command, arguments = commands(tmp_path)[name]
    assert command([str(path), *arguments]) == 2
    said = capsys.readouterr().err
    assert "expected" in said
    assert str(path) in said


@pytest.mark.parametrize("name", ["info", "export", "report"])
def test_a_bag_of_zero_bytes_is_an_empty_bag(name: str, tmp_path: Path) -> None:
    (tmp_path / "zero").mkdir()
    (tmp_path / "zero" / "zero_0.mcap").touch()
    command, arguments = commands(tmp_path)[name]
    assert command([str(tmp_path / "zero"), *arguments]) == 0


def test_an_unknown_type_is_counted_and_read_raw_but_not_decoded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make(tmp_path / "bag", "other_msgs/msg/Thing", "float32 unheard_of\n")
    assert len(list(read(bag))) == 3
    assert info.main([str(bag)]) == 0
    assert "other_msgs/msg/Thing" in capsys.readouterr().out
    assert export.main([str(bag), "--csv", "-o", str(tmp_path / "tables")]) == 2
    assert "install package other_msgs" in capsys.readouterr().err
    assert play.main([str(bag), "--rate", "0", "--wait", "0"]) == 0
    assert "/a is not played" in capsys.readouterr().err


def test_a_type_of_another_release_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = make(tmp_path / "bag", "softgrip_interfaces/msg/MountedFinger", OLD)
    for name in ("export", "replay"):
        command, arguments = commands(tmp_path)[name]
        assert command([str(bag), *arguments]) == 2
        assert "other fields" in capsys.readouterr().err
    kept = schema_text("softgrip_interfaces/msg/MountedFinger", interface_text)
    reworded = "\n".join(f"  {line.split('#')[0]}" for line in kept.splitlines())
    same = make(tmp_path / "same", "softgrip_interfaces/msg/MountedFinger", reworded, b"\0\1\0\0" + bytes(20))
    assert export.main([str(same), "--csv", "-o", str(tmp_path / "tables")]) == 0


def test_bytes_that_are_no_message_of_their_type_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = make(tmp_path / "bag", data=b"\0\1\0\0\xff\xff\xff\xff")
    assert export.main([str(bag), "--csv", "-o", str(tmp_path / "tables")]) == 2
    assert "/a: expected a std_msgs/msg/String" in capsys.readouterr().err


def test_a_clock_that_jumps_loses_nothing(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", limits=FileLimits(file_seconds=3600.0))
    bag.add_topic(Topic("/a", "std_msgs/msg/String", "", "string data\n", (OfferedQos(),)))
    times = [5_000_000_000, 5_100_000_000, 1_000_000_000, 1_100_000_000, 9_000_000_000_000]
    for time in times:
        bag.write("/a", time, time + 50_000_000, HI)
    folder = bag.close()
    assert [message.received for message in read(folder)] == sorted(times)
    found = statistics(folder)
    assert (found.start, found.messages) == (1_000_000_000, 5)
    assert found.duration == pytest.approx(8999.0)
    assert found.topics[0].longest_gap >= 0.0
    cut = bag_files(folder)[-1]
    cut.write_bytes(cut.read_bytes()[:-30])
    assert repair(folder).messages == 5


def test_a_folder_that_may_not_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("softgrip_bag.mcap_file.os.open", refuse)
    with pytest.raises(BagError, match=r"cannot create the bag's folder .*: Permission denied"):
        BagWriter(tmp_path / "bag")


def test_a_broken_bag_that_may_not_be_written_is_still_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = make(tmp_path / "bag")
    path = bag_files(bag)[0]
    path.write_bytes(path.read_bytes()[:-20])

    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(BagError, match="cannot be repaired: Permission denied"):
        repair(bag)
    assert len(list(read(bag))) == 3


def test_tables_hold_every_field_of_every_message(tmp_path: Path) -> None:
    bag = make(tmp_path / "bag")
    parquet = pytest.importorskip("pyarrow.parquet")
    for form, arguments in (("csv", ["--csv"]), ("parquet", ["--parquet"])):
        assert export.main([str(bag), *arguments, "-o", str(tmp_path / form)]) == 0
    with (tmp_path / "csv" / "a.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["data"] for row in rows] == ["hi"] * 3
    table = parquet.read_table(tmp_path / "parquet" / "a.parquet").to_pydict()
    assert table["data"] == ["hi"] * 3
    assert table["received_ns"] == [1_000_000_000 + index for index in range(3)]


@pytest.mark.parametrize(
    "text",
    [
        "{depth: [1]}",
        "- 7",
        "- {depth: many, reliability: [1], durability: {a: 1}, history: .nan}",
        "- {depth: -3}",
        "- {",
        "&a [*a]",
    ],
)
def test_qos_that_no_tool_of_ours_wrote_is_the_default(text: str) -> None:
    channel = SimpleNamespace(metadata={"offered_qos_profiles": text})
    for offer in offered_qos(channel):
        assert OfferedQos.from_map(offer) == OfferedQos()
