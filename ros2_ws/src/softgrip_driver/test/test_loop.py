# SPDX-License-Identifier: Apache-2.0
"""What a loop tells those who watch it."""

import pytest

from softgrip_driver.tendon.loop import BusLoop, LoopSnapshot


@pytest.mark.parametrize(("seen", "new"), [(0, [3, 4, 5]), (3, [4, 5]), (4, [5]), (5, []), (9, [])])
def test_each_cycle_is_told_once_oldest_first_as_far_as_it_is_kept(seen, new):
    loop = BusLoop(None, None, 100.0, history=3)
    for sequence in range(1, 6):
        loop._publish(LoopSnapshot(sequence, 0.01 * sequence, (), False, 100.0, 0.0, 0, ""))
    assert [one.sequence for one in loop.since(seen, 0.0)] == new
