# SPDX-License-Identifier: Apache-2.0
"""One grasp from approach to verdict, decided on nothing but observations and their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from softgrip_cell.grasp.evidence import contact_text, evidence, pulled_text
from softgrip_cell.grasp.grip import REST_S, STANDING_M, Grip
from softgrip_cell.grasp.pressing import Pressing
from softgrip_cell.grasp.reading import Reader, Reading
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.tip_deflection import TipDeflection
from softgrip_cell.grasp.values import Command, GraspOutcome, GraspPhase, GraspStep, GraspTask, GraspVerdict, Open, Stop
from softgrip_cell.observation import ObservedPair, SeenTip, TendonFault, TendonSample

NANOSECONDS: Final = 1e9

#: Share of the force limit at which a finger stops closing: the rest is what it still moves until it stands.
FORCE_MARGIN: Final = 0.85

#: A hold counts when no finger had to follow by more than FOLLOW_M within REST_S; it has GIVING_WAY_S for that.
FOLLOW_M: Final = 0.001
GIVING_WAY_S: Final = 3.0

#: In so many samples both sides have to have lost their force: the fall over many before shows it too.
COLLAPSED_RUN: Final = 2

#: So many samples in a row have to lack it: what was sent in a pause passes in a rush, and much of it is dropped.
STALE_RUN: Final = 10

#: A closing may take this many times its path over its speed, plus START_S, before it counts as stuck.
CLOSING_TIMEOUT_FACTOR: Final = 2.0
START_S: Final = 2.0


class GraspSequence:
    """Steps one grasp.

    Feed it every pair of tendon sample and prediction, every fault, and the end of every closing that it commanded; do
    what the returned steps command; stop when a step carries a verdict.
    """

    def __init__(self, task: GraspTask, settings: GraspSettings) -> None:
        self._task = task
        self._recipe = task.recipe
        self._settings = settings
        self._reader = Reader(task.references, settings)
        self._tip_deflected = TipDeflection(task.slots, task.references, settings)
        self._phase = GraspPhase.APPROACH
        self._last_ns: int | None = None
        self._unpaired_ns: deque[int] = deque()  # stamps of samples that wait for their prediction
        self._phase_since_ns = 0
        self._closing = list(range(len(task.slots)))
        self._pressing = Pressing(task, settings, self._reader)
        self._grip = Grip(task, settings, self._pressing)
        self._path_ended = False
        self._was_enclosed = False
        self._before = ""
        self._runs: dict[str, list[int]] = {}

    @property
    def phase(self) -> GraspPhase:
        """Where the grasp stands."""
        return self._phase

    def start(self) -> GraspStep:
        """Return the first command: fingers open."""
        return GraspStep(self._phase, (Open(),))

    def observe(self, pair: ObservedPair) -> GraspStep:
        """Take one tendon sample with its prediction."""
        now_ns = pair.sample.stamp_ns
        if self._phase is GraspPhase.DONE or (self._last_ns is not None and now_ns <= self._last_ns):
            return self._unchanged
        objection = self._objection(pair)
        if objection:
            return self._end(GraspOutcome.ABORTED, f"the free motion cannot be predicted: {objection}", now_ns)
        if self._last_ns is None:
            self._phase_since_ns = now_ns
        self._last_ns = now_ns
        while self._unpaired_ns and self._unpaired_ns[0] <= now_ns:
            self._unpaired_ns.popleft()
        self._tip_deflected.predict(pair)
        self._grip.look(now_ns, self._reader.read(pair, self._pressing.slots), self._tip_deflected.slots(now_ns))
        lost = self._lost_tendon(now_ns)
        if lost is not None:
            return lost
        handler: Callable[[int], GraspStep] = {
            GraspPhase.APPROACH: self._approach,
            GraspPhase.CLOSE: self._close,
            GraspPhase.HOLD: self._hold,
            GraspPhase.LIFT: self._lift,
        }[self._phase]
        step = handler(now_ns)
        return replace(step, contact=self._touching)

    def see(self, tip: SeenTip) -> None:
        """Take a fingertip that the camera has seen; the next sample is judged with it."""
        self._tip_deflected.see(tip)

    def observe_sample(self, sample: TendonSample) -> GraspStep:
        """Take a tendon sample that has no prediction yet; too long without one ends the grasp."""
        if self._phase is GraspPhase.DONE or self._last_ns is None or sample.stamp_ns <= self._last_ns:
            return self._unchanged
        stale_ns = self._settings.stale_s * NANOSECONDS
        waiting = self._unpaired_ns
        # While no samples came, or none were taken in, there was nothing to predict; the wait begins with the next one.
        if waiting and sample.stamp_ns - waiting[-1] > stale_ns:
            waiting.clear()
        waiting.append(sample.stamp_ns)
        gap_ns = sample.stamp_ns - waiting[0]
        if gap_ns <= stale_ns or len(waiting) < STALE_RUN:
            return self._unchanged
        reason = f"expected a finger/predicted for every tendon/state, found none for {gap_ns / NANOSECONDS:.2f} s"
        return self._end(GraspOutcome.ABORTED, reason, sample.stamp_ns)

    def closing_ended(self) -> None:
        """The driver says that the commanded closing came to its end (targets or tension limit)."""
        self._path_ended = True

    def fault(self, fault: TendonFault, stamp_ns: int) -> GraspStep:
        """A tendon has a fault."""
        return self._end(GraspOutcome.TENDON_FAULT, f"tendon {fault.tendon}: {fault.name}: {fault.reason}", stamp_ns)

    def abort(self, reason: str, stamp_ns: int | None = None) -> GraspStep:
        """Somebody or something outside ends the grasp; the fingers stay where they are."""
        return self._end(GraspOutcome.ABORTED, reason, stamp_ns if stamp_ns is not None else self._last_ns or 0)

    # --- phases ----------------------------------------------------------------------------------------------------

    def _approach(self, now_ns: int) -> GraspStep:
        if all(reading.pulled_m <= self._settings.open_m for reading in self._readings):
            self._enter(GraspPhase.CLOSE, now_ns)
            return GraspStep(self._phase, (self._pressing.close(self._closing),))
        if self._elapsed_s(now_ns) > self._closing_timeout_s():
            return self._end(GraspOutcome.ABORTED, f"the fingers do not open: {self._pulled_text()}", now_ns)
        return GraspStep(self._phase)

    def _close(self, now_ns: int) -> GraspStep:
        self._was_enclosed = self._was_enclosed or self._grip.touched()
        lost_contact = self._was_enclosed and self._grip.lost_contact()
        began_ns = self._began("escaped", lost_contact, now_ns, self._settings.slip_s)
        if began_ns is not None:
            return self._end(
                GraspOutcome.SLIPPED, f"the product got away while closing: {self._contact_text()}", began_ns
            )
        if self._grip.enclosed():
            return self._enclosed(now_ns)
        commands = self._stop_finished_fingers(now_ns)
        if commands:
            return GraspStep(self._phase, commands)
        if self._path_ended or self._all_stand(now_ns):
            return self._path_end(now_ns)
        if self._elapsed_s(now_ns) > self._closing_timeout_s():
            return self._end(GraspOutcome.ABORTED, f"the fingers do not come to an end: {self._pulled_text()}", now_ns)
        return GraspStep(self._phase, self._keep_up(now_ns))

    def _path_end(self, now_ns: int) -> GraspStep:
        """Every finger is where it can go, without anything between thumb and fingers."""
        if self._task.confirm_lift and self._grip.is_hooked_on():
            return self._enclosed(now_ns)
        began_ns = self._began("empty", True, now_ns)
        if began_ns is None:
            return GraspStep(self._phase)
        touching = [name for name, reading in zip(self._task.slots, self._readings, strict=True) if reading.touching]
        if touching:
            reason = f"touched by {', '.join(touching)} only: {self._contact_text()}"
        else:
            reason = f"closed on nothing: {self._contact_text()}"
        return self._end(GraspOutcome.EMPTY, reason, began_ns)

    def _enclosed(self, now_ns: int) -> GraspStep:
        """Touched from both sides: what touches presses as the recipe asks, what does not goes on closing."""
        touching = [slot for slot in self._every_slot if self._grip.presses(slot)]
        self._grip.begin()
        # Pulling harder at its end would only press a finger on its own stops.
        new = [s for s in touching if s not in self._pressing.slots and not self._grip.at_end(s)]
        self._closing = [slot for slot in self._closing if slot not in touching]
        self._enter(GraspPhase.HOLD, now_ns)
        return GraspStep(self._phase, (self._pressing.press(new, self._readings, now_ns),) if new else ())

    def _hold(self, now_ns: int) -> GraspStep:
        """Wait for the holding force; then it is held, or, where that is asked for, lifted to see."""
        began_ns = self._let_go(now_ns)
        if began_ns is not None:
            return self._lost_in_hold(now_ns, began_ns)
        full_ns = self._began("full", self._grip.grips(), now_ns)
        if full_ns is None and not self._has_settled(now_ns):
            if self._elapsed_s(now_ns) >= self._settings.settle_s + GIVING_WAY_S:
                return self._gives_way(now_ns)
            return GraspStep(self._phase, self._press_what_touches(now_ns))
        self._grip.meet(self._closing)
        commands = self._press_the_rest(now_ns)
        if not self._task.confirm_lift:
            event_ns = full_ns if full_ns is not None else now_ns
            return self._end(GraspOutcome.GRIPPED, f"held from both sides: {self._contact_text()}", event_ns, commands)
        self._before = self._contact_text()
        self._pressing.hold_still()
        self._enter(GraspPhase.LIFT, now_ns)
        return GraspStep(self._phase, commands)

    def _has_settled(self, now_ns: int) -> bool:
        """Time is up for pressing harder, and nothing gives way: for the lift to show, or for good."""
        if self._elapsed_s(now_ns) < self._settings.settle_s or "let go" in self._runs:
            return False
        return self._grip.rests() or (self._task.confirm_lift and self._grip.advance_m() <= FOLLOW_M)

    def _gives_way(self, now_ns: int) -> GraspStep:
        before = f"; before: {self._before}" if self._before else ""
        return self._end(GraspOutcome.SLIPPED, f"keeps giving way: {self._contact_text()}{before}", now_ns)

    def _lost_in_hold(self, now_ns: int, began_ns: int) -> GraspStep:
        if self._grip.had_contact():
            return self._end(GraspOutcome.SLIPPED, f"lost while the fingers pressed: {self._contact_text()}", began_ns)
        # A touch that was none, or one that only pushed the product along: go on looking for it.
        self._closing = list(self._every_slot)
        self._was_enclosed = self._path_ended = False
        self._enter(GraspPhase.CLOSE, now_ns)
        return GraspStep(self._phase, (self._pressing.close(self._closing),))

    def _lift(self, now_ns: int) -> GraspStep:
        began_ns = self._let_go(now_ns)
        if began_ns is not None:
            lifted_s = self._elapsed_s(began_ns)
            reason = f"lost after {lifted_s:.2f} s of lifting: {self._contact_text()}; before: {self._before}"
            return self._end(GraspOutcome.SLIPPED, reason, began_ns)
        over_s = self._elapsed_s(now_ns) - self._settings.lift_window_s
        if over_s >= GIVING_WAY_S:
            return self._gives_way(now_ns)
        hangs = "let go" not in self._runs or self._grip.is_tip_deflected()
        if over_s >= 0.0 and hangs and self._grip.advance_m(REST_S) <= FOLLOW_M:
            reason = f"held for {self._settings.lift_window_s:g} s: {self._contact_text()}"
            return self._end(GraspOutcome.GRIPPED, reason, now_ns)
        return GraspStep(self._phase, self._keep_up(now_ns))

    def _let_go(self, now_ns: int) -> int | None:
        """Return since when nothing is held any more, once that is sure."""
        collapsed_ns = self._began("collapsed", self._grip.collapsed(), now_ns, samples=COLLAPSED_RUN)
        began_ns = self._began("let go", not self._grip.holding(), now_ns, self._settings.slip_s)
        if collapsed_ns is None and self._phase is GraspPhase.LIFT and self._grip.is_tip_deflected():
            return None
        return collapsed_ns if collapsed_ns is not None else began_ns

    # --- judgements ------------------------------------------------------------------------------------------------

    def _objection(self, pair: ObservedPair) -> str:
        """Why the prediction cannot be used; beyond a finger's checked path it is not needed."""
        if pair.free.objection:
            return pair.free.objection
        within = [
            pulled_m <= reference.reach_m
            for pulled_m, reference in zip(pair.sample.pulled_m, self._task.references, strict=True)
        ]
        return "; ".join(text for text, needed in zip(pair.free.objections, within, strict=True) if text and needed)

    def _all_stand(self, now_ns: int) -> bool:
        """Nothing moves any more, wherever it stands."""
        return self._elapsed_s(now_ns) >= START_S and self._grip.advance_m(REST_S) <= STANDING_M

    def _lost_tendon(self, now_ns: int) -> GraspStep | None:
        settings = self._settings
        for name, reading in zip(self._task.slots, self._readings, strict=True):
            slack = (
                self._phase is GraspPhase.CLOSE
                and reading.judged
                and reading.free_n >= settings.lost_floor_n
                and reading.tension_n < settings.lost_fraction * reading.free_n
            )
            began_ns = self._began(f"lost {name}", slack, now_ns, settings.lost_s)
            if began_ns is not None:
                reason = (
                    f"tendon {name} pulls nothing: expected {reading.free_n:.1f} N at {reading.pulled_m * 1e3:.1f} mm, "
                    f"found {reading.tension_n:.1f} N; look for a broken or unhooked cable"
                )
                return self._end(GraspOutcome.TENDON_FAULT, reason, began_ns)
        return None

    def _began(
        self, what: str, condition: bool, now_ns: int, wait_s: float = 0.0, samples: int | None = None
    ) -> int | None:
        """Follow a condition; return the stamp of the first sample of its run once the run is long enough.

        Args:
            what: name of the condition.
            condition: whether it holds now.
            now_ns: stamp of the sample.
            wait_s: how long it has to hold at least [s].
            samples: in how many samples it has to hold at least; None: in as many as the settings say.
        """
        if not condition:
            self._runs.pop(what, None)
            return None
        run = self._runs.setdefault(what, [])
        run.append(now_ns)
        enough = len(run) >= (samples or self._settings.run) and now_ns - run[0] >= wait_s * NANOSECONDS
        return run[0] if enough else None

    # --- commands --------------------------------------------------------------------------------------------------

    def _stop_finished_fingers(self, now_ns: int) -> tuple[Command, ...]:
        """Let fingers that press hard enough keep their tension; leave out those that came to their end."""
        limit_n = FORCE_MARGIN * self._recipe.force_limit_n
        pressing = []
        for slot in self._closing:
            reading = self._readings[slot]
            hard = reading.touching and reading.contact_tension_n >= self._recipe.hold_contact_tension_n
            long_enough = self._began(f"hard {slot}", hard, now_ns) is not None
            if long_enough or (reading.touching and reading.force_n >= limit_n):
                pressing.append(slot)
        going_on = [slot for slot in self._closing if slot not in pressing and not self._grip.at_end(slot)]
        if len(going_on) < len(self._closing):
            self._closing = going_on
            self._path_ended = not going_on
        # The driver goes on closing the other fingers by itself.
        return (self._pressing.press(pressing, self._readings, now_ns),) if pressing else ()

    def _keep_up(self, now_ns: int) -> tuple[Command, ...]:
        return self._pressing.keep_up(self._readings, self._grip.standing(), now_ns)

    def _press_what_touches(self, now_ns: int) -> tuple[Command, ...]:
        """Fingers that came later press as well; the others keep what they have."""
        new = [
            slot
            for slot in self._closing
            if self._grip.touches(slot) and not self._pressing.at_end(slot, self._readings[slot])
        ]
        self._closing = [slot for slot in self._closing if slot not in new]
        first = (self._pressing.press(new, self._readings, now_ns),) if new else ()
        return (*first, *self._keep_up(now_ns))

    def _press_the_rest(self, now_ns: int) -> tuple[Command, ...]:
        """No finger goes on closing beside a product that is held."""
        rest = [slot for slot in self._every_slot if slot not in self._pressing.slots]
        self._closing = []
        return (self._pressing.keep(rest, self._readings, now_ns),) if rest else ()

    # --- bookkeeping -----------------------------------------------------------------------------------------------

    @property
    def _touching(self) -> bool:
        return any(reading.touching for reading in self._readings)

    @property
    def _unchanged(self) -> GraspStep:
        """Nothing to do, and nothing new to say."""
        return GraspStep(self._phase, contact=self._touching)

    @property
    def _readings(self) -> tuple[Reading, ...]:
        return self._grip.readings

    @property
    def _every_slot(self) -> range:
        return range(len(self._task.slots))

    def _enter(self, phase: GraspPhase, now_ns: int) -> None:
        self._phase = phase
        self._phase_since_ns = now_ns
        self._runs.clear()

    def _elapsed_s(self, now_ns: int) -> float:
        return (now_ns - self._phase_since_ns) / NANOSECONDS

    def _closing_timeout_s(self) -> float:
        return START_S + CLOSING_TIMEOUT_FACTOR * self._recipe.pull_limit_m / self._recipe.closing_speed_m_per_s

    def _end(self, outcome: GraspOutcome, reason: str, event_ns: int, commands: tuple[Command, ...] = ()) -> GraspStep:
        """Finish; a gripped product stays held by its tension, otherwise the fingers stay where they are."""
        if self._phase is GraspPhase.DONE:
            return GraspStep(self._phase)
        decided_ns = max(self._last_ns or event_ns, event_ns)
        found = evidence(self._task.slots, self._readings, self._grip.peak_n, self._phase, decided_ns)
        found["tip_off_m"] = {
            self._task.slots[slot]: round(off_m, 4) for slot, off_m in self._tip_deflected.off_m(decided_ns).items()
        }
        self._phase = GraspPhase.DONE
        if outcome is not GraspOutcome.GRIPPED:
            commands = (Stop(),)
        return GraspStep(
            GraspPhase.DONE, commands, GraspVerdict(outcome, reason, (decided_ns - event_ns) / NANOSECONDS, found)
        )

    def _contact_text(self) -> str:
        return contact_text(self._task.slots, self._readings)

    def _pulled_text(self) -> str:
        return pulled_text(self._task.slots, self._readings)
