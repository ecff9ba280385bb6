# SPDX-License-Identifier: Apache-2.0
"""When a finger that is not measured is said to be lost."""

from __future__ import annotations

from softgrip_vision.loss_watch import LossWatch


def test_markers_hidden_for_a_moment_are_no_loss_and_for_longer_they_are() -> None:
    watch = LossWatch(5.0)
    assert not watch.is_lasting("index", 100.0, is_measured=True)
    assert not watch.is_lasting("index", 104.9, is_measured=False)
    assert not watch.is_lasting("index", 105.0, is_measured=True)
    assert not watch.is_lasting("index", 109.9, is_measured=False)  # 4.9 s since it was measured
    assert watch.is_lasting("index", 110.1, is_measured=False)
    assert not watch.is_lasting("index", 110.2, is_measured=True)


def test_a_finger_that_was_never_measured_is_lost_as_well_and_each_has_its_own_time() -> None:
    watch = LossWatch(5.0)
    assert not watch.is_lasting("index", 100.0, is_measured=False)
    assert not watch.is_lasting("thumb", 104.0, is_measured=False)
    assert watch.is_lasting("index", 105.1, is_measured=False)
    assert not watch.is_lasting("thumb", 105.1, is_measured=False)


def test_a_bag_that_begins_again_begins_at_nothing() -> None:
    watch = LossWatch(5.0)
    watch.is_lasting("index", 100.0, is_measured=True)
    assert not watch.is_lasting("index", 3.0, is_measured=False)
    assert watch.is_lasting("index", 8.1, is_measured=False)
