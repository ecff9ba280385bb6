# SPDX-License-Identifier: Apache-2.0
"""The drawn graphs of docs/architecture.md are those of the access policy: nodes, topics, services and actions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from softgrip_security.policy import read_policy
from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
DESCRIPTION = "{http://purl.org/dc/elements/1.1/}description"

graph = load_script(ROOT / "tools/docs/cell_graph.py")


@pytest.mark.parametrize(
    ("figure", "edges"), [(graph.TOPICS, graph.topic_edges), (graph.CALLS, graph.call_edges)], ids=["topics", "calls"]
)
def test_a_drawn_graph_has_the_edges_of_the_policy(
    figure: Path, edges: Callable[[], dict[tuple[str, str], list[str]]]
) -> None:
    (drawn,) = ET.parse(figure).getroot().iter(DESCRIPTION)
    assert drawn.text == graph.described(edges()), "python tools/docs/cell_graph.py"


def test_every_node_of_a_cell_is_drawn() -> None:
    nodes = {one.name for one in read_policy().identities if not one.is_tool}
    # what stands outside a real cell, or calls what cell_controller calls
    elsewhere = {"emulated_cell", "shift", "first_run", "thermometer"}
    assert nodes - {*graph.PLACES, *graph.SERVERS, *graph.CALLERS} == elsewhere


def test_a_topic_stands_between_who_gives_and_who_takes_it() -> None:
    edges = graph.topic_edges()
    assert "finger/predicted" in edges["kinematics_predictor", "grasp_mix_manager"]
    assert ("grasp_mix_manager", "kinematics_predictor") not in edges  # cell/state is left out
    assert "tendon/move (action)" in graph.call_edges()["grasp_mix_manager", "tendon_driver"]
