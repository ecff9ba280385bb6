# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import pytest
from builtin_interfaces.msg import Time

from softgrip_demo.nodes.convert import outcome_latency
from softgrip_interfaces.action import Grasp
from softgrip_interfaces.msg import GraspEvidence


def test_the_latency_of_an_outcome_goes_from_its_event_to_the_client() -> None:
    """Decided 20 ms after the event, on the sample of 5.000 s; at the client at 5.007 s."""
    result = Grasp.Result(latency=0.02, decision=GraspEvidence(stamp=Time(sec=5)))
    assert outcome_latency(result, 5_007_000_000) == pytest.approx(0.027)


def test_a_client_whose_clock_is_behind_the_sample_adds_nothing() -> None:
    """Decided 20 ms after the event, on the sample of 5.000 s, while /clock still says 4.971 s."""
    result = Grasp.Result(latency=0.02, decision=GraspEvidence(stamp=Time(sec=5)))
    assert outcome_latency(result, 4_971_000_000) == pytest.approx(0.02)


def test_what_was_refused_has_no_latency() -> None:
    assert math.isnan(outcome_latency(Grasp.Result(), 5_000_000_000))
