# SPDX-License-Identifier: Apache-2.0
"""The cell's rules: what it knows, what it allows, what it remembers. No ROS; storage behind Library and Journal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import IntEnum

from softgrip_cell import gates
from softgrip_cell.errors import RefusedError, StorageError
from softgrip_cell.gates import DriverFacts, FrictionFacts, FrictionLimits, SafetyFacts
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.values import GraspOutcome, GraspTask, GraspVerdict
from softgrip_cell.observation import TendonSample
from softgrip_cell.outcomes import SuccessEstimate, Tally, estimate
from softgrip_cell.planner import Durations, Order, Plan, admissible_sets, plan_mix
from softgrip_cell.products import Catalogue, FingerSet, GraspType, Product, TableMark
from softgrip_cell.storage.journal import (
    CellJournal,
    Counts,
    HeldLock,
    MountedSlot,
    OpenOperation,
    SlotState,
    SwapOutcome,
)
from softgrip_cell.storage.library import Library
from softgrip_cell.storage.pending import PendingWrites
from softgrip_cell.swap.check import Finding, FingerCheck
from softgrip_cell.swap.sequence import HANDS_OUT_TEXT, PersistAction, SwapSequence, SwapStep, SwapTransition


class CellMode(IntEnum):
    """What the cell is doing (CellState.mode)."""

    UNKNOWN = 0
    IDLE = 1
    SWAPPING = 2
    GRASPING = 3
    HOLDING = 4
    FAULT = 6  # 5 is not used
    ESTOP = 7


@dataclass(frozen=True)
class Choice:
    """How a product is to be grasped, and with what."""

    product: Product
    finger_set: FingerSet
    swap_needed: bool
    reason: str


@dataclass(frozen=True)
class Clocks:
    """Where time comes from: wall time for records [ns since the epoch], monotonic time for durations [s]."""

    now_ns: Callable[[], int]
    monotonic_s: Callable[[], float]


@dataclass(frozen=True)
class Agreements:
    """How many messages in a row are believed.

    Attributes:
        open_samples: tendon samples with all fingers open, until what was held counts as gone.
        worn_residuals: residuals that call a finger worn, until its finger record says so for good.
    """

    open_samples: int = 10
    worn_residuals: int = 5


class Availability:
    """Adds up time with and without a fault.

    Args:
        now_s: when counting starts, of a monotonic clock [s].
    """

    def __init__(self, now_s: float) -> None:
        self._since_s = now_s
        self._start_s = now_s
        self._down_s = 0.0
        self._is_down = False

    def update(self, now_s: float, *, down: bool) -> None:
        """Take the present condition."""
        if self._is_down:
            self._down_s += now_s - self._since_s
        self._since_s = now_s
        self._is_down = down

    def share(self, now_s: float) -> float:
        """Return the share of time without a fault since the start [0..1]; 1 before any time has passed."""
        total_s = now_s - self._start_s
        down_s = self._down_s + (now_s - self._since_s if self._is_down else 0.0)
        return 1.0 if total_s <= 0.0 else 1.0 - down_s / total_s


class Agreement:
    """Counts observations in a row that say the same.

    Args:
        needed: so many in a row are believed.
    """

    def __init__(self, needed: int) -> None:
        self._needed = needed
        self._run = 0

    def observe(self, agrees: bool) -> bool:
        """Take one observation; return whether enough in a row, this one included, have agreed."""
        self._run = self._run + 1 if agrees else 0
        return self._run >= self._needed

    def forget(self) -> None:
        """Begin again."""
        self._run = 0


class Cell:
    """One cell. A database that cannot be written is a fault, never the end: what happened is written when it can be.

    Args:
        library: products, finger sets, finger records.
        journal: slots, operations, outcomes.
        thumb: index of the slot that presses against the others.
        limits: how far a friction model is trusted.
        clocks: time.
        agreements: how many messages in a row are believed.
        prepare: opens and fills the database; called before it is used, again until it does not raise StorageError.
    """

    def __init__(
        self,
        library: Library,
        journal: CellJournal,
        thumb: int,
        limits: FrictionLimits,
        clocks: Clocks,
        agreements: Agreements = Agreements(),
        prepare: Callable[[], None] = lambda: None,
    ) -> None:
        self._library = library
        self._journal = journal
        self._thumb = thumb
        self._limits = limits
        self._clocks = clocks
        self._agreements = agreements
        self._prepare = prepare
        self._driver = DriverFacts(is_heard=False, estop=False)
        self._safety = SafetyFacts(is_heard=False)
        self._friction: Callable[[], FrictionFacts | None] = lambda: None
        self._busy: CellMode | None = None
        self._product = ""
        self._note = ""
        #: Why mounted fingers were found worn in this run, by serial.
        self._worn: dict[str, str] = {}
        self._availability = Availability(clocks.monotonic_s())
        self._open_run = Agreement(agreements.open_samples)
        self._worn_runs: dict[str, Agreement] = {}
        self._catalogue = Catalogue({}, {})
        self._slots: tuple[MountedSlot, ...] = tuple(MountedSlot(name) for name in journal.names)
        self._counts = Counts({}, 0, 0.0)
        #: What was going on when the last manager ended without finishing it.
        self.cut_off: OpenOperation | None = None
        #: Lock of the drives that this cell holds; hands may be inside.
        self._lock: HeldLock | None = None
        self._swap: SwapSequence | None = None
        self._writes = PendingWrites()
        self._writes.do(self._take_up)

    def _take_up(self) -> None:
        """Take up what the last run left."""
        self._prepare()
        self._catalogue = self._library.catalogue()
        self.cut_off = self._journal.recover() or self.cut_off
        self._lock = self._journal.lock()
        self._slots = self._journal.slots()
        self._counts = self._journal.counts()
        cut = self.cut_off
        if cut is not None:
            self._note = cut.text
            if cut.kind == "grasp":
                self._busy, self._product = CellMode.UNKNOWN, cut.subject
                self._note += "; a product may be held: call tendon/release when it may be let go"
            elif self._lock is None:
                self._note += "; nothing moves by itself: call tendon/release or cell/swap when all hands are out"
        if self._lock is not None:
            self._busy = CellMode.SWAPPING
            self._note = "; ".join(filter(None, (self._note, HANDS_OUT_TEXT)))

    def now_s(self) -> float:
        """Monotonic time [s]."""
        return self._clocks.monotonic_s()

    def slots(self) -> tuple[MountedSlot, ...]:
        """Return what the slots hold now."""
        return self._slots

    def catalogue(self) -> Catalogue:
        """Read products and finger sets in force: they may be edited while the cell runs."""
        with self._storage():
            self._catalogue = self._library.catalogue()
        return self._catalogue

    def mounted_set(self) -> FingerSet | None:
        """Return the set in all slots, None when mixed or unknown."""
        return gates.mounted_set(self._slots, list(self._catalogue.finger_sets.values()))

    @property
    def mode(self) -> CellMode:
        """What the cell is doing; a fault outranks everything but the e-stop. Unknown until the driver was heard."""
        if self._driver.estop or self._safety.estop:
            return CellMode.ESTOP
        if self._driver.faults or self._writes.fault:
            return CellMode.FAULT
        if self._busy is not None:
            return self._busy
        return CellMode.IDLE if self._driver.is_heard else CellMode.UNKNOWN

    @property
    def may_hold(self) -> bool:
        """Whether a product is held, or may be."""
        return self._busy in (CellMode.HOLDING, CellMode.UNKNOWN)

    @property
    def lock(self) -> HeldLock | None:
        """The lock of the drives that this cell holds; hands may be inside while there is one."""
        return self._lock

    def update_driver(self, driver: DriverFacts) -> None:
        """Take what the driver says."""
        self._driver = driver
        self._availability.update(self.now_s(), down=self.mode in (CellMode.FAULT, CellMode.ESTOP))

    def update_safety(self, safety: SafetyFacts) -> None:
        """Take what keeps the actuators from moving."""
        self._safety = safety

    def retry_writes(self) -> None:
        """Write what the database did not take before, if anything."""
        self._writes.retry()

    def update_friction(self, facts: Callable[[], FrictionFacts | None]) -> None:
        """Take the active friction model, as a function because its age grows."""
        self._friction = facts

    def observe_sample(self, sample: TendonSample, open_m: float) -> None:
        """Notice that the fingers were opened, by samples in a row that say so: whatever was held is gone."""
        if not self.may_hold:
            self._open_run.forget()
        elif self._open_run.observe(all(pulled <= open_m for pulled in sample.pulled_length_m)):
            self._busy, self._product, self._note = None, "", ""

    def state(self) -> dict[str, object]:
        """Return the fields of CellState beside mode, slots and stamp."""
        mounted = self.mounted_set()
        outcomes = self._counts.outcomes
        faults = "; ".join(filter(None, (*self._driver.faults, self._writes.fault)))
        foreign_lock = "" if self._lock is not None else self._safety.lock_text
        return {
            "finger_set": mounted.id if mounted else "",
            "product": self._product,
            "picks": sum(outcomes.values()),
            "gripped": outcomes.get(GraspOutcome.GRIPPED, 0),
            "empty": outcomes.get(GraspOutcome.EMPTY, 0),
            "slipped": outcomes.get(GraspOutcome.SLIPPED, 0),
            "tendon_faults": outcomes.get(GraspOutcome.TENDON_FAULT, 0),
            "aborted": outcomes.get(GraspOutcome.ABORTED, 0),
            "swaps": self._counts.swaps,
            "mean_swap_time": self._counts.mean_swap_s,
            "availability": self._availability.share(self.now_s()),
            "fault": faults,
            "reason": "; ".join(filter(None, (self._note, foreign_lock))),
        }

    def estimates(self, catalogue: Catalogue) -> dict[str, dict[str, SuccessEstimate]]:
        """Return what is known of every product with every finger set: table marks and counted grasps."""
        tallies = self._journal.tallies()
        return {
            product.id: {
                name: estimate(product.marks.get(name), tallies.get((product.id, name), Tally()))
                for name in catalogue.finger_sets
            }
            for product in catalogue.products.values()
        }

    def select(self, product_id: str) -> Choice:
        """Choose a finger set for a product: the mounted one where it will do.

        Raises:
            RefusedError: the product is not in the mix or no usable set holds it.
        """
        catalogue = self.catalogue()
        estimates = self.estimates(catalogue)
        good = admissible_sets(product_id, estimates, self._usable_sets(catalogue))
        product = catalogue.products[product_id]
        mounted = self.mounted_set()
        known = estimates[product_id]
        if mounted is not None and mounted.id in good:
            chosen = mounted.id
        else:
            chosen = max(good, key=lambda name: (known[name].mean, catalogue.finger_sets[name].grasp == product.grasp))
        finger_set = catalogue.finger_sets[chosen]
        swap = mounted is None or mounted.id != chosen
        rate = known[chosen]
        reason = (
            f"'{product_id}' is a {product.grasp.value} product (Table 4.1); {chosen}: {rate.mark.value}, "
            f"expected success {rate.mean:.2f} [{rate.low:.2f}, {rate.high:.2f}] after {rate.grasps} grasps; "
        )
        if not swap:
            reason += f"'{chosen}' is mounted"
        else:
            reason += f"mounted is {mounted.id if mounted else 'nothing known'}"
        self._product = product_id if self._busy is None else self._product
        return Choice(product, finger_set, swap, reason)

    def plan(self, orders: Sequence[Order], *, keep_order: bool) -> Plan:
        """Plan the work for an order list; see planner.plan_mix."""
        catalogue = self.catalogue()
        mounted = self.mounted_set()
        durations = Durations()
        if self._counts.swaps:
            durations = replace(durations, swap_s=self._counts.mean_swap_s)
        return plan_mix(
            orders,
            self.estimates(catalogue),
            self._usable_sets(catalogue),
            mounted.id if mounted else None,
            keep_order=keep_order,
            durations=durations,
        )

    def begin_grasp(self, product_id: str, *, confirm_lift: bool, trial: bool) -> GraspTask:
        """Check every gate and take the cell.

        Raises:
            RefusedError: with the reason.
        """
        self._refuse_when_busy()
        gates.check_safety(self._safety)
        gates.check_driver(self._driver, homed=True)
        catalogue = self.catalogue()
        product = catalogue.products.get(product_id)
        if product is None:
            raise RefusedError(
                f"product '{product_id}' is not in the mix; known are {', '.join(sorted(catalogue.products))}"
            )
        gates.check_finger_records(self._slots, self._library.finger_records(), self._worn)
        mounted = self.mounted_set()
        mark = self._mark(catalogue, product_id, mounted)
        mounted = gates.check_fingers(self._slots, mounted, product, mark, trial=trial, confirm_lift=confirm_lift)
        references = self._references()
        recipe = product.recipe_for(mounted.id)
        gates.check_friction(self._friction(), self._limits, references, recipe.pull_limit_m)
        self._begin("grasp", product_id, mounted.id)
        self._busy, self._product, self._note = CellMode.GRASPING, product_id, ""
        names = tuple(slot.name for slot in self._slots)
        opposed = mounted.grasp is not GraspType.HOOK
        return GraspTask(product, recipe, names, references, self._thumb, confirm_lift, opposed)

    def end_grasp(self, task: GraspTask, verdict: GraspVerdict, duration_s: float) -> None:
        """Write down what came of a grasp and give the cell back."""
        mounted = self.mounted_set()
        held = verdict.outcome is GraspOutcome.GRIPPED
        self._busy = CellMode.HOLDING if held else None
        self._note = f"{task.product.id}: {verdict.outcome.value}: {verdict.reason}"
        finger_set = mounted.id if mounted else ""
        serials = tuple(slot.serial for slot in self._slots)

        def write() -> None:
            self._journal.finish_grasp(
                task.product.id,
                task.product.version,
                finger_set,
                verdict.outcome.value,
                verdict.reason,
                duration_s,
                serials=serials,
                evidence=verdict.evidence,
            )
            self._counts = self._journal.counts()

        self._writes.do(write)

    def abandon_grasp(self, reason: str) -> None:
        """Give the cell back: the grasp never began."""
        self._busy, self._note = None, reason
        self._writes.do(self._journal.abandon)

    def begin_swap(self, finger_set: str, serials: Sequence[str]) -> SwapSequence:
        """Check every gate and take the cell.

        Raises:
            RefusedError: with the reason.
        """
        self._refuse_when_busy()
        gates.check_safety(self._safety)
        gates.check_driver(self._driver, homed=False)
        catalogue = self.catalogue()
        if finger_set not in catalogue.finger_sets:
            known = ", ".join(catalogue.finger_sets)
            raise RefusedError(f"expected one of the finger sets {known}, found '{finger_set}'")
        sequence = SwapSequence(catalogue.finger_sets[finger_set], self._slots, self._library.finger_records(), serials)
        self._begin("swap", finger_set, SwapStep.RELEASE.value)
        self._swap = sequence
        self._busy, self._note = CellMode.SWAPPING, f"swapping to '{finger_set}'"
        return sequence

    def keep_lock(self, turn: SwapTransition, lock: HeldLock) -> None:
        """Write down the lock of the drives, and that a person may touch the fingers from the step of ``turn`` on.

        Raises:
            StorageError: neither was written; nobody may reach in.
        """
        with self._storage():
            self._journal.forget_slots(turn.step.value, lock)
        self._lock = lock
        self._slots = self._journal.slots()

    def drop_lock(self, reason: str = "") -> None:
        """Record that the drives are not locked by this cell any more, and why (empty: as the swap wanted it)."""
        self._lock = None
        self._writes.do(self._journal.drop_lock)
        if reason:
            self._note = reason
        if self._swap is None:
            self._busy = None

    def persist(self, turn: SwapTransition) -> None:
        """Write down what has to be written before a step of a swap begins; the lock goes with `keep_lock`."""
        with self._storage():
            if turn.persist is PersistAction.PARK_FINGERS:
                self._journal.park_fingers(turn.step.value)
            elif turn.persist is PersistAction.READ_IN:
                self._journal.read_in(turn.step.value, turn.serials)
            else:
                self._journal.reach(turn.step.value)
            self._slots = self._journal.slots()

    def earlier_references(self, sequence: SwapSequence) -> dict[str, FreeReference]:
        """Return what the last checks of the fingers of a swap saw, per slot; nothing for new fingers."""
        found = {
            slot.name: self._journal.reference(serial)
            for slot, serial in zip(self._slots, sequence.serials, strict=True)
        }
        return {name: FreeReference.from_document(document) for name, document in found.items() if document}

    def end_swap(
        self,
        sequence: SwapSequence,
        outcome: SwapOutcome,
        reason: str,
        duration_s: float,
        checks: Mapping[str, FingerCheck],
    ) -> None:
        """Write down what came of a swap and give the cell back, unless hands may still be inside."""
        by_slot = dict(zip((slot.name for slot in self._slots), sequence.serials, strict=False))
        self._swap = None
        self._busy = CellMode.SWAPPING if self._lock is not None else None
        self._note = f"swap to '{sequence.finger_set.id}': {outcome.name}: {reason}"
        self._writes.do(lambda: self._write_swap(sequence, outcome, reason, duration_s, checks, by_slot))

    def _write_swap(
        self,
        sequence: SwapSequence,
        outcome: SwapOutcome,
        reason: str,
        duration_s: float,
        checks: Mapping[str, FingerCheck],
        by_slot: Mapping[str, str],
    ) -> None:
        references: dict[str, object] = {}
        bad = {name: check for name, check in checks.items() if check.finding is not Finding.GOOD}
        if outcome is SwapOutcome.SUCCEEDED:
            references = {
                by_slot[name]: check.reference.document()
                for name, check in checks.items()
                if check.reference is not None
            }
        elif checks and any(check.finding is not Finding.UNSEEN for check in bad.values()):
            worn = [by_slot[name] for name, check in bad.items() if check.finding is Finding.WORN]
            self._journal.distrust([by_slot[name] for name in bad if by_slot[name] not in worn], worn)
        self._journal.finish_swap(
            sequence.finger_set.id, outcome, reason, duration_s, changed=not sequence.only_check, references=references
        )
        self._slots = self._journal.slots()
        self._counts = self._journal.counts()

    def observe_residual(self, slot: str, *, worn: bool, reason: str) -> None:
        """Take the verdict of a residual; enough in a row that call a finger worn end its use."""
        if self._worn_runs.setdefault(slot, Agreement(self._agreements.worn_residuals)).observe(worn):
            self._wear(slot, reason)

    def _wear(self, slot: str, reason: str) -> None:
        """Record that a mounted finger is worn: its finger record says so, and no grasp uses it any more."""
        mounted = next((item for item in self._slots if item.name == slot), None)
        known = mounted is not None and mounted.serial and mounted.state is not SlotState.UNKNOWN
        if mounted is None or not known or mounted.serial in self._worn or self._busy is CellMode.SWAPPING:
            return
        self._worn[mounted.serial] = reason
        self._note = f"slot {slot}: finger {mounted.serial} is worn: {reason}"

        def write() -> None:
            self._journal.wear(slot, reason)
            self._slots = self._journal.slots()

        self._writes.do(write)

    def _mark(self, catalogue: Catalogue, product_id: str, mounted: FingerSet | None) -> TableMark:
        """What table and counted grasps say of the mounted set and a product."""
        return TableMark.FAILURE if mounted is None else self.estimates(catalogue)[product_id][mounted.id].mark

    @contextmanager
    def _storage(self) -> Iterator[None]:
        """Put the cell at fault where the database fails what cannot wait; whoever asked is told."""
        try:
            yield
        except StorageError as error:
            self._writes.refuse(error, self._journal.probe)
            raise

    def _begin(self, kind: str, subject: str, step: str) -> None:
        """Write that a swap or grasp starts; where that cannot be written it does not."""
        with self._storage():
            self._journal.begin_operation(kind, subject, step)

    def _refuse_when_busy(self) -> None:
        if self._writes.fault:
            raise RefusedError(f"what happens could not be written down: {self._writes.fault}")
        if self._busy is CellMode.HOLDING:
            raise RefusedError(f"'{self._product}' is held; call tendon/release when it may be let go")
        if self._busy is CellMode.UNKNOWN:
            raise RefusedError(self._note)
        if self._lock is not None and self._swap is None:
            raise RefusedError(self._note)
        if self._busy is not None:
            raise RefusedError(f"the cell is {self._busy.name.lower()}; wait for its end or cancel it")

    def _references(self) -> tuple[FreeReference, ...]:
        references: list[FreeReference] = []
        for slot in self._slots:
            document = self._journal.reference(slot.serial)
            if document is None:
                raise RefusedError(f"slot {slot.name}: the free motion was never checked; run cell/swap to do so")
            references.append(FreeReference.from_document(document))
        return tuple(references)

    def _usable_sets(self, catalogue: Catalogue) -> list[str]:
        """Return the finger sets that could be mounted now or are."""
        finger_records = self._library.finger_records().values()
        mounted = {slot.serial for slot in self._slots}
        usable = {
            (finger_record.profile, finger_record.finger)
            for finger_record in finger_records
            if finger_record.objection() is None or (finger_record.serial in mounted and not finger_record.is_spent)
        }
        return [
            item.id
            for item in catalogue.finger_sets.values()
            if all((item.profile, slot.name) in usable for slot in self._slots)
        ]
