# SPDX-License-Identifier: Apache-2.0
"""One grasp from approach to verdict. GraspSequence.TABLE says what follows from what the hand does.

Decided on nothing but observations and their stamps, so that a bag replays to the same verdicts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from softgrip_cell.grasp.commands import Command, Open, Stop, TensionControl
from softgrip_cell.grasp.contact import ContactEstimator, FingerContact
from softgrip_cell.grasp.hand import HandEstimator, HandState
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import (
    FingerEvidence,
    GraspEvidence,
    GraspOutcome,
    GraspPhase,
    GraspTask,
    GraspVerdict,
    contact_text,
    pulled_text,
)
from softgrip_cell.observation import ObservedPair, SeenTip, TendonFault, TendonSample
from softgrip_time.units import NANOSECONDS, to_ns


@dataclass(frozen=True)
class GraspStep:
    """What follows from one observation; usually nothing."""

    phase: GraspPhase
    commands: tuple[Command, ...] = ()
    verdict: GraspVerdict | None = None
    contact: bool = False


@dataclass(frozen=True)
class Rule:
    """A row of TABLE.

    Attributes:
        name: when it applies, in words.
        since: returns the stamp from which on it has applied, None while it does not.
        then: the next phase, or the outcome.
        commands: what is commanded then; nothing by default.
        reason: why an outcome is the outcome.
    """

    name: str
    since: Callable[[GraspSequence], int | None]
    then: GraspPhase | GraspOutcome
    commands: Callable[[GraspSequence], tuple[Command, ...]] | None = None
    reason: Callable[[GraspSequence], str] | None = None


class GraspSequence:
    """Steps one grasp.

    Feed it every pair of tendon sample and prediction, every fault, and the end of every closing that it commanded; do
    what the returned steps command; stop when a step carries a verdict.
    """

    def __init__(self, task: GraspTask, settings: GraspSettings) -> None:
        self._task = task
        self._recipe = task.recipe
        self._settings = settings
        self._estimator = ContactEstimator(task.slots, task.references, task.paths_m, settings)
        self._control = TensionControl(task, settings, self._estimator)
        self._hand_estimator = HandEstimator(task, settings, self._control)
        self._hand: HandState | None = None
        self._phase = GraspPhase.APPROACH
        self._now_ns: int | None = None
        self._unpaired_ns: deque[int] = deque()  # stamps of samples that wait for their prediction
        self._phase_since_ns = 0
        self._closing = list(range(len(task.slots)))
        self._has_path_ended = False
        self._had_opposing_contact = False
        self._before = ""
        self._runs: dict[str, list[int]] = {}

    @property
    def phase(self) -> GraspPhase:
        """Where the grasp stands."""
        return self._phase

    @property
    def hand(self) -> HandState | None:
        """The present state of the hand; None before the first sample."""
        return self._hand

    def start(self) -> GraspStep:
        """Return the first command: fingers open."""
        return GraspStep(self._phase, (Open(),))

    def observe(self, pair: ObservedPair) -> GraspStep:
        """Take one tendon sample with its prediction: contacts, hand, table."""
        now_ns = pair.sample.stamp_ns
        if self._phase is GraspPhase.DONE or (self._now_ns is not None and now_ns <= self._now_ns):
            return self._unchanged
        objection = self._objection(pair)
        if objection:
            return self._end(GraspOutcome.ABORTED, f"the free motion cannot be predicted: {objection}", now_ns)
        if self._now_ns is None:
            self._phase_since_ns = now_ns
        self._now_ns = now_ns
        while self._unpaired_ns and self._unpaired_ns[0] <= now_ns:
            self._unpaired_ns.popleft()
        contacts = self._estimator.estimate(pair, self._control.slots)
        self._hand = self._hand_estimator.estimate(now_ns, contacts)
        for rule in self.TABLE[self._phase]:
            since_ns = rule.since(self)
            if since_ns is not None:
                return self._apply(rule, since_ns)
        return self._unchanged

    def _apply(self, rule: Rule, since_ns: int) -> GraspStep:
        reason = rule.reason(self) if rule.reason is not None else ""
        commands = rule.commands(self) if rule.commands is not None else ()
        if isinstance(rule.then, GraspOutcome):
            return self._end(rule.then, reason, since_ns, commands)
        if rule.then is not self._phase:
            self._phase, self._phase_since_ns = rule.then, self._now
            self._runs.clear()
        return GraspStep(self._phase, commands, contact=self._is_touching)

    def observe_tip(self, tip: SeenTip) -> None:
        """Take a fingertip that the camera has seen; the next sample is judged with it."""
        self._estimator.observe_tip(tip)

    def observe_sample(self, sample: TendonSample) -> GraspStep:
        """Take a tendon sample that has no prediction yet; too long without one ends the grasp."""
        if self._phase is GraspPhase.DONE or self._now_ns is None or sample.stamp_ns <= self._now_ns:
            return self._unchanged
        stale_ns = to_ns(self._settings.stale_s)
        waiting = self._unpaired_ns
        # While no samples came, or none were taken in, there was nothing to predict; the wait begins with the next one.
        if waiting and sample.stamp_ns - waiting[-1] > stale_ns:
            waiting.clear()
        waiting.append(sample.stamp_ns)
        gap_ns = sample.stamp_ns - waiting[0]
        if gap_ns <= stale_ns or len(waiting) < self._settings.stale_samples:
            return self._unchanged
        reason = f"expected a finger/predicted for every tendon/state, found none for {gap_ns / NANOSECONDS:.2f} s"
        return self._end(GraspOutcome.ABORTED, reason, sample.stamp_ns)

    def closing_ended(self) -> None:
        """Record that the commanded closing came to its end (targets or tension limit)."""
        self._has_path_ended = True

    def fault(self, fault: TendonFault, stamp_ns: int) -> GraspStep:
        """End the grasp: a tendon has a fault."""
        return self._end(GraspOutcome.TENDON_FAULT, f"tendon {fault.tendon}: {fault.name}: {fault.reason}", stamp_ns)

    def abort(self, reason: str, stamp_ns: int | None = None) -> GraspStep:
        """End the grasp from outside; the fingers stay where they are."""
        return self._end(GraspOutcome.ABORTED, reason, stamp_ns if stamp_ns is not None else self._now_ns or 0)

    # --- since when: conditions of TABLE, in its order ---------------------------------------------------------------

    def _since_open(self) -> int | None:
        is_open = all(contact.pulled_length_m <= self._settings.open_m for contact in self._contacts)
        return self._now if is_open else None

    def _since_timeout(self) -> int | None:
        settings, recipe = self._settings, self._recipe
        path_s = recipe.pull_limit_m / recipe.closing_speed_m_per_s
        is_over = self._elapsed_s() > settings.closing_start_s + settings.closing_timeout_factor * path_s
        return self._now if is_over else None

    def _since_slack(self) -> int | None:
        """A tendon pulls next to nothing where free motion alone would need some newtons."""
        settings = self._settings
        found = None
        for name, contact in zip(self._task.slots, self._contacts, strict=True):
            is_slack = (
                contact.is_judged
                and contact.free_n >= settings.lost_floor_n
                and contact.tension_n < settings.lost_fraction * contact.free_n
            )
            since_ns = self._lasting(f"slack {name}", is_slack, settings.lost_s)
            found = since_ns if found is None else found
        return found

    def _since_lost_while_closing(self) -> int | None:
        self._had_opposing_contact = self._had_opposing_contact or self._state.has_opposing_contact
        is_lost = self._had_opposing_contact and self._state.has_no_contact
        return self._lasting("lost while closing", is_lost, self._settings.slip_s)

    def _since_enclosing(self) -> int | None:
        return self._now if self._state.is_enclosing else None

    def _since_finger_is_done(self) -> int | None:
        return self._now if self._pressed_enough() else None

    def _since_end_of_path(self) -> int | None:
        """Every finger is where it can go: the closing has come to its end, or nothing moves any more."""
        self._leave_out_fingers_at_end()
        is_still = self._elapsed_s() >= self._settings.closing_start_s
        is_still = is_still and self._state.motion_m <= self._settings.standing_m
        return self._lasting("end of path", self._has_path_ended or is_still)

    def _since_thumb_alone(self) -> int | None:
        applies = self._task.confirm_lift and self._state.is_hooked_on and self._since_end_of_path() is not None
        return self._now if applies else None

    def _since_lost(self) -> int | None:
        """Nothing is held any more: at once when it collapsed, else after slip_s without a side."""
        collapsed_ns = self._lasting("collapsed", self._state.has_collapsed)
        lost_ns = self._lasting("not holding", not self._state.is_holding, self._settings.slip_s)
        if collapsed_ns is None and self._phase is GraspPhase.LIFT and self._state.is_tip_deflected:
            return None  # while lifted, what bends a finger can only be what hangs in the hand
        return collapsed_ns if collapsed_ns is not None else lost_ns

    def _since_lost_what_was_pressed(self) -> int | None:
        since_ns = self._since_lost()
        return since_ns if self._state.was_pressed else None

    def _since_held(self) -> int | None:
        """The grip is full, or it has settled with less: time is up for pressing harder, and nothing gives way."""
        full_ns = self._lasting("full", self._state.is_gripping)
        if full_ns is not None or self._elapsed_s() < self._settings.settle_s or not self._state.is_holding:
            return full_ns
        max_m = self._settings.follow_m if self._task.confirm_lift else self._settings.resting_m
        return self._now if self._state.motion_m <= max_m else None

    def _since_held_to_lift(self) -> int | None:
        return self._since_held() if self._task.confirm_lift else None

    def _since_giving_way(self) -> int | None:
        settings = self._settings
        due_s = settings.settle_s if self._phase is GraspPhase.HOLD else settings.lift_window_s
        return self._now if self._elapsed_s() >= due_s + settings.giving_way_s else None

    def _since_hanging(self) -> int | None:
        """The lift window is over, and what hangs in the hand does not make it follow."""
        hand, over_s = self._state, self._elapsed_s() - self._settings.lift_window_s
        is_hanging = (hand.is_holding or hand.is_tip_deflected) and hand.motion_m <= self._settings.follow_m
        return self._now if over_s >= 0.0 and is_hanging else None

    def _since_now(self) -> int | None:
        return self._now

    def _lasting(self, name: str, condition: bool, for_s: float = 0.0) -> int | None:
        """Follow a condition; return the stamp of the first sample of its run once the run is long enough.

        Args:
            name: of the condition.
            condition: whether it holds now.
            for_s: how long it has to hold at least [s]; and in as many samples as any decision takes.
        """
        if not condition:
            self._runs.pop(name, None)
            return None
        run = self._runs.setdefault(name, [])
        if not run or run[-1] != self._now:
            run.append(self._now)
        is_enough = len(run) >= self._estimator.decision_samples and self._now - run[0] >= to_ns(for_s)
        return run[0] if is_enough else None

    # --- commands of TABLE -------------------------------------------------------------------------------------------

    def _close(self) -> tuple[Command, ...]:
        self._closing = list(self._every_slot)
        self._had_opposing_contact = self._has_path_ended = False
        return (self._control.close(self._closing),)

    def _press_enclosed(self) -> tuple[Command, ...]:
        """What touches presses as the recipe asks, what does not goes on closing."""
        contacts, touching = self._contacts, [slot for slot in self._every_slot if self._state.pressing[slot]]
        self._hand_estimator.start_hold(contacts)
        # Pulling harder at its end would only press a finger on its own stops.
        new = [slot for slot in touching if slot not in self._control.slots and contacts[slot].is_short]
        self._closing = [slot for slot in self._closing if slot not in touching]
        return self._press(new)

    def _press_done(self) -> tuple[Command, ...]:
        """Fingers that press hard enough keep their tension; the driver goes on closing the others."""
        done = self._pressed_enough()
        self._closing = [slot for slot in self._closing if slot not in done and self._contacts[slot].is_short]
        self._has_path_ended = not self._closing
        return self._press(done)

    def _press_what_touches(self) -> tuple[Command, ...]:
        """Fingers that came later press as well; the others keep what they have."""
        contacts = self._contacts
        new = [
            slot
            for slot in self._closing
            if contacts[slot].is_touching and not self._control.is_near_end(slot, contacts[slot])
        ]
        self._closing = [slot for slot in self._closing if slot not in new]
        return (*self._press(new), *self._keep_up())

    def _keep_the_rest(self) -> tuple[Command, ...]:
        """No finger goes on closing beside a product that is held."""
        self._hand_estimator.add_met_near_end(self._closing, self._contacts)
        rest = [slot for slot in self._every_slot if slot not in self._control.slots]
        self._closing = []
        return (self._control.keep_tension(rest, self._contacts, self._now),) if rest else ()

    def _keep_the_rest_for_the_lift(self) -> tuple[Command, ...]:
        self._before = contact_text(self._task.slots, self._contacts)
        commands = self._keep_the_rest()
        self._control.hold_still()
        return commands

    def _keep_up(self) -> tuple[Command, ...]:
        return self._control.keep_up(self._contacts, self._state.standing, self._now)

    def _press(self, slots: list[int]) -> tuple[Command, ...]:
        return (self._control.press(slots, self._contacts, self._now),) if slots else ()

    def _pressed_enough(self) -> list[int]:
        """Closing fingers that press with the holding tension, or may press with what the product bears."""
        limit_n = self._settings.force_margin * self._recipe.force_limit_n
        enough_n = self._recipe.hold_contact_tension_n
        contacts = self._contacts
        return [
            slot
            for slot in self._closing
            if (contacts[slot].is_touching and contacts[slot].strength_n >= enough_n)
            or (contacts[slot].is_at_threshold and contacts[slot].force_n >= limit_n)
        ]

    def _leave_out_fingers_at_end(self) -> None:
        going_on = [slot for slot in self._closing if self._contacts[slot].is_short]
        if len(going_on) < len(self._closing):
            self._closing, self._has_path_ended = going_on, not going_on

    # --- reasons of TABLE --------------------------------------------------------------------------------------------

    def _not_open_reason(self) -> str:
        return f"the fingers do not open: {pulled_text(self._task.slots, self._contacts)}"

    def _no_end_reason(self) -> str:
        return f"the fingers do not come to an end: {pulled_text(self._task.slots, self._contacts)}"

    def _lost_while_closing_reason(self) -> str:
        return self._with_contacts("the product got away while closing")

    def _lost_while_pressing_reason(self) -> str:
        return self._with_contacts("lost while the fingers pressed")

    def _held_reason(self) -> str:
        return self._with_contacts("held from both sides")

    def _hung_reason(self) -> str:
        return self._with_contacts(f"held for {self._settings.lift_window_s:g} s")

    def _slack_reason(self) -> str:
        run_of = {name: self._runs.get(f"slack {name}") for name in self._task.slots}
        name = min((name for name in self._task.slots if run_of[name]), key=lambda each: run_of[each] or [])
        contact = self._contacts[self._task.slots.index(name)]
        return (
            f"tendon {name} pulls nothing: expected {contact.free_n:.1f} N at {contact.pulled_length_m * 1e3:.1f} mm, "
            f"found {contact.tension_n:.1f} N; look for a broken or unhooked cable"
        )

    def _empty_reason(self) -> str:
        touching = [n for n, contact in zip(self._task.slots, self._contacts, strict=True) if contact.is_touching]
        what = f"touched by {', '.join(touching)} only" if touching else "closed on nothing"
        return self._with_contacts(what)

    def _lost_in_lift_reason(self) -> str:
        since_ns = self._since_lost() or self._now
        lifted_s = (since_ns - self._phase_since_ns) / NANOSECONDS
        return self._with_contacts(f"lost after {lifted_s:.2f} s of lifting") + f"; before: {self._before}"

    def _giving_way_reason(self) -> str:
        before = f"; before: {self._before}" if self._before else ""
        return self._with_contacts("keeps giving way") + before

    def _with_contacts(self, what: str) -> str:
        return f"{what}: {contact_text(self._task.slots, self._contacts)}"

    # --- bookkeeping -------------------------------------------------------------------------------------------------

    def _objection(self, pair: ObservedPair) -> str:
        """Why the prediction cannot be used; beyond a finger's checked path it is not needed."""
        if pair.free.objection:
            return pair.free.objection
        within = [
            pulled_length_m <= reference.reach_m
            for pulled_length_m, reference in zip(pair.sample.pulled_length_m, self._task.references, strict=True)
        ]
        return "; ".join(text for text, needed in zip(pair.free.objections, within, strict=True) if text and needed)

    @property
    def _state(self) -> HandState:
        assert self._hand is not None, "expected a sample before the table is asked"
        return self._hand

    @property
    def _contacts(self) -> tuple[FingerContact, ...]:
        return self._hand.contacts if self._hand is not None else ()

    @property
    def _now(self) -> int:
        return self._now_ns or 0

    @property
    def _is_touching(self) -> bool:
        return any(contact.is_touching for contact in self._contacts)

    @property
    def _unchanged(self) -> GraspStep:
        """Nothing to do, and nothing new to say."""
        return GraspStep(self._phase, contact=self._is_touching)

    @property
    def _every_slot(self) -> range:
        return range(len(self._task.slots))

    def _elapsed_s(self) -> float:
        return (self._now - self._phase_since_ns) / NANOSECONDS

    def _end(self, outcome: GraspOutcome, reason: str, event_ns: int, commands: tuple[Command, ...] = ()) -> GraspStep:
        """Finish; a gripped product stays held by its tension, otherwise the fingers stay where they are."""
        if self._phase is GraspPhase.DONE:
            return GraspStep(self._phase)
        decided_ns = max(self._now_ns or event_ns, event_ns)
        evidence = self._evidence(decided_ns)
        self._phase = GraspPhase.DONE
        if outcome is not GraspOutcome.GRIPPED:
            commands = (Stop(),)
        latency_s = (decided_ns - event_ns) / NANOSECONDS
        return GraspStep(GraspPhase.DONE, commands, GraspVerdict(outcome, reason, latency_s, evidence))

    def _evidence(self, decided_ns: int) -> GraspEvidence:
        deviation_m = self._estimator.tip_deviation_m(decided_ns)
        fingers = tuple(
            FingerEvidence(
                finger=self._task.slots[slot],
                state=contact.state,
                contact_tension_n=contact.contact_tension_n,
                threshold_n=contact.threshold_n,
                stddev_n=contact.stddev_n,
                peak_contact_tension_n=self._hand_estimator.peak_n[slot],
                max_force_n=contact.force_n,
                tip_deviation_m=deviation_m.get(slot),
            )
            for slot, contact in enumerate(self._contacts)
        )
        return GraspEvidence(self._phase, decided_ns, fingers)

    #: (phase, state of the hand) -> (phase or outcome, commands); in each phase the first rule that applies counts.
    TABLE: ClassVar[Mapping[GraspPhase, tuple[Rule, ...]]] = {
        GraspPhase.APPROACH: (
            Rule("every finger is open", _since_open, GraspPhase.CLOSE, _close),
            Rule("the time for opening is over", _since_timeout, GraspOutcome.ABORTED, reason=_not_open_reason),
        ),
        GraspPhase.CLOSE: (
            Rule("a tendon pulls nothing for lost_s", _since_slack, GraspOutcome.TENDON_FAULT, reason=_slack_reason),
            Rule(
                "both sides touched, and nothing does for slip_s", _since_lost_while_closing,
                GraspOutcome.SLIPPED, reason=_lost_while_closing_reason,
            ),
            Rule("something is enclosed", _since_enclosing, GraspPhase.HOLD, _press_enclosed),
            Rule("a finger presses enough", _since_finger_is_done, GraspPhase.CLOSE, _press_done),
            Rule("a hook's thumb alone presses at the end", _since_thumb_alone, GraspPhase.HOLD, _press_enclosed),
            Rule("the fingers are at their end", _since_end_of_path, GraspOutcome.EMPTY, reason=_empty_reason),
            Rule("the time for closing is over", _since_timeout, GraspOutcome.ABORTED, reason=_no_end_reason),
            Rule("else", _since_now, GraspPhase.CLOSE, _keep_up),
        ),
        GraspPhase.HOLD: (
            Rule(
                "the hold is lost, and both sides had pressed", _since_lost_what_was_pressed, GraspOutcome.SLIPPED,
                reason=_lost_while_pressing_reason,
            ),
            # A contact that was none, or one that only pushed the product along: go on looking for it.
            Rule("the hold is lost", _since_lost, GraspPhase.CLOSE, _close),
            Rule(
                "the hold is full or has settled, to be lifted", _since_held_to_lift, GraspPhase.LIFT,
                _keep_the_rest_for_the_lift,
            ),
            Rule("the hold is full or has settled", _since_held, GraspOutcome.GRIPPED, _keep_the_rest, _held_reason),
            Rule(
                "giving_way_s later it has not settled", _since_giving_way, GraspOutcome.SLIPPED,
                reason=_giving_way_reason,
            ),
            Rule("else", _since_now, GraspPhase.HOLD, _press_what_touches),
        ),
        GraspPhase.LIFT: (
            Rule("the hold is lost", _since_lost, GraspOutcome.SLIPPED, reason=_lost_in_lift_reason),
            Rule(
                "giving_way_s after the lift window", _since_giving_way, GraspOutcome.SLIPPED,
                reason=_giving_way_reason,
            ),
            Rule("the lift window is over, and it hangs", _since_hanging, GraspOutcome.GRIPPED, reason=_hung_reason),
            Rule("else", _since_now, GraspPhase.LIFT, _keep_up),
        ),
    }  # fmt: skip
