# SPDX-License-Identifier: Apache-2.0
"""Seconds lost when the recorder is killed with SIGKILL at random moments, and when its file is cut at random places.

Each time the bag is repaired and then read to its end by `rosbags` and by the `mcap` library, which have to find what
we find. A process writes a message per millisecond through the recorder's `Pipeline`; what is lost is the time from the
last message that can be read to the last that was given to the recorder before the kill (a note of which outlives the
process), or, for a cut, to the last message of the chunk that is cut.
"""

from __future__ import annotations

import argparse
import bisect
import mmap
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from softgrip_bag.offers import OfferedQos
from softgrip_bag.pipeline import Pipeline
from softgrip_bag.reader import bag_files, read
from softgrip_bag.repair import is_broken, repair
from softgrip_bag.writer import BagWriter, Topic
from softgrip_testing.benchmark_claim import claim, spread
from softgrip_time.units import to_s

GOAL_S = 0.5
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TOPIC = Topic("/text", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),))
PERIOD_S = 0.001
WHOLE_S = 4.0  # length of the bag that is cut
_SEED = 10
_DEADLINE_S = 30.0
_RANDOM_BYTES = 200  # per message: incompressible enough that cuts fall everywhere


def write(folder: Path) -> None:
    """Write a message per millisecond until killed, or until Ctrl-C, which finishes the bag."""
    bag = BagWriter(folder)
    bag.add_topic(TOPIC)
    pipeline = Pipeline(bag, 64_000_000)
    note = note_of(folder)
    note.write_bytes(bytes(8))
    stop: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: stop.append(number))
    with note.open("r+b") as stream, mmap.mmap(stream.fileno(), 8) as last:
        _write_until(stop, pipeline, last)
    pipeline.close()


def note_of(folder: Path) -> Path:
    """Return the file that holds the time [ns] of the last message given to the recorder."""
    return folder.with_name(f"{folder.name}.last")


def _write_until(stop: list[int], pipeline: Pipeline, last: mmap.mmap) -> None:
    text = random.Random(1)
    while not stop:
        body = bytes(text.choices(range(32, 127), k=_RANDOM_BYTES)) + b"\0"
        now = time.time_ns()
        pipeline.put(TOPIC.name, now, now, b"\0\1\0\0" + len(body).to_bytes(4, "little") + body)
        last[:] = now.to_bytes(8, "little")
        time.sleep(PERIOD_S)


def stop_once(folder: Path, after_s: float, how: signal.Signals) -> int:
    """Have a writer stopped [s] after its first message is on the disk; returns its last message's time [ns]."""
    writer = subprocess.Popen([sys.executable, str(Path(__file__).resolve()), "--write", str(folder)])
    deadline = time.monotonic() + _DEADLINE_S
    try:
        while not (list(folder.glob("*.mcap")) and any(read(folder))):
            if time.monotonic() > deadline:
                raise RuntimeError("expected a bag with messages, found none")
            time.sleep(0.01)
        time.sleep(after_s)
        writer.send_signal(how)
        writer.wait(_DEADLINE_S)
    finally:
        writer.kill()
    return int.from_bytes(note_of(folder).read_bytes(), "little")


def kill_once(folder: Path, after_s: float) -> float:
    """Have a writer killed so long [s] after its first message is on the disk; returns the seconds lost."""
    given = stop_once(folder, after_s, signal.SIGKILL)
    last = check(folder)
    return to_s(given - last)


def check(folder: Path) -> int:
    """Repair a bag and have it opened by others; returns the time of the last message [ns]."""
    before = [message.received for message in read(folder)]
    if not is_broken(folder):
        raise RuntimeError(f"expected a broken bag, found {folder} whole")
    repair(folder)
    with bag_files(folder)[0].open("rb") as stream:
        by_mcap = [m.log_time for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]
    by_rosbags = []
    if before:  # rosbags refuses a bag without messages
        with AnyReader([folder]) as reader:
            by_rosbags = [at for _, at, _ in reader.messages()]
    if not before == by_mcap == by_rosbags:
        raise RuntimeError(f"{folder}: expected {len(before)} messages, mcap {len(by_mcap)}, rosbags {len(by_rosbags)}")
    return before[-1] if before else 0


def cut_once(whole: Path, size: int, folder: Path) -> float:
    """Cut a bag's file; returns the seconds between the last readable message and the last that had begun."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    with bag_files(whole)[0].open("rb") as stream:
        (folder / f"{folder.name}_0.mcap").write_bytes(stream.read(size))
    last = check(folder)
    first, times, ends = _chunks(bag_files(whole)[0])
    at = min(bisect.bisect_left(ends, size), len(times) - 1)
    return to_s(times[at] - (last or first))


def _chunks(path: Path) -> tuple[int, list[int], list[int]]:
    """Return the first message's time [ns], and of every chunk the last message's [ns] and the end [byte]."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    return (
        chunks[0].message_start_time,
        [c.message_end_time for c in chunks],
        [c.chunk_start_offset + c.chunk_length for c in chunks],
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=100, help="kills, and cuts (default 100)")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.write:
        write(options.write)
        return 0
    chance = random.Random(_SEED)
    with tempfile.TemporaryDirectory(prefix="softgrip-crash-") as name:
        folder = Path(name)
        lost = [kill_once(folder / f"killed_{k}", chance.uniform(0.0, 0.6)) for k in range(options.times)]
        whole = folder / "whole"
        stop_once(whole, WHOLE_S, signal.SIGINT)
        size = bag_files(whole)[0].stat().st_size
        data = sum(1 for _ in read(whole))
        cuts = [cut_once(whole, chance.randrange(size), folder / "cut") for _ in range(options.times)]
    for what, values, note in (
        ("seconds lost after kill -9", lost, f"largest of {len(lost)} random moments"),
        (
            "seconds lost after truncation",
            cuts,
            f"largest of {len(cuts)} cuts of a file of {size} bytes, {data} messages",
        ),
    ):
        claim(
            what,
            max(values),
            "s",
            better="lower",
            goal=GOAL_S,
            runs=len(values),
            note=f"{note}; {spread(values, 's')}; all repaired, and read by rosbags and mcap to the same messages",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
