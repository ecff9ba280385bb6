# SPDX-License-Identifier: Apache-2.0
"""The life of an alarm: raised, confirmed once it has lasted, healed once it is gone, acknowledged by a person.

What has to last before it matters is a remark until then: shown, and nobody has to acknowledge it.
One that is healed and acknowledged is over and goes into the history; one that comes back before is the same alarm.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from softgrip_panel.errors import ActRefusedError
from softgrip_panel.texts import say

#: What lasts so long is confirmed, and what is gone so long is healed [s].
CONFIRM_S = 0.5
HEAL_S = 1.0
#: So many alarms are shown at once, so many that are over are kept.
MAX_ALARMS = 200
MAX_HISTORY = 500


class AlarmLevel(StrEnum):
    """How much it matters."""

    WARNING = "warning"
    ERROR = "error"


class AlarmStage(StrEnum):
    """Where in its life an alarm is."""

    RAISED = "raised"
    CONFIRMED = "confirmed"
    HEALED = "healed"


@dataclass(frozen=True)
class AlarmFact:
    """What is wrong now: where, what, why, and what to do.

    Attributes:
        must_last_s: it is an alarm once it has lasted so long, and a remark before [s]; infinite: never an alarm.
    """

    source: str
    title: str
    level: AlarmLevel = AlarmLevel.ERROR
    cause: str = ""
    remedy: str = ""
    must_last_s: float = 0.0


@dataclass(frozen=True)
class Alarm:
    """One alarm; times in seconds since the Unix epoch."""

    key: str
    fact: AlarmFact
    stage: AlarmStage
    raised_s: float
    acknowledged_by: str = ""
    times: int = 1


class AlarmBook:
    """Keeps the alarms.

    Args:
        now_s: seconds since the Unix epoch.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._alarms: dict[str, Alarm] = {}
        self._waiting: dict[str, tuple[AlarmFact, float]] = {}  # with the time since which it is so
        self._gone_s: dict[str, float] = {}
        self._since_s: dict[str, float] = {}
        self._by_source: dict[str, set[str]] = {}
        self._history: deque[Alarm] = deque(maxlen=MAX_HISTORY)

    @property
    def active(self) -> tuple[Alarm, ...]:
        """What is not over, newest first, errors before warnings."""
        order = sorted(self._alarms.values(), key=lambda alarm: -alarm.raised_s)
        return tuple(sorted(order, key=lambda alarm: alarm.fact.level is not AlarmLevel.ERROR))

    @property
    def count(self) -> int:
        """How many are not over."""
        return len(self._alarms)

    @property
    def history(self) -> tuple[Alarm, ...]:
        """What is over, newest first."""
        return tuple(reversed(self._history))

    @property
    def remarks(self) -> tuple[AlarmFact, ...]:
        """What is said and is no alarm: it has not lasted long enough, or is as it should be."""
        return tuple(fact for fact, _ in list(self._waiting.values()))

    def observe(self, source: str, facts: Mapping[str, AlarmFact]) -> None:
        """Take all that is wrong at one source now; what it named before and does not name now is gone.

        Args:
            source: that is looked at, such as "tendon/status".
            facts: by a key that stays the same while it lasts.
        """
        now_s = self._now_s()
        for key, fact in facts.items():
            if self._has_to_last(key, fact, now_s):
                continue
            self._gone_s.pop(key, None)
            self._raise(key, fact, now_s)
        for key in self._by_source.get(source, set()) - facts.keys():
            self._waiting.pop(key, None)
            if key in self._alarms:
                self._gone_s.setdefault(key, now_s)
        self._by_source[source] = set(facts) | {
            key for key in self._by_source.get(source, set()) if key in self._alarms
        }

    def advance(self) -> None:
        """Let time pass: confirm what has lasted, heal what is gone, close what is healed and acknowledged."""
        now_s = self._now_s()
        for key, (fact, _) in list(self._waiting.items()):
            if not self._has_to_last(key, fact, now_s):
                self._gone_s.pop(key, None)
                self._raise(key, fact, now_s)
        for key, alarm in list(self._alarms.items()):
            gone_s = self._gone_s.get(key)
            if gone_s is not None and alarm.stage is not AlarmStage.HEALED and now_s - gone_s >= HEAL_S:
                self._alarms[key] = replace(alarm, stage=AlarmStage.HEALED)
            elif alarm.stage is AlarmStage.RAISED and gone_s is None and now_s - self._since_s[key] >= CONFIRM_S:
                self._alarms[key] = replace(alarm, stage=AlarmStage.CONFIRMED)
            self._close_if_over(key)

    def acknowledge(self, key: str, who: str) -> None:
        """Take that a person has seen an alarm.

        Raises:
            ActRefusedError: there is none of that key, or it was acknowledged before.
        """
        alarm = self._alarms.get(key)
        if alarm is None:
            raise ActRefusedError(say("error.alarm_over", key=key))
        if alarm.acknowledged_by:
            raise ActRefusedError(say("error.alarm_acknowledged", title=alarm.fact.title, name=alarm.acknowledged_by))
        self._alarms[key] = replace(alarm, acknowledged_by=who)
        self._close_if_over(key)

    def _has_to_last(self, key: str, fact: AlarmFact, now_s: float) -> bool:
        """Whether a fact is a remark still; one that is an alarm already, and not healed, is none again."""
        alarm = self._alarms.get(key)
        is_alarm = alarm is not None and alarm.stage is not AlarmStage.HEALED
        since_s = self._waiting.get(key, (fact, now_s))[1]
        if is_alarm or now_s - since_s >= fact.must_last_s:
            self._waiting.pop(key, None)
            return False
        if key in self._waiting or len(self._waiting) < MAX_ALARMS:
            self._waiting[key] = (fact, since_s)
        return True

    def _raise(self, key: str, fact: AlarmFact, now_s: float) -> None:
        alarm = self._alarms.get(key)
        if alarm is None:
            if len(self._alarms) >= MAX_ALARMS:
                return  # whoever sends hundreds of kinds of them at once fills no memory here
            self._alarms[key] = Alarm(key, fact, AlarmStage.RAISED, now_s)
            self._since_s[key] = now_s
        elif alarm.stage is AlarmStage.HEALED:
            # it came back before anybody had acknowledged it
            self._alarms[key] = replace(alarm, fact=fact, stage=AlarmStage.RAISED, times=alarm.times + 1)
            self._since_s[key] = now_s
        else:
            self._alarms[key] = replace(alarm, fact=fact)

    def _close_if_over(self, key: str) -> None:
        alarm = self._alarms[key]
        if alarm.stage is AlarmStage.HEALED and alarm.acknowledged_by:
            self._history.append(alarm)
            del self._alarms[key], self._since_s[key]
            self._gone_s.pop(key, None)
