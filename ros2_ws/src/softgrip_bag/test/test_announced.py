# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from softgrip_bag.offers import publishers_type, type_conflict

STRING, OTHER = "std_msgs/msg/String", "other_msgs/msg/String"


def test_the_type_of_most_publishers_is_recorded() -> None:
    assert publishers_type([STRING]) == STRING
    assert publishers_type([OTHER, STRING, STRING]) == STRING
    assert publishers_type([STRING, OTHER]) == publishers_type([OTHER, STRING]) == OTHER  # the first by name


def test_another_type_is_named_with_what_is_lost() -> None:
    assert type_conflict(STRING, [STRING, STRING], [STRING]) == ""
    only_listens = type_conflict(STRING, [STRING], [OTHER, STRING])
    assert OTHER in only_listens
    assert "only subscriptions" in only_listens
    assert "1 publishers of it are not recorded" in type_conflict(STRING, [STRING, OTHER], [STRING, OTHER])
