# SPDX-License-Identifier: Apache-2.0
"""Every number that a grasp is decided by, with unit, bounds and meaning; the node's parameters are made of these."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

#: Period of tendon/state that the former settings `contact_sigma` and `decision_run` were made for [s].
FORMER_PERIOD_S = 0.01


class SettingFacts(NamedTuple):
    """What is to be known of a setting beside its value.

    Attributes:
        text: meaning. unit: SI symbol, empty for counts and ratios. minimum, maximum: bounds, inclusive.
        former: name of the parameter that it replaces. convert: from that one's value to this one's.
    """

    text: str
    unit: str
    minimum: float
    maximum: float
    former: str = ""
    convert: Callable[[Any], Any] | None = None


def _setting(
    default: float,
    text: str,
    unit: str,
    minimum: float,
    maximum: float,
    former: str = "",
    convert: Callable[[Any], Any] | None = None,
) -> Any:
    return field(default=default, metadata={"facts": SettingFacts(text, unit, minimum, maximum, former, convert)})


def _false_alarm_s_of(sigma: float) -> float:
    """Mean time between false alarms [s] of a threshold in standard deviations."""
    return FORMER_PERIOD_S * math.exp(0.5 * sigma**2)


def _wild_share_of(run: int) -> float:
    """Share of wild readings with which so many readings are needed for a decision."""
    return math.exp(-math.log(3600.0 / FORMER_PERIOD_S) / run) if run > 1 else 1e-6


@dataclass(frozen=True)
class GraspSettings:
    """Settings of the grasp decision, the same for every product."""

    # --- the test for contact (contact.py) ---
    false_alarm_s: float = _setting(
        3600.0, "mean time between false contacts of a finger that moves freely", "s", 0.05, 1e100,
        "contact_sigma", _false_alarm_s_of,
    )  # fmt: skip
    wild_share: float = _setting(
        0.01, "share of the readings that mean nothing; bounds what a single one can prove", "", 1e-9, 0.9,
        "decision_run", _wild_share_of,
    )  # fmt: skip
    min_contact_tension_n: float = _setting(
        0.35, "smallest contact tension that is called a contact", "N", 0.05, 10.0, "contact_floor_n"
    )
    test_window_s: float = _setting(0.1, "readings older than this are left out of the test", "s", 0.01, 1.0)
    model_error_share: float = _setting(
        0.006, "error of the free tension (1 sigma), share of it: the table repairs only so far", "", 0.0, 0.2,
        "contact_free_fraction", lambda share: share / 5.0,
    )  # fmt: skip
    length_error_m: float = _setting(0.00006, "error of the pulled length between two closings, 1 sigma", "m", 0, 0.001)
    end_error_share: float = _setting(
        0.024, "as model_error_share, within end_m of the end of the checked path: the grooves close", "", 0.0, 0.2
    )
    end_m: float = _setting(0.0015, "see end_error_share", "m", 0.0, 0.01)
    drive_stiffness_n_per_m: float = _setting(
        4500.0, "tension error (1 sigma) per travel that a late goal leaves a drive behind", "N/m", 0.0, 1e5
    )
    drive_settling_s: float = _setting(0.06, "time constant with which a drive catches up", "s", 0.001, 1.0)
    contact_from_m: float = _setting(
        0.003,
        "contact is looked for from here: before, slack and the motor's start hide it",
        "m",
        0,
        0.02,
    )
    creep_slope_n_per_m: float = _setting(
        120.0, "steepest creep of the free tension; a softer contact is not found", "N/m", 0.0, 1e4
    )
    min_creep_n: float = _setting(-2.0, "tension beside the check's that a closing may begin with, least", "N", -20, 0)
    max_creep_n: float = _setting(0.3, "tension beside the check's that a closing may begin with, most", "N", 0, 20.0)
    creep_samples: int = _setting(7, "samples whose median a closing's creep begins at", "", 1, 100)
    quiet_share: float = _setting(0.6, "share of the contact threshold up to which creep is followed", "", 0.1, 1.0)
    tip_m: float = _setting(
        0.012, "distance of a seen fingertip from its predicted place that is called a contact", "m", 0.0005, 0.05
    )
    tip_unchecked_factor: float = _setting(
        2.0, "times tip_m at most, beyond the path that the check covered", "", 1.0, 10.0
    )
    tip_pair_s: float = _setting(0.05, "longest time between a frame and its prediction", "s", 0.001, 1.0)
    tip_fresh_s: float = _setting(0.1, "a frame older than this is not used", "s", 0.01, 1.0)
    min_blockage_m: float = _setting(
        0.0008, "a finger stopped so far short of its end is blocked by something", "m", 0.0003, 0.005, "witness_m"
    )
    lever_factor: float = _setting(
        2.0, "how much greater the force of a contact near the base may be than at the fingertip", "", 1.0, 10.0
    )
    lever_step_m: float = _setting(0.0005, "pulled length over which the fingertip's path is taken", "m", 1e-5, 0.01)
    lever_start: float = _setting(
        2.0, "fingertip path per pulled length before it is known; low overstates forces", "", 0.1, 20.0
    )
    # --- the state of the hand (hand.py) ---
    standing_s: float = _setting(0.06, "time over which a finger that stands is looked at", "s", 0.01, 1.0)
    standing_m: float = _setting(0.0002, "a finger that moves less within standing_s stands", "m", 1e-5, 0.01)
    gripping_m: float = _setting(0.00018, "the same for a hand that grips", "m", 1e-5, 0.01)
    rest_s: float = _setting(0.3, "time over which a hand at rest is looked at", "s", 0.05, 2.0)
    resting_m: float = _setting(0.0003, "a hand that moves less within rest_s is at rest", "m", 1e-5, 0.01)
    follow_m: float = _setting(0.001, "a lifted hand may follow its product by this within rest_s", "m", 1e-5, 0.01)
    min_peak_share: float = _setting(
        0.15, "share of the holding tension that both sides must have had for its loss to be a slip", "", 0.0, 1.0
    )
    collapse_s: float = _setting(0.1, "time in which a lost hold collapses", "s", 0.01, 1.0)
    collapse_m: float = _setting(0.0003, "and a finger goes on by this", "m", 1e-5, 0.01)
    collapse_share: float = _setting(0.5, "and both sides lose this share of the holding tension", "", 0.05, 1.0)
    slip_share: float = _setting(0.7, "share of the contact threshold below which a hold is lost", "", 0.1, 1.0)
    slip_s: float = _setting(0.04, "how long a hold has to be lost before it counts", "s", 0.01, 1.0)
    # --- what is commanded (commands.py) ---
    tension_limit_n: float = _setting(35.0, "largest tension asked of the driver", "N", 1.0, 500.0)
    force_margin: float = _setting(
        0.85, "share of the force limit at which a finger stops: the rest is what it still moves", "", 0.1, 1.0
    )
    reach_m: float = _setting(0.0003, "distance to the end of the path that counts as there", "m", 1e-5, 0.01)
    press_speed_m_per_s: float = _setting(0.03, "pulled length per second while force is missing", "m/s", 0.001, 0.5)
    fragile_pace: float = _setting(1.3, "closing speed times this, at most, presses what is fragile", "", 1.0, 10.0)
    min_tension_n: float = _setting(1.0, "fingers that touch nothing are held with this", "N", 0.0, 10.0)
    full_share: float = _setting(0.8, "share of the holding tension from which a finger presses fully", "", 0.1, 1.0)
    keep_share: float = _setting(0.9, "a finger with less than this share is pulled again", "", 0.1, 1.0)
    low_s: float = _setting(0.04, "after it has stood with less for so long", "s", 0.0, 1.0)
    keep_period_s: float = _setting(0.15, "and at most so often", "s", 0.0, 5.0)
    yield_m: float = _setting(0.001, "a product gives way when a finger pulled again goes on by this", "m", 1e-5, 0.01)
    yield_share: float = _setting(0.1, "and presses harder by less than this share", "", 0.0, 1.0)
    starting_s: float = _setting(0.1, "a drive told to pull shows no tension for so long", "s", 0.0, 1.0)
    starting_period_s: float = _setting(0.5, "which is believed once in this time", "s", 0.0, 10.0)
    # --- the sequence (sequence.py) ---
    open_m: float = _setting(0.0015, "a finger with a shorter pulled length is open", "m", 1e-4, 0.01)
    closing_start_s: float = _setting(2.0, "time that a closing may take before it moves", "s", 0.1, 60.0)
    closing_timeout_factor: float = _setting(2.0, "times path over speed that a closing may take", "", 1.0, 20.0)
    settle_s: float = _setting(0.8, "how long fingers may take to press after both sides touched", "s", 0.0, 60.0)
    giving_way_s: float = _setting(3.0, "and how much longer to come to rest", "s", 0.0, 60.0)
    lift_window_s: float = _setting(5.0, "how long a hold is watched after lifting (thesis 4.3.3: 5 s)", "s", 0.05, 60)
    lost_fraction: float = _setting(0.35, "tension below this share of the free tension: nothing is pulled", "", 0, 1.0)
    lost_floor_n: float = _setting(4.0, "free tension from which that is judged", "N", 0.1, 50.0)
    lost_s: float = _setting(0.2, "how long nothing has to be pulled: a drive has to get up to speed", "s", 0.0, 5.0)
    stale_s: float = _setting(0.25, "longest run of samples without a prediction", "s", 0.02, 5.0)
    stale_samples: int = _setting(10, "and it has so many samples at least: what waited comes in a rush", "", 1, 1000)

    def decision_level(self, period_s: float) -> float:
        """Return the log-likelihood ratio that decides: with it false alarms come once in false_alarm_s or less often.

        A likelihood ratio test repeated every period has a mean time between false alarms of at least
        exp(level) periods (Lorden 1971, Procedures for reacting to a change in distribution, theorem 2).
        """
        return math.log(max(math.e, self.false_alarm_s / period_s))

    def decision_samples(self, period_s: float) -> int:
        """Return how many readings a decision takes at least, as one proves no more than 1 / wild_share."""
        return max(1, math.ceil(self.decision_level(period_s) / math.log(1.0 / self.wild_share)))
