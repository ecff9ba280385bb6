# SPDX-License-Identifier: Apache-2.0
"""Structured hostile inputs over every topic, service, action, parameter and liveliness token of a running cell.

A stranger who knows only the interface texts sends them over Zenoh (`_hostile`): values that nobody would send, cut
and mutated messages, garbage, tokens of nodes that cannot be. Counted: processes that ended, and how much memory the
one that grew most takes in the end. The note says for how long tendon/state stopped at most, by the driver's own
stamps, with and without the stranger. The emulated cell's time waits for whichever node the stranger keeps busy, so
there tendon/state stops, too; ``--real`` says what it does where time waits for nobody.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import itertools
import multiprocessing
import sys
import tempfile
import time
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import zenoh
from _hostile import Generator, Input, Stranger, open_client
from _live_cell import START_S, bench, cell

from embedded_ros import wire
from embedded_ros.wire import Entity, EntityKind
from softgrip_nodekit import claim_processor
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.process_table import node_processes, resident_bytes
from softgrip_time.units import to_s

DOMAIN = 213
COUNT = 100_000
#: [1/s] A stranger that sends as fast as it can shows how fast the computer is. 0 = that.
RATE = 500.0
#: Inputs before memory is measured first: what nodes make on first use is no growth.
WARM_UP = 5_000
SETTLE_S = 8.0
BASELINE_S = 15.0
LOOK_S = 0.5
#: Inputs of one session; then the stranger leaves in the middle of everything and comes back.
SESSION_INPUTS = 5_000
#: Priority of who watches whether the computer itself stands: in front of all of the cell.
FIRST = 90
LOOK_AT_CLOCK_S = 0.005
#: Stops of tendon/state that the trace names.
NAMED_STOPS = 10
GOAL_ENDED, GOAL_GROWTH_MB = 0, 50.0
EMULATOR = "emulated_cell"
NODES = (
    EMULATOR, "recorder", "tendon_driver", "friction_rig", "kinematics_predictor", "gdfe_simulator", "camera",
    "marker_tracker", "grasp_mix_manager",
)  # fmt: skip
MIB = 1 << 20


class Watch:
    """Notes which processes ended, and how much memory each takes."""

    def __init__(self, session: int) -> None:
        self._session = session
        self._known = node_processes(session)
        self.ended: list[str] = []
        self.first: dict[str, float] = {}
        self.peak: dict[str, float] = {}

    def look(self) -> list[str]:
        """Return the names of processes that ended since the last look."""
        now = node_processes(self._session)
        gone = [name for name, process in self._known.items() if now.get(name) != process]
        self._known.update(now)
        for name in gone:
            if name not in now:
                self._known.pop(name)
        self.ended += gone
        for name, process in now.items():
            self.peak[name] = max(self.peak.get(name, 0.0), resident_bytes(process) / MIB)
        return gone

    def begin(self) -> None:
        """Take what memory they have now as the beginning."""
        self.first = {name: resident_bytes(process) / MIB for name, process in self._known.items()}
        self.peak = dict(self.first)

    def growth(self) -> dict[str, float]:
        """Return by how much [MiB] each has grown that was there all the time."""
        return {
            name: resident_bytes(process) / MIB - self.first[name]
            for name, process in self._known.items()
            if name in self.first and name not in self.ended
        }


@dataclass(frozen=True)
class Stops:
    """How regularly one publisher was heard for a while.

    Attributes:
        longest: the longest times [s] between two samples, with the first one's stamp [ns since the epoch].
        lost: samples that went missing on the way.
        machine_s: longest time [s] for which a process before all others did not run: the computer itself stood.
    """

    longest: tuple[tuple[float, int], ...]
    lost: int
    machine_s: float = 0.0

    @property
    def maximum_s(self) -> float:
        """The longest time between two samples [s]; infinite where there were none."""
        return self.longest[0][0] if self.longest else float("inf")


class Stamps:
    """Listens to one publisher from a process of its own, which nothing the stranger does holds up.

    Args:
        stranger: who finds the publisher.
    """

    def __init__(self, stranger: Stranger) -> None:
        entity = publisher(stranger, "tendon_driver", "/tendon/state")
        gid = wire.gid_of(wire.encode_token(entity))
        key = wire.data_key(stranger.domain, entity.name, entity.type, entity.hash)
        spawn = multiprocessing.get_context("spawn")
        self._questions, theirs = spawn.Pipe()
        spawn.Process(target=listen, args=(stranger.domain, key, gid, theirs), daemon=True).start()
        self._questions.recv()
        self._machine, theirs = spawn.Pipe()
        spawn.Process(target=watch_machine, args=(theirs,), daemon=True).start()

    def stops(self) -> Stops:
        """Return what was heard since the last call."""
        self._machine.send(None)
        machine_s: float = self._machine.recv()
        self._questions.send(None)
        return replace(self._questions.recv(), machine_s=machine_s)


def publisher(stranger: Stranger, node: str, topic: str) -> Entity:
    """Wait for a node's publisher; return it."""
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        for entity in stranger.entities():
            if entity.kind is EntityKind.PUBLISHER and (entity.node, entity.name) == (node, topic):
                return entity
        time.sleep(0.1)
    raise TimeoutError(f"expected {node} to publish {topic} within {START_S:.0f} s, found no publisher")


def listen(domain: int, key: str, gid: bytes, questions: Any) -> None:
    """Answer each question with the `Stops` since the last one."""
    heard: list[tuple[int, int]] = []

    def take(sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        if attachment is None or len(attachment) != wire.ATTACHMENT_BYTES:
            return
        with contextlib.suppress(ValueError):  # the stranger sends here, too
            sequence, stamp_ns, sender = wire.decode_attachment(attachment.to_bytes())
            if sender == gid:
                heard.append((sequence, stamp_ns))

    session = open_client(domain)
    subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(take, indirect=False))
    questions.send(None)
    while True:
        try:
            questions.recv()
        except EOFError:
            subscriber.undeclare()
            session.close()
            return
        count = len(heard)
        pairs = list(itertools.pairwise(heard[:count]))
        # of samples that got lost nobody knows the times: the time between their neighbours is shared out
        lengths = ((to_s(b[1] - a[1]) / max(1, b[0] - a[0]), a[1]) for a, b in pairs)
        longest = tuple(heapq.nlargest(NAMED_STOPS, lengths))
        questions.send(Stops(longest, sum(max(0, b[0] - a[0] - 1) for a, b in pairs)))
        del heard[: max(0, count - 1)]


def watch_machine(questions: Any) -> None:
    """Look at the clock again and again; answer each question with how late [s] a look came at most."""
    claim_processor(FIRST)
    longest, before = 0.0, time.monotonic()
    while True:
        is_asked = questions.poll(LOOK_AT_CLOCK_S)
        now = time.monotonic()
        longest, before = max(longest, now - before - LOOK_AT_CLOCK_S), now
        if is_asked:
            try:
                questions.recv()
            except EOFError:
                return
            questions.send(longest)
            longest = 0.0


def attack(
    stranger: Stranger, generator: Generator, watch: Watch, count: int, rate: float, trace: TextIO | None
) -> float:
    """Send inputs and watch; return how many were sent a second. What preceded an end goes to stderr."""
    last: deque[Input] = deque(maxlen=200)
    started = looked = time.monotonic()
    for number in range(1, count + 1):
        if number % SESSION_INPUTS == 0:
            stranger.come_back()
        if rate:
            time.sleep(max(0.0, started + number / rate - time.monotonic()))
        item = generator.next()
        last.append(item)
        if trace:
            trace.write(f"{time.time_ns()} {item.target.name if item.target else 'token'} {item.payload[:24]!r}\n")
        stranger.send(item)
        if time.monotonic() - looked > LOOK_S:
            looked = time.monotonic()
            for name in watch.look():
                print(f"{name} ended; sent before:", file=sys.stderr)
                for one in last:
                    target = one.target.name if one.target else "token"
                    print(f"  {target} {one.payload[:80]!r} {one.attachment!r}", file=sys.stderr)
    return count / (time.monotonic() - started)


def wait_for_nodes(session: int, nodes: set[str]) -> None:
    """Wait until every node runs and has come to rest."""
    end = time.monotonic() + START_S
    while not nodes <= node_processes(session).keys():
        if time.monotonic() > end:
            raise TimeoutError(f"expected {sorted(nodes)}, found {sorted(node_processes(session))}")
        time.sleep(0.1)
    time.sleep(SETTLE_S)


def main() -> None:
    """Run the cell, attack it, print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, help="inputs (default %(default)s)")
    parser.add_argument(
        "--rate", type=float, default=RATE, help="inputs a second, 0 = all it can (default %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--real", action="store_true", help="hardware:=real over the wires of an emulated cell: drives in real time"
    )
    parser.add_argument("--baseline", type=float, default=BASELINE_S, help="[s] without the stranger")
    parser.add_argument("--log", type=Path, help="file for what the cell says")
    parser.add_argument("--trace", type=Path, help="file for what was sent when, and when tendon/state stopped longest")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = arguments.log or Path(folder) / "cell.log"
        with (bench if arguments.real else cell)(str(DOMAIN), log=log) as launch:
            wait_for_nodes(launch.pid, set(NODES) - ({EMULATOR} if arguments.real else set()))
            stranger = Stranger(DOMAIN)
            try:
                with arguments.trace.open("w") if arguments.trace else contextlib.nullcontext() as trace:
                    run(stranger, launch.pid, arguments, log, trace)
            finally:
                stranger.close()


def run(stranger: Stranger, session: int, arguments: argparse.Namespace, log: Path, trace: TextIO | None) -> None:
    """Attack a running cell and print the claims."""
    stamps = Stamps(stranger)
    stamps.stops()
    time.sleep(arguments.baseline)
    without = stamps.stops()
    watch = Watch(session)
    targets = stranger.targets()
    generator = Generator(targets, arguments.seed, DOMAIN)
    warm_up = min(WARM_UP, arguments.count // 2)
    attack(stranger, generator, watch, warm_up, arguments.rate, trace)
    watch.begin()
    logged = log.stat().st_size
    rate = attack(stranger, generator, watch, arguments.count - warm_up, arguments.rate, trace)
    during = stamps.stops()
    if trace:
        trace.writelines(
            f"{begun} tendon/state stopped for {1e3 * length:.0f} ms\n" for length, begun in during.longest
        )
    time.sleep(SETTLE_S)
    watch.look()
    growth = watch.growth()
    services = sum(target.is_service for target in targets)
    note = (
        f"{arguments.count} inputs, seed {arguments.seed}, {rate:.0f} a second, over {len(targets) - services} topics, "
        f"{services} services and tokens; {stranger.answered} answered, {stranger.refused} refused; "
        f"tendon/state stopped for {1e3 * during.maximum_s:.0f} ms at most, "
        f"{1e3 * without.maximum_s:.0f} ms without; the computer itself for {1e3 * during.machine_s:.0f} and "
        f"{1e3 * without.machine_s:.0f} ms ({during.lost} samples lost on the way); "
        f"log {(log.stat().st_size - logged) / MIB:.1f} MiB"
    )
    ended = ", ".join(watch.ended) or "none"
    claim(
        "processes ended",
        len(watch.ended),
        "",
        better="lower",
        goal=GOAL_ENDED,
        runs=1,
        note=f"{ended} of {len(watch.peak)}; {note}",
    )
    worst = max(growth, key=lambda name: growth[name])
    shares = ", ".join(
        f"{name} {growth[name]:+.1f} (peak {watch.peak[name] - watch.first[name]:+.1f})" for name in sorted(growth)
    )
    claim(
        "memory growth",
        round(growth[worst], 1),
        "MiB",
        better="lower",
        goal=GOAL_GROWTH_MB,
        runs=1,
        note=f"{worst}; {shares}",
    )


if __name__ == "__main__":
    main()
