# SPDX-License-Identifier: Apache-2.0
"""Quality of service: policies, profiles, presets, and whether two profiles would meet on DDS."""

from __future__ import annotations

import functools
import operator
import warnings
from enum import Enum, IntEnum
from typing import Any, Self

from rclpy.duration import Duration, Infinite

from embedded_ros import wire
from embedded_ros.graph import incompatible_policy

QOS_DURATION_INFINITE = Infinite
QOS_DURATION_UNSPECIFIED = Duration()


class QoSPolicyKind(IntEnum):
    """Policies as events name them; the numbers are rmw's."""

    INVALID = 1
    DURABILITY = 2
    DEADLINE = 4
    LIVELINESS = 8
    RELIABILITY = 16
    HISTORY = 32
    LIFESPAN = 64
    DEPTH = 128
    LIVELINESS_LEASE_DURATION = 256
    AVOID_ROS_NAMESPACE_CONVENTIONS = 512


class InvalidQoSProfileException(Exception):  # noqa: N818  rclpy's name
    """A profile contradicts itself."""

    def __init__(self, *args: object) -> None:
        super().__init__("Invalid QoSProfile", *args)


class QoSPolicyEnum(IntEnum):
    """Base of the policies' values."""

    @classmethod
    def short_keys(cls) -> list[str]:
        """Return the words that tools use."""
        return [key.lower() for key in cls.__members__ if not key.startswith("RMW")]

    @classmethod
    def get_from_short_key(cls, name: str) -> int:
        """Return the value of a word."""
        return cls[name.upper()].value

    @property
    def short_key(self) -> str:
        """The word that tools use."""
        for key, value in type(self).__members__.items():
            if not key.startswith("RMW") and self.value == value:
                return key.lower()
        raise AttributeError(f"failed to find value {self.value} in {type(self).__name__}")


class HistoryPolicy(QoSPolicyEnum):
    """How many samples are kept."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class ReliabilityPolicy(QoSPolicyEnum):
    """Whether lost samples are sent again."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class DurabilityPolicy(QoSPolicyEnum):
    """Whether late subscriptions get what was sent before."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class LivelinessPolicy(QoSPolicyEnum):
    """How a publisher says that it is alive."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4
    BEST_AVAILABLE = 5


QoSHistoryPolicy = HistoryPolicy
QoSReliabilityPolicy = ReliabilityPolicy
QoSDurabilityPolicy = DurabilityPolicy
QoSLivelinessPolicy = LivelinessPolicy

_DEFAULTS: dict[str, Any] = {
    "history": HistoryPolicy.KEEP_LAST,
    "depth": 10,
    "reliability": ReliabilityPolicy.RELIABLE,
    "durability": DurabilityPolicy.VOLATILE,
    "lifespan": Duration(),
    "deadline": Duration(),
    "liveliness": LivelinessPolicy.SYSTEM_DEFAULT,
    "liveliness_lease_duration": Duration(),
    "avoid_ros_namespace_conventions": False,
}
_TYPES: dict[str, type] = {
    "history": HistoryPolicy,
    "depth": int,
    "reliability": ReliabilityPolicy,
    "durability": DurabilityPolicy,
    "lifespan": Duration,
    "deadline": Duration,
    "liveliness": LivelinessPolicy,
    "liveliness_lease_duration": Duration,
    "avoid_ros_namespace_conventions": bool,
}


class QoSProfile:
    """A set of policies. Either ``history`` or ``depth`` must be given, and ``depth`` with KEEP_LAST."""

    __slots__ = tuple("_" + name for name in _DEFAULTS)

    def __init__(self, **kwargs: Any) -> None:
        unknown = set(kwargs) - set(_DEFAULTS)
        if unknown:
            raise AssertionError(f"Invalid arguments passed to constructor: {', '.join(sorted(unknown))}")
        if "history" not in kwargs:
            if "depth" not in kwargs:
                raise InvalidQoSProfileException("History and/or depth settings are required.")
            kwargs["history"] = HistoryPolicy.KEEP_LAST
        if kwargs["history"] == HistoryPolicy.KEEP_LAST and "depth" not in kwargs:
            raise InvalidQoSProfileException("History set to KEEP_LAST without a depth setting.")
        for name, default in _DEFAULTS.items():
            setattr(self, name, kwargs.get(name, 0 if name == "depth" else default))

    history: HistoryPolicy
    depth: int
    reliability: ReliabilityPolicy
    durability: DurabilityPolicy
    lifespan: Duration
    deadline: Duration
    liveliness: LivelinessPolicy
    liveliness_lease_duration: Duration
    avoid_ros_namespace_conventions: bool

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, QoSProfile):
            return False
        return all(getattr(self, name) == getattr(other, name) for name in _DEFAULTS)

    def __hash__(self) -> int:
        return hash(tuple(getattr(self, name) for name in _DEFAULTS))

    def __str__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={getattr(self, name)}' for name in _DEFAULTS)})"

    __repr__ = __str__

    def _copy(self) -> Self:
        twin = object.__new__(type(self))
        for name in _DEFAULTS:
            setattr(twin, "_" + name, getattr(self, name))
        return twin

    def _to_wire(self) -> wire.WireQos:
        """Return what is announced, with the system defaults settled as rmw_zenoh does."""

        def duration(value: Duration) -> int:
            return value.nanoseconds or wire.INFINITE_NS

        return wire.WireQos(
            int(self.reliability) % 4 or 1,
            int(self.durability) % 4 or 2,
            int(self.history) or 1,
            self.depth or wire.DEFAULT_QOS.depth,
            duration(self.deadline),
            duration(self.lifespan),
            1
            if self.liveliness in {LivelinessPolicy.SYSTEM_DEFAULT, LivelinessPolicy.BEST_AVAILABLE}
            else int(self.liveliness),
            duration(self.liveliness_lease_duration),
        )

    @classmethod
    def _from_wire(cls, qos: wire.WireQos) -> QoSProfile:
        return _announced(qos)._copy()


@functools.lru_cache
def _announced(qos: wire.WireQos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy(qos.history),
        depth=qos.depth,
        reliability=ReliabilityPolicy(qos.reliability),
        durability=DurabilityPolicy(qos.durability),
        lifespan=Duration(nanoseconds=qos.lifespan_ns),
        deadline=Duration(nanoseconds=qos.deadline_ns),
        liveliness=LivelinessPolicy(qos.liveliness),
        liveliness_lease_duration=Duration(nanoseconds=qos.lease_ns),
    )


def _make_property(name: str) -> property:
    kind = _TYPES[name]

    def put(self: QoSProfile, value: Any) -> None:
        if issubclass(kind, QoSPolicyEnum):
            if not isinstance(value, kind | int):
                raise AssertionError(f"{name}: expected a {kind.__name__}, found {value!r}")
            value = kind(value)
        if not isinstance(value, kind) or (name == "depth" and isinstance(value, bool)):
            raise AssertionError(f"{name}: expected {kind.__name__}, found {value!r}")
        if isinstance(value, int) and name == "depth" and value < 0:
            raise ValueError(f"depth: expected 0 or more, found {value}")
        if name == "depth" and value == 0 and self.history == HistoryPolicy.KEEP_LAST:
            warnings.warn(
                "A zero depth with KEEP_LAST doesn't make sense; no data could be stored. This will be interpreted as "
                "SYSTEM_DEFAULT",
                stacklevel=3,
            )
        setattr(self, "_" + name, value)

    return property(operator.attrgetter("_" + name), put, doc=f"The {name.replace('_', ' ')}.")


for _name in _DEFAULTS:
    setattr(QoSProfile, _name, _make_property(_name))

qos_profile_unknown = QoSProfile(history=HistoryPolicy.UNKNOWN, reliability=ReliabilityPolicy.UNKNOWN,
                                 durability=DurabilityPolicy.UNKNOWN, liveliness=LivelinessPolicy.UNKNOWN)  # fmt: skip
qos_profile_default = QoSProfile(depth=10)
qos_profile_system_default = QoSProfile(history=HistoryPolicy.SYSTEM_DEFAULT, depth=0,
                                        reliability=ReliabilityPolicy.SYSTEM_DEFAULT,
                                        durability=DurabilityPolicy.SYSTEM_DEFAULT)  # fmt: skip
qos_profile_sensor_data = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
qos_profile_services_default = QoSProfile(depth=10)
qos_profile_parameters = QoSProfile(depth=1000)
qos_profile_parameter_events = QoSProfile(depth=1000)
qos_profile_action_status_default = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
qos_profile_rosout_default = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL,
                                        lifespan=Duration(seconds=10))  # fmt: skip
qos_profile_best_available = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_AVAILABLE,
                                        durability=DurabilityPolicy.BEST_AVAILABLE,
                                        liveliness=LivelinessPolicy.BEST_AVAILABLE)  # fmt: skip


class QoSPresetProfiles(Enum):
    """The presets."""

    UNKNOWN = qos_profile_unknown
    DEFAULT = qos_profile_default
    SYSTEM_DEFAULT = qos_profile_system_default
    SENSOR_DATA = qos_profile_sensor_data
    SERVICES_DEFAULT = qos_profile_services_default
    PARAMETERS = qos_profile_parameters
    PARAMETER_EVENTS = qos_profile_parameter_events
    ACTION_STATUS_DEFAULT = qos_profile_action_status_default
    BEST_AVAILABLE = qos_profile_best_available

    @classmethod
    def short_keys(cls) -> list[str]:
        """Return the words that tools use."""
        return [key.lower() for key in cls.__members__ if not key.startswith("RMW")]

    @classmethod
    def get_from_short_key(cls, name: str) -> QoSProfile:
        """Return the profile of a word."""
        return cls[name.upper()].value


class QoSCompatibility(IntEnum):
    """Whether two profiles meet."""

    OK = 0
    WARNING = 1
    ERROR = 2


def qos_check_compatible(publisher_qos: QoSProfile, subscription_qos: QoSProfile) -> tuple[QoSCompatibility, str]:
    """Return whether a publisher and a subscription would meet on DDS, and why not."""
    policy = incompatible_policy(publisher_qos._to_wire(), subscription_qos._to_wire())
    if policy is not None:
        return QoSCompatibility.ERROR, f"ERROR: offered and requested {policy} do not match"
    for name, offered_weak, requested_strong in (
        ("reliability", ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE),
        ("durability", DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
        ("liveliness", LivelinessPolicy.AUTOMATIC, LivelinessPolicy.MANUAL_BY_TOPIC),
    ):
        offered, requested = getattr(publisher_qos, name), getattr(subscription_qos, name)
        open_offer, open_request = offered.name in _UNSETTLED, requested.name in _UNSETTLED
        if (open_offer and requested == requested_strong) or (open_request and offered == offered_weak):
            return QoSCompatibility.WARNING, f"WARNING: {name}: {offered.name} offered, {requested.name} requested"
    return QoSCompatibility.OK, ""


_UNSETTLED = {"SYSTEM_DEFAULT", "UNKNOWN"}
