# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from softgrip_bag.snapshot import FaultWatch


def test_a_fault_is_due_once_after_its_aftermath() -> None:
    watch = FaultWatch(after=2.0, pause=30.0)
    watch.observe_faults({"index": ""}, 0.0)
    assert watch.due(10.0) == ""
    watch.observe_faults({"index": "tendon_broken"}, 10.0)
    assert watch.due(11.9) == ""
    assert watch.due(12.0) == "index: tendon_broken"
    assert watch.due(12.1) == ""


def test_what_stays_wrong_counts_once_and_again_when_it_was_right_between() -> None:
    watch = FaultWatch(after=0.0, pause=5.0)
    for now in (0.0, 1.0, 20.0):
        watch.observe_faults({"index": "tendon_broken"}, now)
    assert watch.due(0.0) != ""
    watch.observe_faults({"index": "tendon_broken"}, 21.0)
    assert watch.due(22.0) == ""
    watch.observe_faults({"index": ""}, 23.0)
    watch.observe_faults({"index": "tendon_slack"}, 24.0)
    assert watch.due(24.0) == "index: tendon_slack"


def test_faults_in_a_row_are_one_event() -> None:
    watch = FaultWatch(after=1.0, pause=30.0)
    watch.observe_faults({"index": "a", "thumb": ""}, 0.0)
    watch.observe_faults({"thumb": "b"}, 0.5)
    assert watch.due(1.0) == "index: a"
    watch.observe_faults({"middle": "c"}, 2.0)
    assert watch.due(40.0) == ""
