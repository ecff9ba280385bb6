# SPDX-License-Identifier: Apache-2.0
"""A synthetic closing with noise from a seed, and empty databases of both kinds."""

from __future__ import annotations

import itertools
import math
import os
import random
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.finger_records import read_finger_records
from softgrip_cell.grasp.commands import Close, Open, Press
from softgrip_cell.grasp.contact import ContactState, FingerContact
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.sequence import GraspSequence, GraspStep
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspTask
from softgrip_cell.observation import FreeMotion, ObservedPair, TendonSample
from softgrip_cell.storage import Database, Library

SLOTS = ("index", "middle", "thumb")
_DATABASES = itertools.count()
PERIOD_NS = 5_000_000  # 200 Hz


def free_tension(pulled_length_m: float) -> float:
    """A finger like a spring with some friction: 0.8 N/mm and a little more than linear."""
    mm = pulled_length_m * 1e3
    return 0.4 * mm + 0.02 * mm * mm


def tip(pulled_length_m: float) -> tuple[float, float]:
    """A tip on a circle of 60 mm whose angle grows by 80 degrees per 20 mm: 4.19 m of path per m pulled."""
    angle = math.radians(4.0e3 * pulled_length_m)
    return (0.060 * math.cos(angle), -0.060 * math.sin(angle))


@dataclass
class Bench:
    """Three fingers, a driver that obeys at once, and an object that is a spring from a pulled length on.

    Attributes:
        contact_m: pulled length at which each finger touches; infinity for none.
        stiffness_n_per_m: excess tension per pulled length beyond the contact.
        gain: this finger's tension over the predicted one.
        creep_n: tension that creep has taken from the free motion since the reference was learned.
        grip: factor on the excess as a function of time since the hold began [s]: what slipping looks like.
        drive_n: what the drives show beside their tendons' tension, as a function of the pulled length [m].
    """

    contact_m: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    stiffness_n_per_m: float = 2000.0
    gain: float = 1.12
    noise_n: float = 0.08
    creep_n: float = 0.0
    grip: Callable[[float], float] = lambda _: 1.0
    drive_n: Callable[[float], float] = lambda _: 0.0
    seed: int = 1
    broken: frozenset[int] = frozenset()
    pulled_length_m: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    now_ns: int = 1_000_000_000

    def __post_init__(self) -> None:
        self._rng = random.Random(self.seed)
        self._goal = Close((), (), 0.0, 0.0)
        self._held_ns: int | None = None
        self._pressed: set[int] = set()
        self._tension_n: dict[int, float] = {}
        self._press_speed = 0.0
        self.commands: list[object] = []
        self.peak_contact_tension_n = 0.0

    def obey(self, step: GraspStep) -> None:
        for command in step.commands:
            self.commands.append(command)
            if isinstance(command, Open):
                self.pulled_length_m = [0.0, 0.0, 0.0]
                self._goal = Close((), (), 0.0, 0.0)
                self._tension_n.clear()
            elif isinstance(command, Close):
                self._goal = command
                for slot in command.slots:
                    self._tension_n.pop(slot, None)
            else:
                pressed = command.slots if isinstance(command, Press) else range(3)
                self._goal = self._without(pressed)
                if isinstance(command, Press):
                    self._tension_n.update(zip(command.slots, command.tensions_n, strict=True))
                    self._press_speed = command.speed_m_per_s or 0.05
                else:
                    self._tension_n.clear()
                self._pressed |= set(pressed)
                if len(self._pressed) == 3:
                    self._held_ns = self._held_ns or self.now_ns

    def _true_tension_n(self, slot: int, held_s: float) -> float:
        pulled = self.pulled_length_m[slot]
        contact_tension_n = max(0.0, pulled - self.contact_m[slot]) * self.stiffness_n_per_m * self.grip(held_s)
        return max(0.0, self.gain * free_tension(pulled) - self.creep_n) + contact_tension_n

    def _without(self, slots: Sequence[int]) -> Close:
        kept = [(s, t) for s, t in zip(self._goal.slots, self._goal.targets_m, strict=True) if s not in slots]
        return replace(self._goal, slots=tuple(s for s, _ in kept), targets_m=tuple(t for _, t in kept))

    def pair(self, period_ns: int = PERIOD_NS) -> ObservedPair:
        """Advance by one period and look."""
        self.now_ns += period_ns
        for slot, target_m in zip(self._goal.slots, self._goal.targets_m, strict=True):
            travel = self._goal.speed_m_per_s * period_ns * 1e-9
            self.pulled_length_m[slot] = min(target_m, self.pulled_length_m[slot] + travel)
        held_s = 0.0 if self._held_ns is None else (self.now_ns - self._held_ns) * 1e-9
        for slot, requested_n in self._tension_n.items():
            for _ in range(period_ns // PERIOD_NS):
                if self._true_tension_n(slot, held_s) < requested_n and self.pulled_length_m[slot] < 0.035:
                    self.pulled_length_m[slot] += self._press_speed * PERIOD_NS * 1e-9
        tensions = []
        for slot, pulled in enumerate(self.pulled_length_m):
            true_n = self._true_tension_n(slot, held_s)
            self.peak_contact_tension_n = max(self.peak_contact_tension_n, true_n - self.gain * free_tension(pulled))
            shown_n = true_n + self.drive_n(pulled) + self._rng.gauss(0.0, self.noise_n)
            tensions.append(0.0 if slot in self.broken else shown_n)
        sample = TendonSample(self.now_ns, tuple(self.pulled_length_m), tuple(tensions))
        return ObservedPair(sample, predict(sample))


def predict(sample: TendonSample) -> FreeMotion:
    return FreeMotion(
        stamp_ns=sample.stamp_ns,
        pulled_length_m=sample.pulled_length_m,
        tension_n=tuple(free_tension(pulled) for pulled in sample.pulled_length_m),
        tip_m=tuple(tip(pulled) for pulled in sample.pulled_length_m),
        friction_model="synthetic",
    )


def reference(gain: float = 1.12, noise_n: float = 0.08) -> FreeReference:
    rows = tuple(i * 1e-3 for i in range(21))
    return FreeReference(
        pulled_length_m=rows,
        offset_n=tuple((gain - 1.0) * free_tension(row) for row in rows),
        tension_n=tuple(gain * free_tension(row) for row in rows),
        stddev_n=noise_n,
        friction_model="synthetic",
    )


@pytest.fixture
def contact() -> Callable[..., FingerContact]:
    """Make a finger's contact: 8 mm pulled, 5 N of free motion, 2 N beside it, short of its end."""

    def make(
        pulled_length_m: float = 0.008, free_n: float = 5.0, contact_tension_n: float = 2.0, *, is_short: bool = True
    ) -> FingerContact:
        return FingerContact(
            state=ContactState.BLOCKED if is_short else ContactState.CONTACT,
            pulled_length_m=pulled_length_m,
            tension_n=free_n + contact_tension_n,
            free_n=free_n,
            contact_tension_n=contact_tension_n,
            stddev_n=0.07,
            threshold_n=0.35,
            punctual_threshold_n=0.35,
            strength_n=contact_tension_n,
            force_n=contact_tension_n,
            log_likelihood=20.0,
            is_touching=True,
            is_short=is_short,
        )

    return make


@pytest.fixture
def bench() -> type[Bench]:
    """The class of the synthetic bench."""
    return Bench


@pytest.fixture
def task() -> Callable[..., GraspTask]:
    """Make a task for a product of the shipped catalogue."""

    def make(product: str = "egg", *, confirm_lift: bool = False) -> GraspTask:
        made = read_catalogue().products[product]
        return GraspTask(made, made.recipe, SLOTS, (reference(),) * 3, 2, confirm_lift)

    return make


@pytest.fixture
def run() -> Callable[..., Iterator[GraspStep]]:
    """Drive a sequence with a bench until a verdict or a deadline of the bench's own time."""

    def drive(
        sequence: GraspSequence, bench: Bench, limit_s: float = 30.0, settings: GraspSettings | None = None
    ) -> Iterator[GraspStep]:
        step = sequence.start()
        bench.obey(step)
        yield step
        end_ns = bench.now_ns + int(limit_s * 1e9)
        while step.verdict is None and bench.now_ns < end_ns:
            step = sequence.observe(bench.pair())
            bench.obey(step)
            yield step

    return drive


@pytest.fixture(scope="session")
def postgres_base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL prefix of a PostgreSQL of our own on a Unix socket; skips where none is installed."""
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    if not programs:
        pytest.skip("no PostgreSQL in /usr/lib/postgresql; apt install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="softgrip-pg-", dir="/tmp"))  # a socket path has to be short
    # PostgreSQL refuses to run as root.
    user = "postgres" if os.geteuid() == 0 else None
    if user is not None:
        shutil.chown(folder, user)
    socket = f"-c listen_addresses='' -c unix_socket_directories={folder} -c fsync=off"

    def server(*arguments: str) -> None:
        subprocess.run([*map(str, arguments)], check=True, capture_output=True, user=user, cwd="/", timeout=60)

    data = folder / "data"
    server(str(programs[0] / "initdb"), "-D", str(data), "-U", "softgrip", "-A", "trust", "--no-sync")
    log = str(folder / "log")
    server(str(programs[0] / "pg_ctl"), "-D", str(data), "-o", socket, "-l", log, "-w", "start")
    try:
        yield f"postgresql://softgrip@/{{name}}?host={folder}"
    finally:
        server(str(programs[0] / "pg_ctl"), "-D", str(data), "-m", "immediate", "-w", "stop")
        shutil.rmtree(folder)


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """URL of an empty database, once in SQLite and once in PostgreSQL."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/cell.db"
        return
    psycopg = pytest.importorskip("psycopg")
    base: str = request.getfixturevalue("postgres_base")
    name = f"cell_{os.getpid()}_{next(_DATABASES)}"
    with psycopg.connect(base.format(name="postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE template0")
    yield base.format(name=name)


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """A database with the shipped catalogue and finger records."""
    with Database(f"sqlite:///{tmp_path}/cell.db", exclusive=True) as opened:
        library = Library(opened, lambda: 1)
        library.import_catalogue(read_catalogue(), "test")
        library.import_finger_records(read_finger_records().values(), "test")
        yield opened
