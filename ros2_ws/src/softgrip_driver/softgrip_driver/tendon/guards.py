# SPDX-License-Identifier: Apache-2.0
"""What watches over one drive. Each guard sees samples and says whether its fault is there; none moves anything."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from softgrip_driver.tendon.limits import TendonLimits

#: standard deviation over median absolute deviation of a normal distribution
NORMAL_MAD = 1.4826
#: [m/s^2] above which the current tells of the motor's inertia, not of the tendon: 0.5 m/s^2 of an XM430 on a spool of
#: 10 mm pass for some 50 N
STEADY_ACCELERATION = 0.15


class MedianFilter:
    """Median of the last three samples: one wild sample does not get through."""

    def __init__(self) -> None:
        self._window: deque[float] = deque(maxlen=3)

    def step(self, value: float) -> float:
        """Return the median with this sample."""
        self._window.append(value)
        return median(self._window)


class ReplySilence:
    """Counts how long a drive has not answered. Time in which this computer did not even ask is no silence of it.

    Args:
        period: [s] between questions.
    """

    #: [s] one unanswered question counts for at most, or a period
    LONGEST_QUESTION = 0.025

    def __init__(self, period: float) -> None:
        self._longest = max(self.LONGEST_QUESTION, period)
        self._asked: float | None = None
        self._lasted = 0.0

    def heard(self, now: float) -> None:
        """Record an answer at a time [s]."""
        self._asked, self._lasted = now, 0.0

    def unanswered(self, now: float) -> float:
        """Record that a question was not answered; return how long it lasts [s]."""
        if self._asked is not None:
            self._lasted += min(self._longest, now - self._asked)
        self._asked = now
        return self._lasted


class JumpGuard:
    """Keeps positions that a drive cannot have reached away from the controller.

    A single glitch (old XM430 firmware reads -1 as -4096) is dropped; a position that stays elsewhere means that the
    turn count is lost.
    """

    TOLERATED = 3

    def __init__(self, limits: TendonLimits) -> None:
        self._speed = 4.0 * limits.speed
        self._slack = 0.002
        self._last: tuple[float, float] | None = None
        self._outliers = 0

    def reset(self) -> None:
        """Forget the past: the next sample is believed."""
        self._last, self._outliers = None, 0

    def step(self, time: float, position: float) -> bool:
        """Return whether to believe a position [m] at a time [s]."""
        if self._last is None:
            self._last = (time, position)
            return True
        allowed = self._speed * max(0.0, time - self._last[0]) + self._slack
        if abs(position - self._last[1]) <= allowed:
            self._last, self._outliers = (time, position), 0
            return True
        self._outliers += 1
        return False

    @property
    def lost(self) -> bool:
        """Whether the position has stayed where it cannot be."""
        return self._outliers > self.TOLERATED


@dataclass(frozen=True)
class _Pull:
    """A sample of a pull: time [s] as its guard counts it, tension [N], pulled length [m]."""

    time: float
    tension: float
    pulled_length_m: float


class BreakGuard:
    """Detects a broken tendon: steady tension that vanishes while the tendon is not paid out.

    The tension before is a median over steady motion, because accelerating the motor passes for tension. It stays known
    while nobody looks (a late computer, a silent drive): a drive that stands as far in as before and feels nothing has
    lost its tendon, whenever that happened. One that has given way has not.
    """

    #: [s] how far back the tension before is looked for
    WINDOW = 0.25
    #: [s] of it that must have been seen
    MIN_VALUE = 0.12
    #: standard deviations that the drop must exceed: friction of standing gears can hide that much
    SIGMAS = 4.0
    #: the same of the scatter of the tension before, as a median deviation; a ramp scatters too
    SCATTERS = 2.0
    #: samples that the tension before must rest on
    MIN_COUNT = 8
    #: periods that a step counts for at most, however late it comes: what was not seen confirms nothing
    MAX_PERIODS = 2.0
    #: the rest of the tension that still counts as vanished
    REST = 0.25
    #: but no more than so many standard deviations of that rest, or the drop that a break begins at: beyond what gears
    #: can feign something pulls. A product that slips out leaves a finger the few newtons of its own joints
    NOTHING = 2.0
    #: [m] a drive that has given way by more has let the tension out: 10 N/mm, the stiffest that fingers get, would
    #: lose 2 N over it
    RETREAT = 2e-4

    def __init__(self, limits: TendonLimits, period: float = 0.01) -> None:
        self._limits = limits
        self._max = self.MAX_PERIODS * period
        # A slow loop needs longer to see as many samples.
        self._window = max(self.WINDOW, 1.5 * self.MIN_COUNT * period)
        self._recent: deque[_Pull] = deque()
        self._furthest = -math.inf
        """[m] No recent one is further in."""
        self._vanished_at: float | None = None
        self._last: float | None = None
        self._clock = 0.0
        self._before = 0.0
        self._certain_drop = 0.0
        self._feigned = math.inf

    def reset(self) -> None:
        """Forget the past: the tendon is being let out, or is new."""
        self._recent.clear()
        self._vanished_at = None

    def step(
        self,
        now: float,
        tension: float,
        pulled_length_m: float,
        *,
        stddev: float = 0.0,
        acceleration: float = 0.0,
        allowed: float = math.inf,
    ) -> bool:
        """Return whether the tendon is broken.

        Args:
            now: [s]
            tension: [N]
            pulled_length_m: [m].
            stddev: [N] uncertainty of the tension.
            acceleration: [m/s^2] of the tendon.
            allowed: [N] the most that the device may pull; no more can be missed.
        """
        elapsed = 0.0 if self._last is None else min(now - self._last, self._max)
        self._last = now
        self._certain_drop = self.SIGMAS * stddev if stddev > 0.0 else 0.0
        self._feigned = max(self._limits.break_drop_from, self.NOTHING * stddev) if stddev > 0.0 else math.inf
        self._forget_what_was_further_in(pulled_length_m)
        if acceleration < -STEADY_ACCELERATION:
            # A motor that slows down needs less current, which passes for less tension: such a step does not count.
            return False
        is_steady = acceleration < STEADY_ACCELERATION
        if is_steady or self._vanished_at is not None:
            # A drive that has lost its load runs away first: what it held before that is not long ago.
            self._clock += elapsed
        if self._vanished_at is not None:
            if not self._gone(tension):
                self._vanished_at = None
            return self._vanished_at is not None and self._clock - self._vanished_at >= self._limits.break_confirm
        while self._recent and self._clock - self._recent[0].time > self._window:
            self._recent.popleft()
        if self._vanishes(tension, allowed):
            self._vanished_at = self._clock
        elif is_steady:
            self._recent.append(_Pull(self._clock, tension, pulled_length_m))
            self._furthest = max(self._furthest, pulled_length_m)
        return False

    def _forget_what_was_further_in(self, pulled_length_m: float) -> None:
        if self._furthest <= pulled_length_m + self.RETREAT:
            return
        before = len(self._recent)
        self._recent = deque(pull for pull in self._recent if pull.pulled_length_m <= pulled_length_m + self.RETREAT)
        self._furthest = max((pull.pulled_length_m for pull in self._recent), default=-math.inf)
        if before and not self._recent:
            self._vanished_at = None

    @property
    def suspects(self) -> bool:
        """Whether a tension has vanished, which is not confirmed yet."""
        return self._vanished_at is not None

    def _vanishes(self, tension: float, allowed: float) -> bool:
        if len(self._recent) < self.MIN_COUNT or self._clock - self._recent[0].time < self.MIN_VALUE:
            return False
        tensions = [pull.tension for pull in self._recent]
        usual = median(tensions)
        self._before = min(usual, allowed)
        scatter = NORMAL_MAD * median(abs(one - usual) for one in tensions)
        certain = self._before - tension >= self.SCATTERS * scatter
        return certain and self._before >= self._limits.break_drop_from and self._gone(tension)

    def _gone(self, tension: float) -> bool:
        rest = max(self._limits.tension_slack, min(self.REST * self._before, self._feigned))
        return tension <= rest and self._before - tension >= self._certain_drop


class CollapseGuard:
    """Detects that a gauge shows nothing any more of a tendon that was not let out: it or the gauge's cable is broken.

    A gauge feels the tendon alone, whatever the motor does: two readings are enough to know the tension before, and the
    first one that shows nothing is a reason to stop. At ten readings a second the eight of `BreakGuard` take so long
    that those after a break come among them, and nothing becomes the tension before. A tension that fades over more
    readings than it remembers is no collapse.
    """

    #: readings of nothing in a row that name it; fewer may be damaged ones
    CONFIRM_READINGS = 3
    #: readings that it remembers: one that averages fades in a few
    REMEMBERED = 4
    #: share of a reading that the next one must show to be a tension that was there: what is let out fades faster
    KEPT = 0.9
    #: share of the tension before that counts as nothing
    REST = 0.25
    #: and so many times the tension of a slack tendon at most, while a cut cell may scatter by as much
    NOTHING = 2.0

    def __init__(self, limits: TendonLimits) -> None:
        self._limits = limits
        self._recent: deque[_Pull] = deque(maxlen=self.REMEMBERED)
        #: the first reading of nothing, and how many there have been in a row
        self._gone: _Pull | None = None
        self._count = 0
        #: [N] what was there before
        self.before = 0.0

    def reset(self) -> None:
        """Forget the past: the tendon is being let out, or is new."""
        self._recent.clear()
        self._gone, self._count = None, 0

    @property
    def suspects(self) -> bool:
        """Whether the gauge shows nothing of what was there before, confirmed or not."""
        return self._gone is not None

    @property
    def min_tension(self) -> float:
        """[N] that can be missed while the tendon is wound in, where it can only grow."""
        return min(self._limits.break_drop_from, self.NOTHING * self._limits.tension_slack)

    def step(self, now: float, pull: float, pulled_length_m: float, *, is_wound_in: bool) -> bool:
        """Return whether the tension has collapsed.

        Args:
            now: [s]
            pull: [N] single reading with its sign; a reversed cell's is not nothing.
            pulled_length_m: [m].
            is_wound_in: the setpoint moves inwards.
        """
        if self._gone is not None and pulled_length_m < self._gone.pulled_length_m - BreakGuard.RETREAT:
            self.reset()  # it has given way: the tension was let out
        if self._gone is None:
            self.before = self._held(pulled_length_m)
            drop_from = self.min_tension if is_wound_in else self._limits.break_drop_from
            if self.before >= drop_from and self._is_nothing(pull):
                self._gone = _Pull(now, pull, pulled_length_m)
        elif not self._is_nothing(pull):
            self._gone, self._count = None, 0
        if self._gone is None:
            self._recent.append(_Pull(now, pull, pulled_length_m))
            return False
        self._count += 1
        return self._count >= self.CONFIRM_READINGS and now - self._gone.time >= self._limits.break_confirm

    def _held(self, pulled_length_m: float) -> float:
        """Return the tension [N] that two readings in a row have shown lately, no further in than now."""
        furthest = pulled_length_m + BreakGuard.RETREAT
        pairs = [
            (one.tension, other.tension)
            for one, other in pairwise(self._recent)
            if max(one.pulled_length_m, other.pulled_length_m) <= furthest
        ]
        return max((min(pair) for pair in pairs if pair[1] >= self.KEPT * pair[0]), default=0.0)

    def _is_nothing(self, pull: float) -> bool:
        return abs(pull) <= min(self.REST * self.before, self.NOTHING * self._limits.tension_slack)


class TensionGuard:
    """Tells a tension above the hard limit; while the motor accelerates only when it lasts."""

    #: [s] longer than any acceleration to full speed
    CONFIRM = 0.1

    def __init__(self, limits: TendonLimits) -> None:
        self._hard = limits.tension_hard
        self._since: float | None = None

    def step(self, now: float, tension: float, acceleration: float) -> bool:
        """Return whether a tension [N] is too high, at an acceleration [m/s^2] of the tendon."""
        if tension <= self._hard:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        return acceleration < STEADY_ACCELERATION or now - self._since >= self.CONFIRM


class SlackGuard:
    """Tells a tendon that is wound in without tension."""

    #: [s] that it must last
    CONFIRM = 0.05

    def __init__(self, limits: TendonLimits) -> None:
        self._limits = limits
        self._since: float | None = None

    def step(
        self, now: float, pulled_length_m: float, tension: float, *, pulling: bool, acceleration: float = 0.0
    ) -> bool:
        """Return whether the tendon is slack at a pulled length [m], tension [N] and acceleration [m/s^2].

        A motor that slows down needs less current, which passes for less tension.
        """
        slack = pulling and pulled_length_m > self._limits.slack_travel and tension < self._limits.tension_slack
        if not slack:
            self._since = None
        elif acceleration < -STEADY_ACCELERATION:
            return False
        elif self._since is None:
            self._since = now
        return self._since is not None and now - self._since >= self.CONFIRM


class StallGuard:
    """Tells a drive that should move and does not."""

    #: [m] that count as motion
    MOTION = 2e-4

    def __init__(self, stall_time: float) -> None:
        self._stall_time = stall_time
        self._anchor: tuple[float, float] | None = None

    def step(self, now: float, pulled_length_m: float, *, moving: bool) -> bool:
        """Return whether the drive has stood still for the stall time although it should move."""
        if not moving or self._anchor is None or abs(pulled_length_m - self._anchor[1]) > self.MOTION:
            self._anchor = (now, pulled_length_m)
        return now - self._anchor[0] >= self._stall_time


class ThermalGuard:
    """Derates with temperature, stops before the servo would cut its torque, and lets go on when it has cooled down."""

    MIN_VALUE = 0.3

    def __init__(self, limits: TendonLimits) -> None:
        self._limits = limits
        self.tripped = False

    def step(self, temperature: float) -> float:
        """Return the share of the tension limit (0.3 .. 1) allowed at a temperature [degC]; NaN = not known yet."""
        if math.isnan(temperature):
            return 1.0
        low, high = self._limits.derate_from, self._limits.stop_at
        if temperature >= high:
            self.tripped = True
        elif temperature <= low:
            self.tripped = False
        share = (high - temperature) / (high - low)
        return max(self.MIN_VALUE, min(1.0, share))


class OverloadGuard:
    """Backs the tension off before the winding becomes too hot to hold at all.

    First-order estimate of its heat: h' = ((T / T_c)^2 - h) / tau, allowed up to 1; T_c is the tension that
    the drive holds for ever.
    """

    #: [s]
    TIME_CONSTANT = 20.0
    RECOVERED = 0.9

    def __init__(self, continuous_tension: float) -> None:
        self._continuous = continuous_tension
        self.heat = 0.0
        self.backed_off = False

    def step(self, tension: float, dt: float) -> float:
        """Return the largest tension [N] allowed now."""
        load = (tension / self._continuous) ** 2
        self.heat += (load - self.heat) * min(1.0, dt / self.TIME_CONSTANT)
        if self.heat >= 1.0:
            self.backed_off = True
        elif self.heat < self.RECOVERED:
            self.backed_off = False
        return 0.9 * self._continuous if self.backed_off else math.inf


class ShutdownGuard:
    """Takes tension away before a servo's own overload shutdown would drop the object.

    No data sheet says when that comes. A user saw it at 41 % of the stall current after "around 5s"
    (ROBOTIS-GIT/DynamixelSDK issue 285), others at more after 10 to 20 s. So nine tenths of that load may stand for
    three seconds, more for less, and then the tension sinks until the load may last; slowly, as a tension that falls at
    once looks like a lost product. It is given back after a rest only: else the drive would pull and slip for ever.

    Args:
        max_load: share of the stall torque that may stand for `MAX_TIME` alone; 1 = any.
        floor: [N] that is left in any case.
    """

    #: [s]
    MAX_TIME = 3.0
    #: shares of the largest load: what may last, and below what it is a rest
    LASTING, REST = 0.9, 0.5
    #: [s] of `MAX_TIME` that a second below the largest load makes up for
    RECOVERY = 0.1
    #: [1/s] of the tension that sinks
    SINKING = 0.5

    def __init__(self, max_load: float, floor: float) -> None:
        self._max_load = max_load if max_load < 1.0 else math.inf
        self._floor = floor
        self._borne = 0.0
        self._from = self._maximum = math.inf

    @property
    def backed_off(self) -> bool:
        """Whether it allows less than was asked for."""
        return self._maximum < math.inf

    def step(self, load: float, tension: float, dt: float) -> float:
        """Return the largest tension [N] allowed now, after ``dt`` [s] at a load (share of the stall torque).

        A load that is not known (NaN) counts as none.
        """
        relative = load / self._max_load
        if relative > 1.0:
            self._borne = min(self.MAX_TIME, self._borne + relative * dt)
        else:
            self._borne = max(0.0, self._borne - self.RECOVERY * dt)
        if self._borne >= self.MAX_TIME and not self.backed_off:
            self._from = self._maximum = max(tension, self._floor)
        if self.backed_off and relative > self.LASTING:
            self._maximum = max(self._floor, self._maximum - self.SINKING * self._from * dt)
        elif self._borne <= 0.0 and not relative > self.REST:
            self._maximum = math.inf
        return self._maximum
