# SPDX-License-Identifier: Apache-2.0
"""The order of a node's inputs: by their stamps, not by their arrival, so that a replay comes to the same outputs.

One stream drives a node (tendon/state, the camera's frames); each of its messages is answered at once. The other inputs
are ordered against it:

* A **latched** input (a friction model, the cell's state) holds from the first driving message on whose stamp is at
  least its own stamp plus the allowed lateness. Whoever sends it has that long to reach the node: until then no driving
  message that it matters to has been answered, and no answer had to wait. Two inputs of one topic hold in the order
  they came in.
* An input that comes later than that is **late**. It holds from the next driving message on. So does one without a
  stamp, or with one of another clock.
* A **paired** input (what the camera measured) is compared with driving messages of its own time, which are kept for a
  while; a later one is late, and dropped.

What is late is counted on /diagnostics and written down as an InputNote on ``~/input_notes``, with the driving message
after which it came: with these, the rule is complete. So is the first driving message that the node got.
"""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header

from softgrip_interfaces.msg import InputNote
from softgrip_nodekit.diagnostics import Diagnostics, Health
from softgrip_nodekit.parameters import Parameter
from softgrip_nodekit.stamps import nanoseconds, to_time_message
from softgrip_time.units import NANOSECONDS, to_ns

#: [ns] further behind its newest message the driving stream is only when its source has restarted.
RESTART_NS: Final = 2 * NANOSECONDS
#: [ns] further ahead of the driving stream no stamp of the same clock is.
MAX_AHEAD_NS: Final = 10 * NANOSECONDS
#: Late subscribers receive all that a node may have to say about a day.
_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

#: Called with topic, stamp of an input, and stamp of the driving message that it came after (0: none) [ns].
NoteInput = Callable[[str, int, int], None]


def lateness_parameter(default_s: float) -> Parameter:
    """Return the parameter of a node that orders its inputs."""
    text = "an input holds from its stamp plus this on; one that comes later is late"
    return Parameter("allowed_lateness_s", default_s, text, "s", 0.0, 5.0)


@dataclass(frozen=True, order=True)
class _Held:
    """A latched input that does not hold yet; by when it will, then by arrival."""

    due_ns: int
    number: int
    topic: str
    apply: Callable[[], None]


class LatchedInputs:
    """Latched inputs, each held back until it holds.

    Args:
        allowed_lateness_s: see above [s].
        note: called with what is late.

    Attributes:
        newest_ns: stamp of the newest driving message, 0 = none yet [ns].
    """

    def __init__(self, allowed_lateness_s: float, note: NoteInput) -> None:
        self._lateness_ns = to_ns(allowed_lateness_s)
        self._note = note
        self.newest_ns = 0
        self._held: list[_Held] = []
        self._number = 0

    def put(self, topic: str, stamp_ns: int, apply: Callable[[], None]) -> None:
        """Take an input; ``apply`` is called when it holds, which may be now.

        Args:
            topic: that it came on.
            stamp_ns: its stamp, 0 = none [ns].
            apply: makes it hold.
        """
        before = [held for held in self._held if held.topic == topic]
        due_ns = max([stamp_ns + self._lateness_ns, *(held.due_ns for held in before)])
        if stamp_ns and (not self.newest_ns or self.newest_ns < due_ns <= self.newest_ns + MAX_AHEAD_NS):
            self._number += 1
            bisect.insort(self._held, _Held(due_ns, self._number, topic, apply))
            return
        self._note(topic, stamp_ns, self.newest_ns)
        for held in before:
            self._held.remove(held)
            held.apply()
        apply()

    def advance(self, stamp_ns: int) -> None:
        """Make hold what a driving message of a stamp [ns] is to be answered with."""
        is_restart = self.newest_ns - stamp_ns > RESTART_NS
        self.newest_ns = stamp_ns if is_restart else max(stamp_ns, self.newest_ns)
        while self._held and self._held[0].due_ns <= self.newest_ns:
            self._held.pop(0).apply()


class StampedMessage(Protocol):
    """A message that says of when it is."""

    @property
    def header(self) -> Header:
        """With its stamp."""


class StampedInputs:
    """A node's inputs by stamp, with what was late on /diagnostics and on ``~/input_notes``.

    Args:
        node: that has them.
        driver: topic that drives it.
        allowed_lateness_s: of latched inputs [s].
        diagnostics: of the node; the component is "inputs".
    """

    def __init__(self, node: Node, driver: str, allowed_lateness_s: float, diagnostics: Diagnostics) -> None:
        self._node = node
        self._driver = driver
        self._diagnostics = diagnostics
        self._publisher = node.create_publisher(InputNote, "~/input_notes", _QOS)
        self._latched = LatchedInputs(allowed_lateness_s, self._note_late)
        self._late: Counter[str] = Counter()
        self._report()

    def latch(self, topic: str, message: StampedMessage, apply: Callable[[], None]) -> None:
        """Take a latched input; ``apply`` makes it hold."""
        self._latched.put(topic, input_stamp_ns(message), apply)

    def drive(self, message: StampedMessage) -> None:
        """Make hold what a driving message is to be answered with."""
        stamp_ns = input_stamp_ns(message)
        if not self._latched.newest_ns:
            self._publish(self._driver, stamp_ns, 0)
        self._latched.advance(stamp_ns)

    def pair(self, topic: str, message: StampedMessage, max_age_ns: int) -> None:
        """Count a paired input that is older than the driving messages that are kept [ns]."""
        stamp_ns = input_stamp_ns(message)
        if self._latched.newest_ns - stamp_ns > max_age_ns:
            self._note_late(topic, stamp_ns, self._latched.newest_ns)

    def _note_late(self, topic: str, stamp_ns: int, after_ns: int) -> None:
        self._late[topic] += 1
        self._publish(topic, stamp_ns, after_ns)
        self._report()

    def _publish(self, topic: str, stamp_ns: int, after_ns: int) -> None:
        note = InputNote(topic=self._node.resolve_topic_name(topic), after=to_time_message(after_ns))
        note.header.stamp = to_time_message(stamp_ns)
        self._publisher.publish(note)

    def _report(self) -> None:
        late = ", ".join(f"{count} of {topic}" for topic, count in sorted(self._late.items()))
        values = {"late": self._late.total()}
        self._diagnostics.set("inputs", Health.OK, f"late: {late}" if late else "in the order of their stamps", values)


def input_stamp_ns(message: StampedMessage) -> int:
    """Return from when on an input holds [ns]; 0: it does not say. A friction model's header has that of its fit."""
    return nanoseconds(message.activated if hasattr(message, "activated") else message.header.stamp)
