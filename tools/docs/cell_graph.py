# SPDX-License-Identifier: Apache-2.0
"""Draws what the shipped access policy says: who tells whom what (cell_graph.svg), and who asks whom (cell_calls.svg).

Each figure carries its edges in its description, which tests/documents/test_cell_graph.py compares with the policy.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from softgrip_security.policy import Grant, PolicyIdentity, read_policy

ROOT = Path(__file__).resolve().parents[2]
TOPICS, CALLS = ROOT / "docs/figures/cell_graph.svg", ROOT / "docs/figures/cell_calls.svg"
Edges = dict[tuple[str, str], list[str]]
#: Node -> where it is drawn among topics.
PLACES = {
    "friction_rig": (0.0, 3.2),
    "tendon_driver": (0.0, 1.6),
    "camera": (0.0, 0.0),
    "marker_tracker": (1.85, 0.0),
    "kinematics_predictor": (2.7, 2.1),
    "gdfe_simulator": (2.0, 3.2),
    "hand_description": (4.2, 3.0),
    "grasp_mix_manager": (4.2, 0.6),
    "gripper_command": (1.0, 0.7),
}
#: Where along an edge its topics stand, where the middle is taken.
SHARES = {
    ("friction_rig", "grasp_mix_manager"): 0.45,
    ("friction_rig", "kinematics_predictor"): 0.3,
    ("tendon_driver", "gdfe_simulator"): 0.7,
    ("tendon_driver", "hand_description"): 0.72,
    ("tendon_driver", "grasp_mix_manager"): 0.72,
    ("tendon_driver", "kinematics_predictor"): 0.45,
    ("marker_tracker", "hand_description"): 0.25,
    ("marker_tracker", "kinematics_predictor"): 0.78,
}
#: What nearly everybody hears would hide the rest; the caption names it.
LEFT_OUT = {"cell/state", "safety/state", "tendon/owners", "tendon/heartbeat", "camera/image_raw"}
OF_EVERY_NODE = {"/rosout", "/parameter_events", "/diagnostics", "/clock"}
#: Who serves, with what it serves written below its name -> where: [in] from the lower left.
SERVERS = {
    "grasp_mix_manager": (4.4, 3.9),
    "gripper_command": (5.4, 1.5),
    "friction_rig": (9.6, 5.7),
    "tendon_driver": (9.6, 3.6),
    "recorder": (9.6, 1.9),
    "kinematics_predictor": (9.6, 0.9),
    "camera": (9.6, 0.15),
}
CALLERS = {"panel": (1.0, 5.6), "cell_controller": (1.0, 2.6), "teleoperate": (1.0, 0.2)}
#: Calls that go around a box.
BOWS = {("panel", "tendon_driver"): -0.32, ("cell_controller", "friction_rig"): -0.42, ("panel", "recorder"): -0.25}
CALLER_COLOURS = {
    "panel": "#1f5fa8",
    "cell_controller": "#b3541e",
    "teleoperate": "#6a3d9a",
    "grasp_mix_manager": "#2e7d32",
    "gripper_command": "#555555",
}
COLOURS = {"tendon_driver": "#f3d9c9", "friction_rig": "#f3d9c9", "camera": "#f3d9c9", "grasp_mix_manager": "#d6e6d2"}
NODE_COLOUR, CALLER_COLOUR = "#d9e4f0", "#eeeeee"


def identities() -> Mapping[str, PolicyIdentity]:
    """Return the policy's identities by name."""
    return {one.name: one for one in read_policy().identities}


def topic_edges() -> Edges:
    """Return (publisher, subscriber) -> topics between them."""
    policy = {name: one for name, one in identities().items() if name in PLACES}
    found: Edges = {}
    for giver, one in policy.items():
        for topic in one.names(Grant.PUBLISH):
            takers = [other for other in policy if topic in policy[other].names(Grant.SUBSCRIBE) and other != giver]
            if topic.strip("/") not in LEFT_OUT and topic not in OF_EVERY_NODE:
                for taker in takers:
                    found.setdefault((giver, taker), []).append(topic.strip("/"))
    return found


def served(name: str) -> list[str]:
    """Return the actions and services of a node, without those that every node has."""
    one = identities()[name]
    everywhere = {
        service.rpartition("/")[2]
        for service in identities()["tendon_driver"].names(Grant.SERVE)
        if service.startswith("/tendon_driver/")  # a lifecycle node: it has them all
    }
    services = [
        service.strip("/") for service in one.names(Grant.SERVE) if service.rpartition("/")[2] not in everywhere
    ]
    return [f"{action.strip('/')} (action)" for action in one.names(Grant.SERVE_ACTION)] + services


def call_edges() -> Edges:
    """Return (caller, server) -> services and actions that it calls there."""
    policy, found = identities(), Edges()
    for caller in (*CALLERS, *SERVERS):
        called = {*policy[caller].names(Grant.CALL), *policy[caller].names(Grant.CALL_ACTION)}
        for server in SERVERS:
            names = [name for name in served(server) if f"/{name.removesuffix(' (action)')}" in called]
            if names and caller != server:
                found[caller, server] = names
    return found


def described(edges: Edges) -> str:
    """Return edges as text."""
    return "; ".join(f"{giver} > {taker}: {', '.join(names)}" for (giver, taker), names in sorted(edges.items()))


def draw_topics() -> None:
    """Draw and write who tells whom what."""
    figure, axes = plt.subplots(figsize=(11.0, 5.2), layout="constrained")
    boxes = {name: _box(axes, place, name, COLOURS.get(name, NODE_COLOUR)) for name, place in PLACES.items()}
    for (giver, taker), topics in sorted(topic_edges().items()):
        start, end = PLACES[giver], PLACES[taker]
        arrow = {"arrowstyle": "-|>", "color": "0.45", "patchA": boxes[giver], "patchB": boxes[taker]}
        axes.annotate("", end, start, arrowprops=arrow | {"shrinkA": 2, "shrinkB": 2}, zorder=1)
        share = SHARES.get((giver, taker), 0.5)
        x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
        label = {"fontsize": 8, "ha": "center", "va": "center", "color": "0.25"}
        axes.text(x, y, "\n".join(topics), **label, bbox={"fc": "white", "ec": "none", "pad": 0.8}, zorder=2)
    axes.set(xlim=(-0.5, 4.8), ylim=(-0.3, 3.5))
    _save(figure, axes, TOPICS, topic_edges())


def draw_calls() -> None:
    """Draw and write who asks whom."""
    figure, axes = plt.subplots(figsize=(11.0, 7.1), layout="constrained")
    boxes = {name: _box(axes, place, name, CALLER_COLOUR) for name, place in CALLERS.items()}
    for name, place in SERVERS.items():
        text = "\n".join([rf"$\bf{{{name.replace('_', chr(92) + '_')}}}$", *served(name)])
        boxes[name] = _box(axes, place, text, COLOURS.get(name, NODE_COLOUR), size=8)
    places = CALLERS | SERVERS
    for caller, server in sorted(call_edges()):
        arrow = {"arrowstyle": "-|>", "color": CALLER_COLOURS[caller], "patchA": boxes[caller], "patchB": boxes[server]}
        arrow |= {"shrinkA": 2, "shrinkB": 2, "connectionstyle": f"arc3,rad={BOWS.get((caller, server), 0.0)}"}
        axes.annotate("", places[server], places[caller], arrowprops=arrow, zorder=1)
    axes.set(xlim=(0.0, 11.0), ylim=(-0.2, 6.9))
    _save(figure, axes, CALLS, call_edges())


def _box(axes: Any, place: tuple[float, float], text: str, colour: str, size: int = 10) -> Any:
    style = {"boxstyle": "round,pad=0.5", "fc": colour, "ec": "0.35"}
    return axes.text(*place, text, fontsize=size, ha="center", va="center", bbox=style, zorder=3).get_bbox_patch()


def _save(figure: Any, axes: Any, path: Path, edges: Edges) -> None:
    axes.axis("off")
    figure.savefig(path, metadata={"Date": None, "Description": described(edges)})
    plt.close(figure)
    print(path.relative_to(ROOT))


def main() -> int:
    """Write the figures."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    plt.rcParams["svg.hashsalt"] = "softgrip"  # the same file each time
    draw_topics()
    draw_calls()
    return 0


if __name__ == "__main__":
    sys.exit(main())
