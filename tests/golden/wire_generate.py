#!/usr/bin/env python3
"""Writes wire.json: the messages of tests/wire.rs as bytes, by cbor2 from the tables in protocol/src/wire/*.rs alone.

    pip install cbor2; python3 tests/golden/wire_generate.py > tests/golden/wire.json

It shares no code with protocol, so that the two agree only where both follow the tables. Values are those of the functions
`telemetry`, `plan`, `command`, `status`, `beacon` in tests/wire.rs.
"""

import json
import struct

import cbor2


class F32(float):
    """A float that travels as binary32."""


def write_f32(encoder, value):
    encoder.write(b"\xfa" + struct.pack(">f", value))


def typed_f32(*values):
    return cbor2.CBORTag(85, struct.pack(f"<{len(values)}f", *values))


def typed_f64(*values):
    return cbor2.CBORTag(86, struct.pack(f"<{len(values)}d", *values))


def message(fields, version=(1, 0)):
    return cbor2.dumps([*version, fields], encoders={F32: write_f32}).hex()


def plan_id(epoch, seq):
    return epoch << 32 | seq


def plan(knots, gains):
    values = iter(0.25 * (i + 1) for i in range(17 * knots + 5))
    u = [[next(values) for _ in range(2)] for _ in range(knots)]
    x = [[-next(values) for _ in range(5)] for _ in range(knots + 1)]
    k = [[next(values) for _ in range(10)] for _ in range(knots)]
    head = [plan_id(2, 77), 9_876_543_210, 10_000_000_123 - 9_876_543_210, 100_000_000, 1_500, 1]
    rows = [value for i in range(knots) for value in u[i] + x[i]] + x[knots]
    fields = {0: "r2", 1: 0x1112131415161718, 2: head, 3: typed_f32(*rows)}
    if gains:
        fields[4] = typed_f32(*(value for row in k for value in row))
    return message(fields)


idle = {
    0: "r1",
    1: 0x0102030405060708,
    2: 12_345_678_901,
    3: 4,
    4: typed_f64(1.1, -2.2, 33.3),
    5: typed_f32(0.5, -0.25, 0.125, 0.0625, -0.75, 0.03125, 1.5),
    6: typed_f32(0.625, -0.1875),
    7: F32(0.015625),
    8: typed_f32(2.5, -3.5),
    9: 5,
    10: 17,
    11: 0xFFFF0FFF,
}
telemetry = {**idle, 12: plan_id(3, 41), 13: plan_id(3, 42), 14: 123_456_789}
command = {0: "r3", 1: 0x2122232425262728, 2: 300, 3: 0x3132333435363738, 4: 4}
status = {
    0: "r4",
    1: 0x4142434445464748,
    2: -5,
    3: 6,
    4: "no sensor frame for 100 ms → zero torque",
    5: [1, 20, 300, 4_000, 50_000, 600_000, 7, 8, 9, 10],
    6: 11,
    7: "0.1.0",
    8: 12,
    9: 13,
}
beacon = {
    0: "r5",
    1: 0x5152535455565758,
    2: 77,
    3: typed_f64(7.7, -8.8),
    4: typed_f32(0.5, -0.75),
    5: F32(0.375),
}

messages = {
    "telemetry": message(telemetry),
    "telemetry_idle": message(idle),
    "plan": plan(2, gains=True),
    "plan_open": plan(1, gains=False),
    "command": message(command),
    "status": message(status),
    "beacon": message(beacon),
}
print(json.dumps({"wire": messages}, indent=1))
