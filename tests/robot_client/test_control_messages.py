from __future__ import annotations

import json
import random

import pytest

from revnm_client import control_messages as control
from revnm_client.errors import MessageError
from revnm_client.json_payload import MAX_JSON_BYTES

STATE = {"robot": "rover", "moving": False, "stopped": True, "epoch": 3, "reason": "stop is latched", "v_mps": 0.0}

MESSAGES = [
    (control.encode_stop_request, control.decode_stop_request, control.StopRequest("stop", 3)),
    (control.encode_stop_request, control.decode_stop_request, control.StopRequest("resume", 0)),
    (control.encode_stop_reply, control.decode_stop_reply, control.StopReply(True, 3)),
    (control.encode_time_request, control.decode_time_request, control.TimeRequest(2**62)),
    (control.encode_time_reply, control.decode_time_reply, control.TimeReply(1, 2, 3, "edge")),
    (control.encode_state, control.decode_state, STATE),
]
DECODERS = [
    control.decode_attachment,
    control.decode_stop_request,
    control.decode_stop_reply,
    control.decode_time_request,
    control.decode_time_reply,
    control.decode_state,
]


@pytest.mark.parametrize(("encode", "decode", "message"), MESSAGES)
def test_round_trips(encode, decode, message):
    assert decode(encode(message)) == message


def test_words_on_the_wire():
    assert control.encode_stop_request(control.StopRequest("stop", 3)) == b'{"action":"stop","epoch":3}'
    assert control.encode_stop_reply(control.StopReply(True, 3)) == b'{"stopped":true,"epoch":3}'
    assert control.encode_time_request(control.TimeRequest(1)) == b'{"t1":1}'
    assert control.encode_time_reply(control.TimeReply(1, 2, 3, "edge")) == b'{"t1":1,"t2":2,"t3":3,"server":"edge"}'


@pytest.mark.parametrize("decode", DECODERS)
@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"null",
        b"[]",
        b"3",
        b"\xff\xfe",
        b"{",
        b'{"epoch":NaN}',
        b'{"epoch":1e999}',
        b'{"epoch":1,"epoch":2}',
        b'{"epoch":' + b"9" * 5000 + b"}",
        b"[" * MAX_JSON_BYTES,
        b'{"a":' * 800,
        b'"' + b"x" * MAX_JSON_BYTES + b'"',
    ],
)
def test_garbage_is_refused(decode, payload):
    with pytest.raises(MessageError):
        decode(payload)


@pytest.mark.parametrize(
    ("decode", "fields"),
    [
        (control.decode_attachment, {"epoch": -1, "seq": 0, "goal": "", "server": "edge"}),
        (control.decode_attachment, {"epoch": True, "seq": 0, "goal": "", "server": "edge"}),
        (control.decode_attachment, {"epoch": 1.0, "seq": 0, "goal": "", "server": "edge"}),
        (control.decode_attachment, {"epoch": 2**63, "seq": 0, "goal": "", "server": "edge"}),
        (control.decode_attachment, {"epoch": 1, "seq": 0, "goal": "g" * 65, "server": "edge"}),
        (control.decode_attachment, {"epoch": 1, "seq": 0, "goal": "a\nb", "server": "edge"}),
        (control.decode_attachment, {"epoch": 1, "seq": 0, "goal": None, "server": "edge"}),
        (control.decode_attachment, {"epoch": 1, "seq": 0, "server": "edge"}),
        (control.decode_attachment, {"epoch": 1, "seq": 0, "goal": ""}),
        (control.decode_attachment, {"epoch": 1, "seq": 0, "goal": "", "server": "a\nb"}),
        (control.decode_stop_request, {"action": "halt", "epoch": 1}),
        (control.decode_stop_request, {"action": ["stop"], "epoch": 1}),
        (control.decode_stop_request, {"action": "stop", "epoch": 1, "why": "?"}),
        (control.decode_stop_reply, {"stopped": 1, "epoch": 1}),
        (control.decode_time_request, {"t1": "now"}),
        (control.decode_time_reply, {"t1": 1, "t2": 3, "t3": 2, "server": "edge"}),
        (control.decode_time_reply, {"t1": 1, "t2": 2, "t3": 3, "server": None}),
        (control.decode_state, {key: STATE[key] for key in STATE if key != "reason"}),
        (control.decode_state, STATE | {"moving": 0}),
        (control.decode_state, STATE | {"v_mps": [1.0]}),
        (control.decode_state, STATE | {"clock_offset_ms": 10**400}),
        (control.decode_state, STATE | {"reason": "x" * 300}),
        (control.decode_state, STATE | {"a\nb": 1}),
        (control.decode_state, STATE | {f"key{index}": 1 for index in range(40)}),
    ],
)
def test_well_formed_nonsense_is_refused(decode, fields):
    with pytest.raises(MessageError):
        decode(json.dumps(fields).encode())


@pytest.mark.parametrize(("encode", "decode", "message"), MESSAGES)
def test_flipped_bits_give_a_message_or_a_message_error(encode, decode, message):
    golden = encode(message)
    rng = random.Random(3)
    for _ in range(2000):
        bad = bytearray(golden)
        for _ in range(rng.randint(1, 3)):
            bad[rng.randrange(len(bad))] = rng.randrange(256)
        try:
            decoded = decode(bytes(bad[: rng.randint(1, 2 * len(bad))]))
        except MessageError:
            continue
        assert type(decoded) is type(message)
