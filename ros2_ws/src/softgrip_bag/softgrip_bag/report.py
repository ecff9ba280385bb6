# SPDX-License-Identifier: Apache-2.0
"""A bag in figures: as a dict for JSON, and as one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from softgrip_bag import latency, plots
from softgrip_bag.reader import attachments, facts
from softgrip_bag.repair import is_broken
from softgrip_bag.statistics import BagStatistics
from softgrip_bag.story import Story
from softgrip_time.units import to_s

#: Written by the recorder: topic -> messages that it knows to be missing.
_DROPPED = "softgrip_dropped"
_NOT_SHOWN = {"rosbag2", _DROPPED}


def data(bag: Path, found: BagStatistics, story: Story) -> dict[str, object]:
    """Return everything that the page shows, as JSON takes it; None where there is no number."""
    records = facts(bag)
    dropped = {topic: int(count) for topic, count in records.get(_DROPPED, {}).items()}
    return {
        "bag": str(bag),
        "start_ns": found.start,
        "duration_s": found.duration,
        "messages": found.messages,
        "dropped": sum(dropped.values()),
        "cut_off": is_broken(bag),
        "latency": _latency(bag),
        "topics": [
            {
                "name": topic.name,
                "type": topic.type_name,
                "messages": topic.messages,
                "kilobytes": round(topic.size / 1e3, 1),
                "rate_hz": number(topic.rate),
                "longest_gap_s": number(topic.longest_gap),
                "latency_ms": _milliseconds(topic.latency),
                "dropped": dropped.get(topic.name, 0),
            }
            for topic in found.topics
        ],
        "friction": [
            {
                "id": fit.id,
                "law": fit.law,
                "coefficients": {name: number(value) for name, value in fit.coefficients.items()},
                "average_error_pct": number(100.0 * fit.average_error),
                "maximum_error_pct": number(100.0 * fit.maximum_error),
                "r_squared": number(fit.r_squared),
                "points": fit.points,
                "verdict": fit.verdict,
            }
            for fit in story.fits
        ],
        "closings": [
            {
                "profile": closing.profile,
                "finger": closing.finger,
                "runs": len(np.unique(closing.run)),
                "frames": len(closing.pulled),
                "tip_error_pct_mean": number(closing.error_percent.mean()) if closing.error_percent.size else None,
                "tip_error_pct_max": number(closing.error_percent.max()) if closing.error_percent.size else None,
            }
            for closing in story.closings
        ],
        "grasps": [
            {
                "at_s": _since(found, grasp.time),
                "product": grasp.product,
                "outcome": grasp.outcome,
                "reason": grasp.reason,
                "latency_ms": number(1e3 * grasp.latency),
                "duration_s": number(grasp.duration),
            }
            for grasp in story.grasps
        ],
        "faults": [
            {"at_s": _since(found, fault.time), "source": fault.source, "name": fault.name, "text": fault.text}
            for fault in story.faults
        ],
        "facts": {name: values for name, values in records.items() if name not in _NOT_SHOWN},
        "carried": [attachment.name for attachment in attachments(bag)],
    }


def render(bag: Path, found: BagStatistics, story: Story) -> str:
    """Return the page."""
    environment = Environment(
        loader=PackageLoader("softgrip_bag"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("report.html.j2").render(
        title=f"Bag {bag.name}",
        started=datetime.fromtimestamp(to_s(found.start), UTC).isoformat(timespec="seconds"),
        data=data(bag, found, story),
        timeline=plots.timeline_figure(found, story),
        fits=[plots.fit_figure(fit, story.samples) for fit in story.fits if _measured(fit.time, story)],
        closings=[plots.closing_figure(closing) for closing in story.closings],
    )


def number(value: float, digits: int = 4) -> float | None:
    """Return a figure rounded to significant digits, None where there is none."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _latency(bag: Path) -> list[dict[str, object]]:
    found = latency.links(bag)
    stamps = latency.read_stamps(bag, {link.source for link in found})
    return [
        {
            "source": link.source,
            "result": link.result,
            "matched": link.matched,
            "unanswered": link.unanswered,
            "missing_sources": latency.missing(stamps[link.source]),
            "from_publication_ms": _milliseconds(link.from_publication),
            "from_stamp_ms": _milliseconds(link.from_stamp),
        }
        for link in found
    ]


def _milliseconds(values: Sequence[float]) -> list[float | None]:
    return [number(1e3 * value) for value in values]


def _since(found: BagStatistics, time: int) -> float:
    return round(to_s(time - found.start), 3)


def _measured(time: int, story: Story) -> bool:
    return any(sample.accepted and sample.time <= time for sample in story.samples)
