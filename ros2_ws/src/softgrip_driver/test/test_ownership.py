# SPDX-License-Identifier: Apache-2.0
"""One owner for each tendon: who may command it, until when, and who may take it over."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_driver.tendon.ownership import LeaseRefusal, Ownership

TENDONS = ("index", "middle", "thumb")


@pytest.fixture
def ownership() -> Ownership:
    return make()


def make() -> Ownership:
    numbers = itertools.count(1)
    return Ownership(TENDONS, 30.0, lambda: f"token{next(numbers)}")


def test_nobody_owns_at_first_and_orders_without_a_token_are_free(ownership):
    assert ownership.refusal("", TENDONS, 0.0) == ""
    assert {row.owner for row in ownership.rows()} == {""}


def test_an_owners_orders_are_obeyed_and_others_are_refused_by_name(ownership):
    lease, _ = ownership.acquire("manager", [], 1.0, 0.0)
    assert ownership.refusal(lease.token, TENDONS, 0.5) == ""
    assert "owned by manager" in ownership.refusal("", ["index"], 0.5)
    assert "another token" in ownership.refusal("guess", ["thumb"], 0.5)


def test_only_an_owners_heartbeat_is_worth_the_bus_threads_time(ownership):
    assert not ownership.is_known("")
    lease, _ = ownership.acquire("manager", ["index"], 1.0, 0.0)
    assert ownership.is_known(lease.token)
    assert not ownership.is_known("guess")
    assert not ownership.is_known("")
    ownership.release(lease.token, 0.5)
    assert not ownership.is_known(lease.token)


def test_a_lease_covers_the_tendons_it_was_granted_for(ownership):
    lease, _ = ownership.acquire("manager", ["index"], 1.0, 0.0)
    assert ownership.refusal("", ["middle"], 0.5) == ""
    assert "has ended" in ownership.refusal(lease.token, ["middle"], 0.5)


def test_heartbeats_keep_a_lease_and_silence_ends_it(ownership):
    lease, _ = ownership.acquire("manager", [], 1.0, 0.0)
    for now in (0.9, 1.8, 2.7):
        assert ownership.renew(lease.token, now) == TENDONS
    assert ownership.end_lapsed(3.7) == {}
    assert ownership.end_lapsed(3.71) == dict.fromkeys(TENDONS, "manager")
    assert "has ended" in ownership.refusal(lease.token, ["index"], 3.71)
    assert ownership.renew(lease.token, 3.8) == ()


def test_a_lapsed_lease_is_worth_nothing_before_anybody_looked(ownership):
    lease, _ = ownership.acquire("manager", [], 1.0, 0.0)
    assert ownership.refusal("", ["index"], 1.01) == ""
    assert "has ended" in ownership.refusal(lease.token, ["index"], 1.01)
    assert ownership.renew(lease.token, 1.01) == ()


def test_somebody_else_is_told_who_owns_and_may_ask_for_a_hand_over(ownership):
    lease, _ = ownership.acquire("manager", [], 1.0, 0.0)
    with pytest.raises(LeaseRefusal, match="by manager"):
        ownership.acquire("panel", [], 1.0, 0.1)
    assert {row.requested_by for row in ownership.rows()} == {""}
    with pytest.raises(LeaseRefusal, match="asked its owner"):
        ownership.acquire("panel", ["index"], 1.0, 0.1, hand_over=True)
    assert [row.requested_by for row in ownership.rows()] == ["panel", "", ""]
    assert ownership.release(lease.token, 0.2) == TENDONS
    ownership.acquire("panel", ["index"], 1.0, 0.3)
    assert [(row.owner, row.requested_by) for row in ownership.rows()] == [("panel", ""), ("", ""), ("", "")]


def test_the_same_name_is_not_the_same_owner(ownership):
    ownership.acquire("manager", [], 1.0, 0.0)
    with pytest.raises(LeaseRefusal, match="by manager"):
        ownership.acquire("manager", [], 1.0, 0.1)


def test_force_takes_over_with_a_reason_and_says_what_has_to_stop(ownership):
    old, _ = ownership.acquire("manager", [], 1.0, 0.0)
    with pytest.raises(LeaseRefusal, match="reason"):
        ownership.acquire("Ann", ["index"], 1.0, 0.1, force=True)
    new, taken = ownership.acquire("Ann", ["index"], 1.0, 0.1, force=True, reason="jam")
    assert taken == ("index",)
    assert "owned by Ann" in ownership.refusal(old.token, ["index"], 0.2)
    assert ownership.refusal(old.token, ["middle"], 0.2) == ""
    assert ownership.refusal(new.token, ["index"], 0.2) == ""
    assert ownership.renew(old.token, 0.2) == ("middle", "thumb")


@pytest.mark.parametrize("duration", [0.0, -1.0, 30.1, float("nan"), float("inf")])
def test_a_lease_without_an_end_is_refused(ownership, duration):
    with pytest.raises(LeaseRefusal, match="above 0 and up to 30 s"):
        ownership.acquire("manager", [], duration, 0.0)


def test_unknown_tendons_and_nameless_owners_are_refused(ownership):
    with pytest.raises(LeaseRefusal, match="out of"):
        ownership.acquire("manager", ["ring"], 1.0, 0.0)
    with pytest.raises(LeaseRefusal, match="owner"):
        ownership.acquire(" ", [], 1.0, 0.0)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["acquire", "force", "renew", "release", "look"]),
            st.sampled_from(["a", "b"]),
            st.sets(st.sampled_from(TENDONS), min_size=1),
            st.floats(0.0, 0.8),
        ),
        max_size=40,
    )
)
def test_whatever_happens_each_tendon_has_at_most_one_token_that_works(steps):
    ownership, tokens, now = make(), ["", "guess"], 0.0
    for kind, owner, tendons, passed in steps:
        now += passed
        try:
            if kind in {"acquire", "force"}:
                lease, _ = ownership.acquire(owner, sorted(tendons), 1.0, now, force=kind == "force", reason="x")
                tokens.append(lease.token)
            elif kind == "renew":
                ownership.renew(tokens[-1], now)
            elif kind == "release":
                ownership.release(tokens[-1], now)
            else:
                ownership.end_lapsed(now)
        except LeaseRefusal:
            continue
        for tendon in TENDONS:
            works = [token for token in tokens if not ownership.refusal(token, [tendon], now)]
            assert len(works) == 1
            assert (works == [""]) is (ownership.owner_of(tendon, now) == "")
