# SPDX-License-Identifier: Apache-2.0
"""One grasp from approach to verdict, decided on nothing but observations and their stamps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from softgrip_cell.grasp.evidence import evidence, excess_text, pulled_text
from softgrip_cell.grasp.reading import Reader, Reading
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import Close, Command, GraspTask, Open, Outcome, Phase, Press, Step, Stop, Verdict
from softgrip_cell.observation import Pair, TendonFault, TendonSample

NANOSECONDS: Final = 1e9

#: Share of the force limit at which a finger stops closing: the rest is what it still moves until it stands.
FORCE_MARGIN: Final = 0.85

#: Shares of the holding excess that are enough when every finger has come to its end: to hold, and to try a lift.
LEAST_HOLD: Final = 0.5
LEAST_TRY: Final = 0.2

#: Fingers that touch nothing are held with this, so that their tendons stay taut [N].
LEAST_TENSION_N: Final = 1.0

#: A finger is pulled again when its tension has fallen below this share of what it pressed with; at most so often [s].
KEEP_SHARE: Final = 0.85
KEEP_PERIOD_S: Final = 0.1

#: A hold counts when nothing had to be pulled again for REST_S; it has GIVING_WAY_S beyond the window for that [s].
REST_S: Final = 0.3
GIVING_WAY_S: Final = 3.0

#: A closing may take this many times its path over its speed, plus START_S, before it counts as stuck.
CLOSING_PATIENCE: Final = 2.0
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
        self._phase = Phase.APPROACH
        self._readings: tuple[Reading, ...] = ()
        self._last_ns: int | None = None
        self._phase_since_ns = 0
        self._closing = list(range(len(task.slots)))
        self._pressing: list[int] = []
        self._path_ended = False
        self._was_enclosed = False
        self._peak_n = [0.0] * len(task.slots)
        self._at_end: set[int] = set()
        self._kept_n: dict[int, float] = {}
        self._kept_since_ns: dict[int, int] = {}
        self._before = ""
        self._runs: dict[str, list[int]] = {}

    @property
    def phase(self) -> Phase:
        """Where the grasp stands."""
        return self._phase

    def start(self) -> Step:
        """Return the first command: fingers open."""
        return Step(self._phase, (Open(),))

    def observe(self, pair: Pair) -> Step:
        """Take one tendon sample with its prediction."""
        now_ns = pair.sample.stamp_ns
        if self._phase is Phase.DONE or (self._last_ns is not None and now_ns <= self._last_ns):
            return Step(self._phase)
        objection = self._objection(pair)
        if objection:
            return self._end(Outcome.ABORTED, f"the free motion cannot be predicted: {objection}", now_ns)
        if self._last_ns is None:
            self._phase_since_ns = now_ns
        self._last_ns = now_ns
        self._readings = self._reader.read(pair)
        self._peak_n = [max(p, r.excess_n) for p, r in zip(self._peak_n, self._readings, strict=True)]
        lost = self._lost_tendon(now_ns)
        if lost is not None:
            return lost
        handler: Callable[[int], Step] = {
            Phase.APPROACH: self._approach,
            Phase.CLOSE: self._close,
            Phase.HOLD: self._hold,
            Phase.LIFT: self._lift,
        }[self._phase]
        step = handler(now_ns)
        return replace(step, contact=any(reading.touching for reading in self._readings))

    def observe_sample(self, sample: TendonSample) -> Step:
        """Take a tendon sample that has no prediction yet; too long without one ends the grasp."""
        if self._phase is Phase.DONE or self._last_ns is None:
            return Step(self._phase)
        gap_s = (sample.stamp_ns - self._last_ns) / NANOSECONDS
        if gap_s <= self._settings.stale_s:
            return Step(self._phase)
        reason = f"expected a finger/predicted for every tendon/state, found none for {gap_s:.2f} s"
        return self._end(Outcome.ABORTED, reason, sample.stamp_ns)

    def closing_ended(self) -> None:
        """The driver says that the commanded closing came to its end (targets or tension limit)."""
        self._path_ended = True

    def fault(self, fault: TendonFault, stamp_ns: int) -> Step:
        """A tendon has a fault."""
        return self._end(Outcome.TENDON_FAULT, f"tendon {fault.tendon}: {fault.name}: {fault.reason}", stamp_ns)

    def abort(self, reason: str, stamp_ns: int | None = None) -> Step:
        """Somebody or something outside ends the grasp; the fingers stay where they are."""
        return self._end(Outcome.ABORTED, reason, stamp_ns if stamp_ns is not None else self._last_ns or 0)

    # --- phases ----------------------------------------------------------------------------------------------------

    def _approach(self, now_ns: int) -> Step:
        if all(reading.pulled_m <= self._settings.open_m for reading in self._readings):
            self._enter(Phase.CLOSE, now_ns)
            return Step(self._phase, (self._close_command(),))
        if self._elapsed_s(now_ns) > self._patience_s():
            return self._end(Outcome.ABORTED, f"the fingers do not open: {self._pulled_text()}", now_ns)
        return Step(self._phase)

    def _close(self, now_ns: int) -> Step:
        self._was_enclosed = self._was_enclosed or self._encloses([reading.touching for reading in self._readings])
        escaped = self._was_enclosed and not any(r.excess_n >= 0.5 * r.threshold_n for r in self._readings)
        began_ns = self._began("escaped", escaped, now_ns, self._settings.slip_s)
        if began_ns is not None:
            return self._end(Outcome.SLIPPED, f"the product got away while closing: {self._excess_text()}", began_ns)
        commands = self._stop_finished_fingers(now_ns)
        enclosed = self._encloses([slot in self._pressing for slot in self._every_slot])
        began_ns = self._began("enclosed", enclosed, now_ns, self._settings.gather_s if self._closing else 0.0)
        if began_ns is not None:
            return self._enclosed(now_ns, began_ns, commands)
        if commands:
            return Step(self._phase, commands)
        if self._path_ended:
            return self._path_end(now_ns)
        if self._elapsed_s(now_ns) > self._patience_s():
            return self._end(Outcome.ABORTED, f"the fingers do not come to an end: {self._pulled_text()}", now_ns)
        return Step(self._phase)

    def _path_end(self, now_ns: int) -> Step:
        """Every finger is where it can go: either what it has is enough, or there is nothing."""
        touching = [reading.touching for reading in self._readings]
        # Where the lift will tell, a lighter touch from both sides is worth a try.
        share = LEAST_TRY if self._task.confirm_lift else LEAST_HOLD
        least_n = share * self._recipe.hold_excess_n
        if self._encloses([reading.touching and reading.excess_n >= least_n for reading in self._readings]):
            return self._enclosed(now_ns, now_ns)
        began_ns = self._began("empty", True, now_ns)
        if began_ns is None:
            return Step(self._phase)
        if any(touching):
            who = ", ".join(name for name, touch in zip(self._task.slots, touching, strict=True) if touch)
            reason = f"touched by {who} only, or too lightly to hold: {self._excess_text()}"
        else:
            reason = f"closed on nothing: {self._excess_text()}"
        return self._end(Outcome.EMPTY, reason, began_ns)

    def _enclosed(self, now_ns: int, event_ns: int, commands: tuple[Command, ...] = ()) -> Step:
        """Thumb and fingers press: whatever still moves keeps what it has."""
        rest = [slot for slot in self._every_slot if slot not in self._pressing]
        self._at_end = {s for s in rest if self._readings[s].pulled_m >= self._path_m(s) - self._settings.reach_m}
        commands += (self._press(rest, now_ns),) if rest else ()
        if not self._task.confirm_lift:
            reason = f"held from both sides: {self._excess_text()}"
            return self._end(Outcome.GRIPPED, reason, event_ns, commands)
        self._enter(Phase.HOLD, now_ns)
        return Step(self._phase, commands)

    def _hold(self, now_ns: int) -> Step:
        """Let the tension settle after the stop; only then the product is lifted."""
        if self._elapsed_s(now_ns) < self._settings.settle_s:
            return Step(self._phase, self._keep_up(now_ns))
        began_ns = self._began("lost", not self._holding(), now_ns, self._settings.slip_s)
        if began_ns is not None:
            return self._end(Outcome.SLIPPED, f"lost while the fingers stopped: {self._excess_text()}", began_ns)
        if "lost" not in self._runs:
            self._before = self._excess_text()
            self._enter(Phase.LIFT, now_ns)
        return Step(self._phase, self._keep_up(now_ns))

    def _lift(self, now_ns: int) -> Step:
        began_ns = self._began("slipped", not self._holding(), now_ns, self._settings.slip_s)
        if began_ns is not None:
            lifted_s = self._elapsed_s(began_ns)
            reason = f"lost after {lifted_s:.2f} s of lifting: {self._excess_text()}; before: {self._before}"
            return self._end(Outcome.SLIPPED, reason, began_ns)
        over_s = self._elapsed_s(now_ns) - self._settings.lift_window_s
        if over_s >= GIVING_WAY_S:
            return self._end(
                Outcome.SLIPPED, f"keeps giving way: {self._excess_text()}; before: {self._before}", now_ns
            )
        if over_s >= 0.0 and not self._runs and self._at_rest(now_ns):
            reason = f"held for {self._settings.lift_window_s:g} s: {self._excess_text()}"
            return self._end(Outcome.GRIPPED, reason, now_ns)
        return Step(self._phase, self._keep_up(now_ns))

    # --- judgements ------------------------------------------------------------------------------------------------

    def _objection(self, pair: Pair) -> str:
        """Why the prediction cannot be used; beyond a finger's checked path it is not needed."""
        if pair.free.objection:
            return pair.free.objection
        within = [
            pulled_m <= reference.reach_m
            for pulled_m, reference in zip(pair.sample.pulled_m, self._task.references, strict=True)
        ]
        return "; ".join(text for text, needed in zip(pair.free.objections, within, strict=True) if text and needed)

    def _holding(self) -> bool:
        """Thumb and a finger still press; a product that gets away takes all excess with it."""
        share = self._settings.slip_share
        pressing = []
        for slot, reading in enumerate(self._readings):
            # A finger that ran to its end while its tension was kept up stands at its stops, not at a product.
            ran_out = slot not in self._at_end and reading.pulled_m >= self._path_m(slot)
            pressing.append(reading.excess_n >= share * reading.threshold_n and not ran_out)
        return self._encloses(pressing)

    def _at_rest(self, now_ns: int) -> bool:
        """No finger had to be pulled again lately: what has to be followed all the time is not held."""
        return now_ns - max(self._kept_since_ns.values()) >= REST_S * NANOSECONDS

    def _lost_tendon(self, now_ns: int) -> Step | None:
        settings = self._settings
        for name, reading in zip(self._task.slots, self._readings, strict=True):
            slack = (
                self._phase is Phase.CLOSE
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
                return self._end(Outcome.TENDON_FAULT, reason, began_ns)
        return None

    def _encloses(self, fingers: Sequence[bool]) -> bool:
        """The thumb and at least one finger against it; with a hook any two fingers."""
        return sum(fingers) > 1 and (fingers[self._task.thumb] or not self._task.opposed)

    def _began(self, what: str, condition: bool, now_ns: int, wait_s: float | None = None) -> int | None:
        """Follow a condition; return the stamp of the first sample of its run once the run is long enough.

        Args:
            what: name of the condition.
            condition: whether it holds now.
            now_ns: stamp of the sample.
            wait_s: how long it has to hold [s]; None: for as many samples as the settings say.
        """
        if not condition:
            self._runs.pop(what, None)
            return None
        run = self._runs.setdefault(what, [])
        run.append(now_ns)
        if wait_s is None:
            return run[0] if len(run) >= self._settings.run else None
        return run[0] if now_ns - run[0] >= wait_s * NANOSECONDS else None

    # --- commands --------------------------------------------------------------------------------------------------

    def _close_command(self) -> Close:
        slots = tuple(self._closing)
        free_n = max(self._task.references[slot].tension(self._path_m(slot)) for slot in slots)
        excess_n = max(self._reader.excess_limit(slot, self._recipe.force_limit_n) for slot in slots)
        limit_n = min(free_n + excess_n, self._settings.tension_limit_n)
        return Close(slots, tuple(map(self._path_m, slots)), self._recipe.closing_speed_m_per_s, limit_n)

    def _path_m(self, slot: int) -> float:
        """End of a finger's path: what the recipe allows, but never beyond what was checked."""
        return min(self._recipe.pull_limit_m, self._task.references[slot].reach_m)

    def _press(self, slots: Sequence[int], now_ns: int) -> Press:
        """Keep what these fingers press with now, but no more than the product bears."""
        for slot in slots:
            reading = self._readings[slot]
            most_n = reading.free_n + self._reader.excess_limit(slot, self._recipe.force_limit_n)
            most_n = min(most_n, self._settings.tension_limit_n)
            self._kept_n[slot] = max(LEAST_TENSION_N, min(reading.tension_n, most_n))
            self._kept_since_ns[slot] = now_ns
        return Press(tuple(slots), tuple(self._kept_n[slot] for slot in slots))

    def _keep_up(self, now_ns: int) -> tuple[Command, ...]:
        """Pull again where a product that settled or gave way has taken a finger's tension away."""
        slots = [
            slot
            for slot, kept_n in self._kept_n.items()
            if self._readings[slot].tension_n < KEEP_SHARE * kept_n
            and self._readings[slot].pulled_m < self._path_m(slot) - self._settings.reach_m
            and now_ns - self._kept_since_ns[slot] >= KEEP_PERIOD_S * NANOSECONDS
        ]
        if not slots:
            return ()
        self._kept_since_ns.update(dict.fromkeys(slots, now_ns))
        return (Press(tuple(slots), tuple(self._kept_n[slot] for slot in slots)),)

    def _stop_finished_fingers(self, now_ns: int) -> tuple[Command, ...]:
        """Let fingers that press hard enough keep their tension; leave out those that came to their end."""
        limit_n = FORCE_MARGIN * self._recipe.force_limit_n
        pressing = []
        for slot in self._closing:
            reading = self._readings[slot]
            hard = reading.touching and reading.excess_n >= self._recipe.hold_excess_n
            long_enough = self._began(f"hard {slot}", hard, now_ns) is not None
            if long_enough or (reading.touching and reading.force_n >= limit_n):
                pressing.append(slot)
        going_on = [
            slot
            for slot in self._closing
            if slot not in pressing and self._readings[slot].pulled_m < self._path_m(slot) - self._settings.reach_m
        ]
        if len(going_on) == len(self._closing):
            return ()
        self._closing = going_on
        self._pressing += pressing
        self._path_ended = not going_on
        # The driver goes on closing the other fingers by itself.
        return (self._press(pressing, now_ns),) if pressing else ()

    # --- bookkeeping -----------------------------------------------------------------------------------------------

    @property
    def _every_slot(self) -> range:
        return range(len(self._task.slots))

    def _enter(self, phase: Phase, now_ns: int) -> None:
        self._phase = phase
        self._phase_since_ns = now_ns
        self._runs.clear()

    def _elapsed_s(self, now_ns: int) -> float:
        return (now_ns - self._phase_since_ns) / NANOSECONDS

    def _patience_s(self) -> float:
        return START_S + CLOSING_PATIENCE * self._recipe.pull_limit_m / self._recipe.closing_speed_m_per_s

    def _end(self, outcome: Outcome, reason: str, event_ns: int, commands: tuple[Command, ...] = ()) -> Step:
        """Finish; a gripped product stays held by its tension, otherwise the fingers stay where they are."""
        if self._phase is Phase.DONE:
            return Step(self._phase)
        decided_ns = max(self._last_ns or event_ns, event_ns)
        found = evidence(self._task.slots, self._readings, self._peak_n, self._phase, decided_ns)
        self._phase = Phase.DONE
        if outcome is not Outcome.GRIPPED:
            commands = (Stop(),)
        return Step(Phase.DONE, commands, Verdict(outcome, reason, (decided_ns - event_ns) / NANOSECONDS, found))

    def _excess_text(self) -> str:
        return excess_text(self._task.slots, self._readings)

    def _pulled_text(self) -> str:
        return pulled_text(self._task.slots, self._readings)
