# SPDX-License-Identifier: Apache-2.0
"""What is left of a damaged file, counted by hand: the files are the mcap library's own, the damage is one byte."""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from softgrip_bag import salvage
from softgrip_bag.errors import BagError
from softgrip_bag.repair import bags_in, is_broken, repair, repair_all

MAGIC = b"\x89MCAP0\r\n"
CHUNK, ATTACHMENT, DATA_END = 0x06, 0x09, 0x0F
MESSAGES = 6


def mcap_bytes(compression: CompressionType = CompressionType.NONE) -> bytes:
    """Six chunks of one message each, an attachment and a metadata record beside them."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=1, compression=compression)
    writer.start(profile="ros2", library="test")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": ""})
    writer.add_attachment(11, 12, "parameters/node.yaml", "application/yaml", b"a: 1")
    writer.add_metadata("softgrip_machine", {"system": "test"})
    for number in range(MESSAGES):
        writer.add_message(channel, 1_000 + number, b"payload %d" % number * 20, 500 + number, 7 + number)
    writer.finish()
    return stream.getvalue()


def places(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, begin and end of every record, by the MCAP specification: one byte, eight bytes of length, the rest."""
    at, found = len(MAGIC), []
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def write(folder: Path, data: bytes) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{folder.name}_0.mcap"
    path.write_bytes(data)
    return path


def read(path: Path) -> tuple[list[int], salvage.Damage]:
    damage = salvage.Damage()
    times = [record.log_time for record in salvage.records(path, damage) if type(record).__name__ == "Message"]
    return times, damage


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_one_flipped_byte_costs_its_chunk_and_is_counted(tmp_path: Path, compression: CompressionType) -> None:
    data = bytearray(mcap_bytes(compression))
    _, _, end = [place for place in places(bytes(data)) if place[0] == CHUNK][2]
    data[end - 5] ^= 0x40
    times, damage = read(write(tmp_path / "bag", bytes(data)))
    assert times == [1_000, 1_001, 1_003, 1_004, 1_005]
    assert (damage.bad_chunks, damage.lost_bytes, damage.complete) == (1, 0, True)


@pytest.mark.parametrize("beyond", [0, 5, 60])
def test_what_was_cut_off_is_counted_to_the_byte(tmp_path: Path, beyond: int) -> None:
    data = mcap_bytes()
    _, begin, _ = [place for place in places(data) if place[0] == CHUNK][4]
    times, damage = read(write(tmp_path / "bag", data[: begin + beyond]))
    assert times == [1_000, 1_001, 1_002, 1_003]
    assert (damage.lost_bytes, damage.complete) == (beyond, False)


def test_a_length_that_damage_made_huge_takes_no_memory(tmp_path: Path) -> None:
    data = bytearray(mcap_bytes())
    _, begin, _ = [place for place in places(bytes(data)) if place[0] == CHUNK][4]
    struct.pack_into("<Q", data, begin + 1, 2**62)
    times, damage = read(write(tmp_path / "bag", bytes(data)))
    assert times == [1_000, 1_001, 1_002, 1_003]
    assert damage.lost_bytes == len(data) - begin


@pytest.mark.parametrize(
    ("damaged", "finished"),
    [
        (lambda data: data, True),
        (lambda data: data[:-1], False),
        (lambda data: data[: -len(MAGIC)], False),
        (lambda data: b"x" + data[1:], False),
        (lambda _: MAGIC, False),
        (lambda _: b"", False),
    ],
    ids=["whole", "a byte short", "no end", "another begin", "only a begin", "empty"],
)
def test_a_file_is_finished_when_it_begins_and_ends_as_mcap(
    tmp_path: Path, damaged: Callable[[bytes], bytes], finished: bool
) -> None:
    assert salvage.is_finished(write(tmp_path / "bag", damaged(mcap_bytes()))) is finished


def test_a_file_that_is_something_else_is_named_and_left_as_it_is(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", b"a text that is no bag")
    with pytest.raises(BagError, match="expected MCAP, found a file that begins with b'a text"):
        list(salvage.records(path))
    with pytest.raises(BagError):
        repair(tmp_path / "bag")
    assert path.read_bytes() == b"a text that is no bag"


# --- repair --------------------------------------------------------------------------------------------------------


def cut_bag(folder: Path, chunks: int = 4) -> Path:
    data = mcap_bytes()
    _, begin, _ = [place for place in places(data) if place[0] == CHUNK][chunks]
    write(folder, data[: begin + 20])
    return folder


def test_a_repaired_bag_has_every_time_number_attachment_and_fact_of_what_was_intact(tmp_path: Path) -> None:
    bag = cut_bag(tmp_path / "bag")
    done = repair(bag)
    assert (done.messages, done.lost_bytes, done.bad_chunks) == (4, 20, 0)
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [(m.log_time, m.publish_time, m.sequence, m.data) for _, _, m in reader.iter_messages()]
        attached = [(a.name, a.media_type, a.create_time, a.log_time, a.data) for a in reader.iter_attachments()]
        facts = [(fact.name, fact.metadata) for fact in reader.iter_metadata()]
    assert found == [(1_000 + i, 500 + i, 7 + i, b"payload %d" % i * 20) for i in range(4)]
    assert attached == [("parameters/node.yaml", "application/yaml", 11, 12, b"a: 1")]
    assert ("softgrip_machine", {"system": "test"}) in facts


def test_the_successor_is_on_the_disk_before_it_takes_the_place_of_the_damaged_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = cut_bag(tmp_path / "bag")
    before = (bag / "bag_0.mcap").read_bytes()
    order: list[str] = []
    fsync: Callable[[int], None] = os.fsync
    rename: Callable[..., Any] = Path.replace

    def watch_fsync(descriptor: int) -> None:
        order.append("written through")
        assert (bag / "bag_0.mcap").read_bytes() == before or "replaced" in order
        fsync(descriptor)

    def watch_replace(self: Path, target: Path) -> Path:
        if target.suffix == ".mcap":
            order.append("replaced")
        return rename(self, target)  # type: ignore[no-any-return]

    monkeypatch.setattr(os, "fsync", watch_fsync)
    monkeypatch.setattr(Path, "replace", watch_replace)
    repair(bag)
    assert order[:2] == ["written through", "replaced"]


def test_a_repair_that_finds_no_room_leaves_the_bag_as_it_was_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = cut_bag(tmp_path / "bag")
    before = (bag / "bag_0.mcap").read_bytes()

    def no_room(_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "finish", no_room)
    with pytest.raises(BagError, match="No space left"):
        repair(bag)
    assert [path.name for path in bag.iterdir()] == ["bag_0.mcap"]
    assert (bag / "bag_0.mcap").read_bytes() == before


def test_a_bag_that_can_not_be_repaired_does_not_keep_the_next_one_broken(tmp_path: Path) -> None:
    write(tmp_path / "a", b"something else")
    cut_bag(tmp_path / "b")
    found = list(repair_all(bags_in(tmp_path)))
    assert isinstance(found[0], BagError)
    assert not is_broken(tmp_path / "b")


def test_a_whole_file_without_metadata_is_broken_until_it_has_some(tmp_path: Path) -> None:
    write(tmp_path / "bag", mcap_bytes())
    assert is_broken(tmp_path / "bag")
    repair(tmp_path / "bag")
    assert not is_broken(tmp_path / "bag")
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    assert "nanoseconds_since_epoch: 1000\n" in text
    assert "nanoseconds: 5\n" in text, "from 1000 to 1005 ns"


def test_a_bag_of_two_files_begins_with_its_first_message_and_lasts_to_its_last(tmp_path: Path) -> None:
    write(tmp_path / "bag", mcap_bytes())
    later = io.BytesIO()
    writer = Writer(later)
    writer.start()
    channel = writer.register_channel("/a", "cdr", 0)
    writer.add_message(channel, 3_000, b"x", 3_000)
    writer.add_message(channel, 2_000, b"x", 2_000)
    writer.finish()
    (tmp_path / "bag" / "bag_1.mcap").write_bytes(later.getvalue())
    repair(tmp_path / "bag")
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    starts = [line.strip() for line in text.splitlines() if "nanoseconds_since_epoch" in line]
    spans = [line.strip() for line in text.splitlines() if "nanoseconds:" in line]
    counts = [line.strip() for line in text.splitlines() if "message_count:" in line]
    assert starts == [f"nanoseconds_since_epoch: {start}" for start in (1_000, 1_000, 2_000)]
    assert spans == [f"nanoseconds: {span}" for span in (2_000, 5, 1_000)]
    assert counts[0] == "message_count: 8"
