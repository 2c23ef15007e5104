#!/usr/bin/env python3
"""Reads the golden bytes of the fleet's messages with cbor2 and of the motor link with pymavlink, and compares every value.

    python3 check_golden.py

The bytes are tests/golden/{wire,mavlink}.json; the values are those that tests/golden/*_generate.py put in. Exit code 1 if one differs.
"""

import json
import sys
from pathlib import Path

import motor_link
import sphere_fleet

GOLDEN = Path(__file__).resolve().parents[2] / "tests/golden"

IDLE = {
    "robot": "r1", "boot_id": 0x0102030405060708, "stamp_ns": 12_345_678_901, "mode": "tracking",
    "x": 1.1, "y": -2.2, "heading": 33.3, "v": 0.5, "q_r": -0.25, "q_r_rate": 0.125,
    "beta": 0.0625, "beta_rate": -0.75, "alpha": 0.03125, "alpha_rate": 1.5, "v_d": 0.625, "q_rd": -0.1875,
    "position_sigma": 0.015625, "torque_pitch": 2.5, "torque_roll": -3.5, "epoch": 5, "command": 17, "received": 0xFFFF0FFF,
    "playing": None, "newest": None, "loop_delay_ns": None,
}  # fmt: skip


def plan(knots, gains):
    values = iter(0.25 * (i + 1) for i in range(17 * knots + 5))
    return {
        "robot": "r2", "boot_id": 0x1112131415161718, "id": {"epoch": 2, "seq": 77},
        "based_on_ns": 9_876_543_210, "start_ns": 10_000_000_123, "period_ns": 100_000_000, "valid_for_ms": 1500,
        "source": "clarabel",
        "u": [tuple(next(values) for _ in range(2)) for _ in range(knots)],
        "x": [tuple(-next(values) for _ in range(5)) for _ in range(knots + 1)],
        "k": [tuple(next(values) for _ in range(10)) for _ in range(knots if gains else 0)],
    }  # fmt: skip


WIRE = {
    "telemetry_idle": IDLE,
    "telemetry": {**IDLE, "playing": {"epoch": 3, "seq": 41}, "newest": {"epoch": 3, "seq": 42}, "loop_delay_ns": 123_456_789},
    "plan": plan(2, gains=True),
    "plan_open": plan(1, gains=False),
    "command": {"robot": "r3", "boot_id": 0x2122232425262728, "number": 300, "station": 0x3132333435363738, "order": "hold"},
    "status": {
        "robot": "r4", "boot_id": 0x4142434445464748, "stamp_ns": -5, "mode": "failsafe",
        "reason": "no sensor frame for 100 ms → zero torque",
        "dropped": dict(zip(sphere_fleet.DROPS, [1, 20, 300, 4_000, 50_000, 600_000, 7, 8, 9, 10])),
        "gain_guard": 11, "software": "0.1.0", "epoch": 12, "station": 13,
    },
    "beacon": {
        "robot": "r5", "boot_id": 0x5152535455565758, "stamp_ns": 77,
        "position": (7.7, -8.8), "velocity": (0.5, -0.75), "radius": 0.375,
    },
}  # fmt: skip

MAVLINK = {
    "sensors": {"theta_r": 1234.56789, "theta_p": -98765.4321, "gyro": [0.125, -0.375, 0.625], "sequence": 4_000_000_001, "status": 5},
    "torque": {"target_system": 1, "sequence": 70_000, "torque_pitch": 2.5, "torque_roll": -3.75, "validity_ms": 250},
    "fix": {"usec": 5_000_000, "x": -2.5, "y": 1.5},
    "heartbeat": {"custom_mode": 4, "base_mode": 129},
}


def main():
    differences = []
    wire = json.loads((GOLDEN / "wire.json").read_text())["wire"]
    for name in sorted(wire.keys() | WIRE.keys()):
        found = sphere_fleet.decode(name.split("_")[0], bytes.fromhex(wire[name]))
        if found != WIRE[name]:
            differences.append(f"{name}: {found} instead of {WIRE[name]}")

    sphere = motor_link.dialect()
    frames = json.loads((GOLDEN / "mavlink.json").read_text())["mavlink"]
    for name, expected in MAVLINK.items():
        [message] = sphere.MAVLink(None).parse_buffer(bytes.fromhex(frames[name]))
        found = {field: getattr(message, field) for field in expected}
        if found != expected:
            differences.append(f"{name}: {found} instead of {expected}")

    version = bytes.fromhex(wire["beacon"]).replace(b"\x83\x01", b"\x83\x02", 1)
    try:
        sphere_fleet.decode("beacon", version)
        differences.append("a beacon of schema 2.0 was read")
    except sphere_fleet.Refused:
        pass

    for difference in differences:
        print(f"check_golden: {difference}", file=sys.stderr)
    print(f"check_golden: {len(wire)} messages and {len(MAVLINK)} frames, {len(differences)} differences")
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
