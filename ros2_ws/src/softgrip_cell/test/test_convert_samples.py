# SPDX-License-Identifier: Apache-2.0
"""Between messages and values: tendon samples, verdicts, phases."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from sensor_msgs.msg import JointState

from softgrip_cell.grasp.contact import ContactState
from softgrip_cell.grasp.sequence import GraspStep
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import FingerEvidence, GraspEvidence, GraspOutcome, GraspPhase, GraspVerdict
from softgrip_cell.nodes.convert import grasp_evidence, grasp_feedback, grasp_result, tendon_sample
from softgrip_cell.nodes.parameters import PARAMETERS
from softgrip_interfaces.action import Grasp
from softgrip_interfaces.msg import GraspEvidence as GraspEvidenceMessage

SLOTS = ("index", "middle", "thumb")


def message(**columns: list[object]) -> JointState:
    made = JointState()
    made.header.stamp.sec, made.header.stamp.nanosec = 3, 7
    made.name = columns.get("name", ["thumb", "index", "middle"])
    made.position = columns.get("position", [0.003, 0.001, 0.002])
    made.effort = columns.get("effort", [3.0, 1.0, 2.0])
    return made


def test_columns_are_put_into_slot_order() -> None:
    sample = tendon_sample(message(), SLOTS)
    assert sample is not None
    assert sample.stamp_ns == 3_000_000_007
    assert (sample.pulled_length_m, sample.tension_n) == ((0.001, 0.002, 0.003), (1.0, 2.0, 3.0))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", ["position", "effort"])
@pytest.mark.parametrize("place", range(3))
def test_a_number_that_is_none_makes_no_sample(column: str, place: int, value: float) -> None:
    """A comparison with NaN is false: a touch would never be felt, a broken tendon never be seen."""
    values = [0.001, 0.002, 0.003]
    values[place] = value
    assert tendon_sample(message(**{column: values}), SLOTS) is None


@pytest.mark.parametrize(
    "columns",
    [
        {"name": ["thumb", "index"]},
        {"name": ["thumb", "index", "toe"]},
        {"name": ["thumb", "index", "index"]},
        {"position": [0.001, 0.002]},
        {"effort": []},
    ],
    ids=["a name short", "another name", "a name twice", "a length short", "no tensions"],
)
def test_a_message_that_does_not_fit_makes_no_sample(columns: dict[str, list[object]]) -> None:
    assert tendon_sample(message(**columns), SLOTS) is None


def test_a_verdict_carries_its_numbers() -> None:
    found = FingerEvidence("index", ContactState.BLOCKED, 2.0, 0.35, 0.07, 2.5, 1.5, None)
    seen = replace(found, finger="middle", tip_deviation_m=0.02)
    evidence = GraspEvidence(GraspPhase.HOLD, 5_000_000_001, (found, seen))
    result = grasp_result(GraspVerdict(GraspOutcome.SLIPPED, "lost", 0.03, evidence), None, 4.0)
    decision = result.decision
    assert (decision.stamp.sec, decision.stamp.nanosec, decision.phase) == (5, 1, decision.HOLD)
    first, second = decision.fingers
    assert (first.finger, first.state, first.contact_tension, first.threshold) == ("index", first.BLOCKED, 2.0, 0.35)
    assert (first.contact_tension_stddev, first.peak_contact_tension, first.max_force) == (0.07, 2.5, 1.5)
    assert math.isnan(first.tip_deviation)
    assert second.tip_deviation == 0.02


def test_a_refusal_carries_no_numbers() -> None:
    result = grasp_result(GraspVerdict(GraspOutcome.ABORTED, "refused", 0.0), None, 0.0)
    assert (result.decision.phase, list(result.decision.fingers)) == (result.decision.UNSET, [])


@pytest.mark.parametrize("phase", GraspPhase)
def test_a_phase_has_one_number_in_feedback_and_evidence(phase: GraspPhase) -> None:
    number = grasp_feedback(GraspStep(phase, ()), None).phase
    assert number == getattr(Grasp.Feedback, phase.name, 0) == getattr(GraspEvidenceMessage, phase.name, 0)
    assert grasp_evidence(GraspEvidence(phase)).phase == number
    assert (number == Grasp.Feedback.PHASE_UNSET) == (phase is GraspPhase.DONE)


@pytest.mark.parametrize(
    ("former", "value", "name", "expected"),
    [
        ("contact_sigma", 5.0, "false_alarm_s", 0.01 * math.exp(12.5)),
        ("decision_run", 3, "wild_share", 360_000 ** (-1 / 3)),
        ("contact_free_fraction", 0.03, "model_error_share", 0.006),
    ],
)
def test_former_settings_are_read_as_what_they_meant(former: str, value: float, name: str, expected: float) -> None:
    row = next(row for row in PARAMETERS.rows if row.former == former)
    assert row.name == name
    assert row.convert is not None
    assert row.convert(value) == pytest.approx(expected)
    assert row.problem(row.convert(value)) is None


def test_so_many_samples_as_a_former_run_decide() -> None:
    row = next(row for row in PARAMETERS.rows if row.former == "decision_run")
    assert row.convert is not None
    for run in (1, 2, 3, 5):
        assert replace(GraspSettings(), wild_share=row.convert(run)).decision_samples(0.01) == run
