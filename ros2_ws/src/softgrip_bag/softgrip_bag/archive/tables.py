# SPDX-License-Identifier: Apache-2.0
"""What happened in a bag as tables with fixed columns: the figures of `report`, one row each."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from softgrip_bag.latency import Link, links
from softgrip_bag.reader import facts
from softgrip_bag.statistics import BagStatistics, statistics
from softgrip_bag.story import RecordedGrasp, RecordedMode, Story
from softgrip_time.units import to_ns, to_s

_STAMP = pa.timestamp("ns", "UTC")
_NUMBERS = pa.map_(pa.string(), pa.float64())


def _field(name: str, kind: pa.DataType, unit: str = "", comment: str = "") -> pa.Field:
    given = {"unit": unit, "comment": comment}
    return pa.field(name, kind, metadata={key: value for key, value in given.items() if value})


_TEXT, _FLOAT, _COUNT, _FLAG = pa.string(), pa.float64(), pa.int64(), pa.bool_()
_BAG = _field("bag", _TEXT, comment="first digits of the bag's SHA-256")

#: softgrip_interfaces/FingerEvidence: what the verdict knew of one finger; NaN of the message is empty.
_EVIDENCE = pa.struct([
    _field("finger", _TEXT), _field("state", _TEXT),
    *(_field(name, _FLOAT, "N") for name in (
        "contact_tension", "contact_tension_stddev", "threshold", "peak_contact_tension", "max_force",
    )),
    _field("tip_deviation", _FLOAT, "m"),
])  # fmt: skip

SCHEMAS: Mapping[str, pa.Schema] = {
    "bags": pa.schema([
        _BAG, _field("name", _TEXT), _field("start", _STAMP), _field("duration_s", _FLOAT, "s"),
        _field("messages", _COUNT), _field("dropped", _COUNT, comment="known to be missing"),
    ]),
    "grasps": pa.schema([
        _BAG, _field("stamp", _STAMP), _field("product", _TEXT), _field("finger_set", _TEXT), _field("outcome", _TEXT),
        _field("reason", _TEXT), _field("latency_s", _FLOAT, "s", "from the deciding event to the decision"),
        _field("duration_s", _FLOAT, "s"),
        _field("decided", _STAMP, comment="stamp of the tendon/state that decided; empty when none did"),
        _field("phase", _TEXT, comment="in which it was decided"), _field("evidence", pa.list_(_EVIDENCE)),
    ]),
    "closings": pa.schema([
        _BAG, _field("profile", _TEXT), _field("finger", _TEXT), _field("frames", _COUNT),
        _field("tip_error_mean", _FLOAT, "%", "of the finger's length"),
        _field("tip_error_max", _FLOAT, "%", "of the finger's length"),
    ]),
    "friction": pa.schema([
        _BAG, _field("stamp", _STAMP), _field("id", _TEXT), _field("law", _TEXT), _field("k_reading", _TEXT),
        _field("coefficients", _NUMBERS), _field("average_error", _FLOAT, "1"), _field("maximum_error", _FLOAT, "1"),
        _field("r_squared", _FLOAT, "1"), _field("points", _COUNT), _field("verdict", _TEXT),
    ]),
    "alarms": pa.schema([
        _BAG, _field("stamp", _STAMP), _field("source", _TEXT), _field("name", _TEXT), _field("text", _TEXT),
    ]),
    "modes": pa.schema([
        _BAG, _field("stamp", _STAMP), _field("duration_s", _FLOAT, "s", "until the next mode or the bag's end"),
        _field("mode", _TEXT), _field("finger_set", _TEXT), _field("product", _TEXT), _field("reason", _TEXT),
    ]),
    "latencies": pa.schema([
        _BAG, _field("source", _TEXT), _field("result", _TEXT), _field("matched", _COUNT),
        _field("unanswered", _COUNT),
        *(_field(f"from_{of}_{p}_s", _FLOAT, "s") for of in ("publication", "stamp") for p in ("p50", "p95", "p99")),
    ]),
}  # fmt: skip


def story_tables(bag: Path, digest: str, story: Story) -> dict[str, pa.Table]:
    """Return every table of `SCHEMAS` for one bag.

    Args:
        bag: folder or .mcap file.
        digest: first column of every row.
        story: what happened in it.

    Raises:
        BagError: no bag, or no MCAP.
    """
    found = statistics(bag)
    end_ns = found.start + to_ns(found.duration)
    rows: dict[str, Iterable[Mapping[str, object]]] = {
        "bags": [_bag_row(bag, found)],
        "grasps": [_grasp_row(grasp, story.modes) for grasp in story.grasps],
        "closings": [
            {
                "profile": one.profile,
                "finger": one.finger,
                "frames": len(one.pulled),
                "tip_error_mean": float(one.error_percent.mean()) if one.error_percent.size else None,
                "tip_error_max": float(one.error_percent.max()) if one.error_percent.size else None,
            }
            for one in story.closings
        ],
        "friction": [
            {
                "stamp": fit.time,
                **{name: getattr(fit, name) for name in ("id", "law", "k_reading", "average_error", "maximum_error")},
                **{name: getattr(fit, name) for name in ("r_squared", "points", "verdict")},
                "coefficients": list(fit.coefficients.items()),
            }
            for fit in story.fits
        ],
        "alarms": [
            {"stamp": one.time, "source": one.source, "name": one.name, "text": one.text} for one in story.faults
        ],
        "modes": _mode_rows(story.modes, end_ns),
        "latencies": [_latency_row(link) for link in links(bag)],
    }
    return {
        name: pa.Table.from_pylist([{"bag": digest} | dict(row) for row in rows[name]], schema=schema)
        for name, schema in SCHEMAS.items()
    }


def _bag_row(bag: Path, found: BagStatistics) -> dict[str, object]:
    dropped = sum(int(count) for count in facts(bag).get("softgrip_dropped", {}).values())
    return {
        "name": bag.name,
        "start": found.start,
        "duration_s": found.duration,
        "messages": found.messages,
        "dropped": dropped,
    }


def _grasp_row(grasp: RecordedGrasp, modes: Sequence[RecordedMode]) -> dict[str, object]:
    mounted = [mode.finger_set for mode in modes if mode.time <= grasp.time]
    return {
        "stamp": grasp.time,
        "product": grasp.product,
        "finger_set": mounted[-1] if mounted else "",
        "outcome": grasp.outcome,
        "reason": grasp.reason,
        "latency_s": grasp.latency,
        "duration_s": grasp.duration,
        **_decision(grasp.evidence),
    }


def _decision(evidence: str) -> dict[str, object]:
    if not evidence:
        return {}
    found = json.loads(evidence)
    return {"decided": found["stamp_ns"] or None, "phase": found["phase"], "evidence": found["fingers"]}


def _mode_rows(modes: Sequence[RecordedMode], end_ns: int) -> list[dict[str, object]]:
    ends = [*[mode.time for mode in modes[1:]], end_ns][: len(modes)]
    return [
        {
            "stamp": mode.time,
            "duration_s": to_s(max(0, end - mode.time)),
            "mode": mode.mode,
            "finger_set": mode.finger_set,
            "product": mode.product,
            "reason": mode.reason,
        }
        for mode, end in zip(modes, ends, strict=True)
    ]


def _latency_row(link: Link) -> dict[str, object]:
    names = ("p50", "p95", "p99")
    return {
        "source": link.source,
        "result": link.result,
        "matched": link.matched,
        "unanswered": link.unanswered,
        **{f"from_publication_{p}_s": value for p, value in zip(names, link.from_publication, strict=True)},
        **{f"from_stamp_{p}_s": value for p, value in zip(names, link.from_stamp, strict=True)},
    }
