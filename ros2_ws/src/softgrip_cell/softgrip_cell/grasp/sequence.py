# SPDX-License-Identifier: Apache-2.0
"""One grasp from approach to verdict, decided on nothing but observations and their stamps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from softgrip_cell.grasp.reading import Reader, Reading
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import Close, Command, GraspTask, Hold, Open, Outcome, Phase, Step, Verdict
from softgrip_cell.observation import Pair, TendonFault, TendonSample

NANOSECONDS: Final = 1e9

#: Share of the force limit at which a finger stops: what the tendon still moves until the driver has stopped it.
FORCE_MARGIN: Final = 0.85

#: Share of the holding excess that is enough when a finger has come to the end of its path.
LEAST_HOLD: Final = 0.5

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
        self._settings = settings
        self._reader = Reader(task.references, settings)
        self._phase = Phase.APPROACH
        self._readings: tuple[Reading, ...] = ()
        self._last_ns: int | None = None
        self._phase_since_ns = 0
        self._closing = list(range(len(task.slots)))
        self._path_ended = False
        self._was_enclosed = False
        self._peak_n = [0.0] * len(task.slots)
        self._baseline_n: list[float] = []
        self._runs: dict[str, list[int]] = {}

    @property
    def phase(self) -> Phase:
        """Where the grasp stands."""
        return self._phase

    def start(self) -> Step:
        """Return the first command: fingers open."""
        return Step(self._phase, command=Open())

    def observe(self, pair: Pair) -> Step:
        """Take one tendon sample with its prediction."""
        now_ns = pair.sample.stamp_ns
        if self._phase is Phase.DONE or (self._last_ns is not None and now_ns <= self._last_ns):
            return Step(self._phase)
        if pair.free.objection:
            return self._end(Outcome.ABORTED, f"the free motion cannot be predicted: {pair.free.objection}", now_ns)
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
        """The driver says that the commanded closing came to its end (target or tension limit)."""
        self._path_ended = True

    def fault(self, fault: TendonFault, stamp_ns: int) -> Step:
        """A tendon has a fault."""
        return self._end(Outcome.TENDON_FAULT, f"tendon {fault.tendon}: {fault.name}: {fault.reason}", stamp_ns)

    def abort(self, reason: str, stamp_ns: int | None = None) -> Step:
        """Somebody or something outside ends the grasp; the fingers stay where they are."""
        return self._end(Outcome.ABORTED, reason, stamp_ns if stamp_ns is not None else self._last_ns or 0)

    def _approach(self, now_ns: int) -> Step:
        if all(reading.pulled_m <= self._settings.open_m for reading in self._readings):
            self._enter(Phase.CLOSE, now_ns)
            return Step(self._phase, command=self._close_command())
        if self._elapsed_s(now_ns) > self._patience_s():
            return self._end(Outcome.ABORTED, f"the fingers do not open: {self._pulled_text()}", now_ns)
        return Step(self._phase)

    def _close(self, now_ns: int) -> Step:
        holding = [r.excess_n >= self._task.product.recipe.hold_excess_n for r in self._readings]
        began_ns = self._began("enclosed", self._encloses(holding), now_ns)
        if began_ns is not None:
            return self._enclosed(now_ns, began_ns)
        touching = [reading.touching for reading in self._readings]
        self._was_enclosed = self._was_enclosed or self._encloses(touching)
        escaped = self._was_enclosed and not any(r.excess_n >= 0.5 * r.threshold_n for r in self._readings)
        began_ns = self._began("escaped", escaped, now_ns)
        if began_ns is not None:
            return self._end(Outcome.SLIPPED, f"the product got away while closing: {self._excess_text()}", began_ns)
        if self._stop_finished_fingers():
            if self._closing:
                return Step(self._phase, command=self._close_command())
            self._path_ended = True
        if self._path_ended:
            return self._path_end(now_ns)
        if self._elapsed_s(now_ns) > self._patience_s():
            return self._end(Outcome.ABORTED, f"the fingers do not come to an end: {self._pulled_text()}", now_ns)
        return Step(self._phase)

    def _path_end(self, now_ns: int) -> Step:
        """Every finger is where it can go: either what it has is enough, or there is nothing."""
        enough = [r.excess_n >= LEAST_HOLD * self._task.product.recipe.hold_excess_n for r in self._readings]
        touching = [reading.touching for reading in self._readings]
        if self._encloses([a and b for a, b in zip(enough, touching, strict=True)]):
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

    def _enclosed(self, now_ns: int, event_ns: int) -> Step:
        if not self._task.confirm_lift:
            reason = f"held from both sides: {self._excess_text()}"
            return self._end(Outcome.GRIPPED, reason, event_ns, decided_ns=now_ns)
        self._enter(Phase.HOLD, now_ns)
        return Step(self._phase, command=Hold())

    def _hold(self, now_ns: int) -> Step:
        """Let the tension settle after the stop; what remains is the baseline of the lift."""
        if self._elapsed_s(now_ns) < self._settings.settle_s:
            return Step(self._phase)
        self._baseline_n = [reading.excess_n for reading in self._readings]
        if not self._encloses([reading.touching for reading in self._readings]):
            return self._end(Outcome.SLIPPED, f"lost while the fingers stopped: {self._excess_text()}", now_ns)
        self._enter(Phase.LIFT, now_ns)
        return Step(self._phase)

    def _lift(self, now_ns: int) -> Step:
        settings = self._settings
        losing = False
        for slot, (reading, baseline_n) in enumerate(zip(self._readings, self._baseline_n, strict=True)):
            allowed_n = max(
                settings.slip_floor_n,
                settings.slip_fraction * baseline_n,
                settings.contact_sigma * self._task.references[slot].stddev_n,
            )
            losing = losing or baseline_n - reading.excess_n > allowed_n
        began_ns = self._began("slipped", losing, now_ns)
        if began_ns is not None:
            held = ", ".join(f"{n} {b:.1f}" for n, b in zip(self._task.slots, self._baseline_n, strict=True))
            reason = (
                f"lost after {self._elapsed_s(now_ns):.2f} s of lifting: {self._excess_text()}; held with [N] {held}"
            )
            return self._end(Outcome.SLIPPED, reason, began_ns)
        if self._elapsed_s(now_ns) >= settings.lift_window_s:
            reason = f"held for {settings.lift_window_s:g} s: {self._excess_text()}"
            return self._end(Outcome.GRIPPED, reason, now_ns)
        return Step(self._phase)

    def _stop_finished_fingers(self) -> bool:
        """Drop fingers from the closing that pressed as hard as the product bears or came to their end."""
        recipe = self._task.product.recipe
        going_on = [
            slot
            for slot in self._closing
            if self._readings[slot].force_n < FORCE_MARGIN * recipe.force_limit_n
            and self._readings[slot].pulled_m < recipe.pull_limit_m - self._settings.reach_m
        ]
        pressed = len(going_on) < len(self._closing)
        self._closing = going_on
        return pressed

    def _lost_tendon(self, now_ns: int) -> Step | None:
        settings = self._settings
        for name, reading in zip(self._task.slots, self._readings, strict=True):
            slack = (
                self._phase is not Phase.APPROACH
                and reading.free_n >= settings.lost_floor_n
                and reading.tension_n < settings.lost_fraction * reading.free_n
            )
            began_ns = self._began(f"lost {name}", slack, now_ns)
            if began_ns is not None:
                reason = (
                    f"tendon {name} pulls nothing: expected {reading.free_n:.1f} N at {reading.pulled_m * 1e3:.1f} mm, "
                    f"found {reading.tension_n:.1f} N; look for a broken or unhooked cable"
                )
                return self._end(Outcome.TENDON_FAULT, reason, began_ns)
        return None

    def _encloses(self, fingers: Sequence[bool]) -> bool:
        """The thumb and at least one finger against it."""
        return fingers[self._task.thumb] and sum(fingers) > 1

    def _began(self, what: str, condition: bool, now_ns: int) -> int | None:
        """Follow a condition; return the stamp of the first sample of its run once the run is long enough."""
        if not condition:
            self._runs.pop(what, None)
            return None
        run = self._runs.setdefault(what, [])
        run.append(now_ns)
        return run[0] if len(run) >= self._settings.run else None

    def _close_command(self) -> Command:
        recipe = self._task.product.recipe
        free_n = max(reference.tension(recipe.pull_limit_m) for reference in self._task.references)
        excess_n = max(self._reader.excess_limit(slot, recipe.force_limit_n) for slot in self._closing)
        return Close(tuple(self._closing), recipe.pull_limit_m, recipe.closing_speed_m_per_s, free_n + excess_n)

    def _enter(self, phase: Phase, now_ns: int) -> None:
        self._phase = phase
        self._phase_since_ns = now_ns
        self._runs.clear()

    def _elapsed_s(self, now_ns: int) -> float:
        return (now_ns - self._phase_since_ns) / NANOSECONDS

    def _patience_s(self) -> float:
        recipe = self._task.product.recipe
        return START_S + CLOSING_PATIENCE * recipe.pull_limit_m / recipe.closing_speed_m_per_s

    def _end(self, outcome: Outcome, reason: str, event_ns: int, decided_ns: int | None = None) -> Step:
        if self._phase is Phase.DONE:
            return Step(self._phase)
        decided = decided_ns if decided_ns is not None else max(self._last_ns or event_ns, event_ns)
        evidence: dict[str, object] = {
            "phase": self._phase.value,
            "excess_n": {n: round(r.excess_n, 3) for n, r in zip(self._task.slots, self._readings, strict=False)},
            "contact_from_n": {
                n: round(r.threshold_n, 3) for n, r in zip(self._task.slots, self._readings, strict=False)
            },
            "force_at_most_n": {n: round(r.force_n, 3) for n, r in zip(self._task.slots, self._readings, strict=False)},
            "peak_excess_n": {n: round(p, 3) for n, p in zip(self._task.slots, self._peak_n, strict=True)},
            "decided_stamp_ns": decided,
        }
        self._phase = Phase.DONE
        return Step(
            Phase.DONE, command=Hold(), verdict=Verdict(outcome, reason, (decided - event_ns) / NANOSECONDS, evidence)
        )

    def _excess_text(self) -> str:
        parts = [
            f"{name} {reading.excess_n:+.1f} (contact from {reading.threshold_n:.1f})"
            for name, reading in zip(self._task.slots, self._readings, strict=True)
        ]
        return "excess tension [N] " + ", ".join(parts)

    def _pulled_text(self) -> str:
        parts = [f"{n} {r.pulled_m * 1e3:.1f}" for n, r in zip(self._task.slots, self._readings, strict=False)]
        return "pulled length [mm] " + ", ".join(parts)
