# SPDX-License-Identifier: Apache-2.0
"""What counts as silence, and which prediction belongs to which sample."""

from __future__ import annotations

from softgrip_cell.observation import FreeMotion, Pairing, StreamSilence, TendonSample


def sample(stamp_ns: int) -> TendonSample:
    return TendonSample(stamp_ns, (0.0,) * 3, (0.0,) * 3)


def motion(stamp_ns: int) -> FreeMotion:
    return FreeMotion(stamp_ns, (0.0,) * 3, (0.0,) * 3, ((0.0, 0.0),) * 3, "model")


def test_silence_is_counted_in_looks_and_ends_with_a_word() -> None:
    silence = StreamSilence(3)
    assert silence.reached  # nothing was ever heard
    silence.hear()
    states = []
    for _ in range(3):
        states.append(silence.reached)
        silence.look()
    assert states == [False] * 3
    assert silence.reached
    silence.hear()
    assert not silence.reached


def test_samples_meet_their_predictions_in_either_order() -> None:
    pairing = Pairing()
    assert pairing.add_sample(sample(1)) is None
    assert pairing.add_sample(sample(2)) is None
    second = pairing.add_prediction(motion(2))
    assert second is not None
    assert (second.sample.stamp_ns, second.free.stamp_ns) == (2, 2)
    assert pairing.add_prediction(motion(1)) is None  # its sample is gone: the past is not judged after the present
    early = Pairing()
    assert early.add_prediction(motion(5)) is None
    found = early.add_sample(sample(5))
    assert found is not None
    assert found.free.stamp_ns == 5
