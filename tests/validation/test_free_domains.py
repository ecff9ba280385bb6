# SPDX-License-Identifier: Apache-2.0
"""Tests that run at once, of one checkout or of several, never meet in a ROS domain."""

import os
import subprocess
import sys

import pytest

from softgrip_testing.free_domains import TEST_DOMAINS, FreeDomains, own_domain

#: numbers that no other run of this test has
DOMAINS = [10 * os.getpid() + i for i in range(1000, 1003)]
TAKES_ALL = f"""
from softgrip_testing.free_domains import FreeDomains
free = FreeDomains(domains={DOMAINS})
try:
    while True:
        print(free.take_domain(), flush=True)
except RuntimeError:
    print("end", flush=True)
input()
"""


def others_take() -> tuple[subprocess.Popen[str], list[int]]:
    """Return a process that takes all that it gets, and what it got."""
    other = subprocess.Popen(
        [sys.executable, "-c", TAKES_ALL], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert other.stdout is not None
    return other, [int(line) for line in iter(other.stdout.readline, "end\n")]


def test_a_held_domain_is_nobody_elses_until_it_is_released_or_its_process_ends() -> None:
    mine = FreeDomains(domains=DOMAINS)
    held = mine.take_domain()
    other, theirs = others_take()
    with other:
        assert {held, *theirs} == set(DOMAINS)
        assert len(theirs) == 2
        with pytest.raises(RuntimeError, match=f"{DOMAINS[0]} to {DOMAINS[-1]}"):
            FreeDomains(domains=DOMAINS).take_domain()
        other.kill()
    mine.release(held)
    other, theirs = others_take()
    with other:
        assert sorted(theirs) == DOMAINS
        other.kill()


def test_domains_come_in_turn_from_the_start() -> None:
    free = FreeDomains(start=4, domains=DOMAINS)
    turn = []
    for _ in range(4):
        turn.append(free.take_domain())
        free.release(turn[-1])
    assert turn == [DOMAINS[1], DOMAINS[2], DOMAINS[0], DOMAINS[1]]


def test_each_test_of_a_process_gets_another_domain_that_is_held() -> None:
    taken = [int(own_domain()) for _ in range(6)]
    assert len(set(taken)) == 6
    assert set(taken) <= set(TEST_DOMAINS)
    held = FreeDomains(domains=taken[-1:])
    with pytest.raises(RuntimeError, match="all held"):
        held.take_domain()
