# SPDX-License-Identifier: Apache-2.0
"""Packets of the lock-step: whole ones survive the wire, nothing else is accepted."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_time.protocol import MAX_PACKET, CancelRequest, Join, Progress, TimeGrant, TimeRequest, decode, encode

PACKETS = (
    Join("tendon_driver"),
    Join("marker_tracker", "frames", 0.04),
    TimeRequest(7, 1.25, "/dev/pts/3", {"/dev/pts/3": 12_345, "/dev/pts/4": 0}),
    CancelRequest(7),
    Progress(0.1 + 0.2),
    TimeGrant(7, 1.25, 1.7e9 + 1e-6),
)


@pytest.mark.parametrize("packet", PACKETS)
def test_a_packet_survives_the_wire_exactly(packet):
    assert decode(encode(packet)) == packet
    assert len(encode(packet)) < MAX_PACKET


@pytest.mark.parametrize("packet", PACKETS)
def test_a_packet_without_one_of_its_fields_or_with_another_type_is_refused(packet):
    ((name, values),) = json.loads(encode(packet)).items()
    for field in values:
        for changed in ({key: value for key, value in values.items() if key != field}, {**values, field: [1]}):
            with pytest.raises(ValueError, match="expected a packet of Join"):
                decode(json.dumps({name: changed}).encode())


@pytest.mark.parametrize(
    "text",
    [
        '{"Progress":{"time_s":NaN}}',
        '{"Progress":{"time_s":Infinity}}',
        '{"Progress":{"time_s":1%s}}' % ("0" * 400),
        '{"Bye":{}}',
        "[]",
    ],
)
def test_no_time_without_end_and_no_unknown_packet(text):
    with pytest.raises(ValueError, match="found"):
        decode(text.encode())


@given(st.binary(max_size=200))
def test_other_bytes_are_refused(data):
    with pytest.raises(ValueError, match="expected a packet"):
        decode(data)
