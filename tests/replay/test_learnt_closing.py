# SPDX-License-Identifier: Apache-2.0
"""What a recorded closing teaches the predictor, at the next recorded closing: as the nodes use it, without them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from softgrip_model.finger.matching import SPAN_NS, TendonInput
from softgrip_model.finger.session import MeasuredFinger, Session
from softgrip_model.finger.wear import WearSettings
from softgrip_model.profile import load_directory, shipped_directory

pytest.importorskip("mcap_ros2")
from mcap_ros2.decoder import DecoderFactory

BAG = Path(__file__).resolve().parent / "bags" / "closings"
TENDONS, MEASURED = "/tendon/state", "/finger/measured"


def messages() -> list[tuple[int, str, Any]]:
    """Stamp [ns], topic and message of tendons and camera, by a reader that is not ours."""
    with next(BAG.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages(topics=[TENDONS, MEASURED])]
    return [(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec, topic, m) for topic, m in found]


def test_a_predicted_tip_goes_on_after_a_groove_has_closed() -> None:
    """The pinch set's first groove closes by 17 mm; its tip then goes on by the other joints, measured and predicted.

    The first recorded closing of the set is learnt, cable's stretch and all; the second goes to 20 mm. It began before
    what the first taught counts, so all that comes after the first is put off.
    """
    session = Session(load_directory(shipped_directory()), {"index": "pinch"}, WearSettings())
    closings, put_off_ns = 0, 0
    pulled: list[float] = []
    predicted: list[tuple[float, float]] = []
    seen: list[tuple[float, float]] = []
    for recorded, topic, message in sorted(messages(), key=lambda each: each[0]):
        stamp = recorded + put_off_ns
        if topic == TENDONS:
            i = list(message.name).index("index")
            tendon = TendonInput(stamp, message.position[i], message.velocity[i], message.effort[i])
            session.on_tendons([tendon], ["index"])
            continue
        (finger,) = [one for one in message.fingers if one.finger == "index"]
        if finger.profile != "pinch":
            continue
        session.on_measured(stamp, [MeasuredFinger("index", (), (finger.tip.x, finger.tip.y), finger.profile)])
        closings += len(session.take_learnt())
        put_off_ns = SPAN_NS if closings else 0
        if closings == 1 and tendon.velocity > 0.0:
            (found,) = session.predict([tendon], ["index"])
            pulled.append(1e3 * tendon.pulled_length_m)
            predicted.append(found.tip_mm)
            seen.append((1e3 * finger.tip.x, 1e3 * finger.tip.y))
    closed = np.array(pulled) > 17.0
    assert closed.sum() > 5
    ahead, true = np.array(predicted)[closed], np.array(seen)[closed]
    assert ahead[0, 0] - ahead[-1, 0] > 0.5 * (true[0, 0] - true[-1, 0]) > 5.0
    assert np.linalg.norm(ahead - true, axis=1).max() < 6.0
