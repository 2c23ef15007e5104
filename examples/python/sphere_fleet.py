"""The fleet's messages in Python: CBOR bytes to dictionaries, as docs/protocol.md states them. Needs cbor2."""

import struct

import cbor2

MAJOR = 1

MODES = ["boot", "disarmed", "ready", "idle", "tracking", "holding", "failsafe", "fault"]
SOURCES = ["riccati", "clarabel", "shifted", "steps", "course"]
ORDERS = ["claim", "release", "arm", "disarm", "hold", "resume"]
DROPS = [
    "malformed", "version", "wrong robot", "wrong boot", "wrong epoch", "old", "expired", "future", "out of range", "unexpected",
]


class Refused(ValueError):
    """Bytes that are no message of this kind."""


def decode(topic, data):
    """The message `data` (bytes) of `topic`: telemetry, plan, command, status or beacon.

    Raises Refused, with the reason, for everything else.
    """
    try:
        major, minor, fields = cbor2.loads(data)
    except (cbor2.CBORDecodeError, TypeError, ValueError) as error:
        raise Refused(f"not a message: {error}") from error
    if major != MAJOR:
        raise Refused(f"a {topic} message has schema {major}.{minor}, this client reads {MAJOR}.x: update the older side")
    read = READERS.get(topic)
    if read is None:
        raise Refused(f"no message is called {topic}")
    try:
        return {"robot": fields[0], "boot_id": fields[1], **read(fields)}
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error) as error:
        raise Refused(f"not a {topic} message: {error!r}") from error


def telemetry(f):
    x, y, heading = floats(f[4])
    v, q_r, q_r_rate, beta, beta_rate, alpha, alpha_rate = floats(f[5])
    v_d, q_rd = floats(f[6])
    pitch, roll = floats(f[8])
    return {
        "stamp_ns": f[2], "mode": MODES[f[3]],
        "x": x, "y": y, "heading": heading, "v": v, "q_r": q_r, "q_r_rate": q_r_rate,
        "beta": beta, "beta_rate": beta_rate, "alpha": alpha, "alpha_rate": alpha_rate,
        "v_d": v_d, "q_rd": q_rd, "position_sigma": f[7], "torque_pitch": pitch, "torque_roll": roll,
        "epoch": f[9], "command": f[10], "received": f[11],
        "playing": plan_id(f.get(12)), "newest": plan_id(f.get(13)), "loop_delay_ns": f.get(14),
    }  # fmt: skip


def plan(f):
    name, based_on, lead, period, valid_for_ms, source = f[2]
    values = floats(f[3])
    count = (len(values) - 5) // 7
    if count < 1 or len(values) != 7 * count + 5:
        raise ValueError("knots are not N rows of 7 and one of 5")
    knots = [values[7 * i : 7 * i + 7] for i in range(count)]
    gains = floats(f[4]) if 4 in f else ()
    return {
        "id": plan_id(name), "based_on_ns": based_on, "start_ns": based_on + lead, "period_ns": period,
        "valid_for_ms": valid_for_ms, "source": SOURCES[source],
        "u": [row[:2] for row in knots],
        "x": [row[2:] for row in knots] + [values[-5:]],
        "k": [gains[i : i + 10] for i in range(0, len(gains), 10)],
    }  # fmt: skip


def command(f):
    return {"number": f[2], "station": f[3], "order": ORDERS[f[4]]}


def status(f):
    return {
        "stamp_ns": f[2], "mode": MODES[f[3]], "reason": f[4], "dropped": dict(zip(DROPS, f[5])),
        "gain_guard": f[6], "software": f[7], "epoch": f[8], "station": f[9],
    }  # fmt: skip


def beacon(f):
    return {"stamp_ns": f[2], "position": floats(f[3]), "velocity": floats(f[4]), "radius": f[5]}


READERS = {"telemetry": telemetry, "plan": plan, "command": command, "status": status, "beacon": beacon}


def floats(value):
    """A typed array of RFC 8746: tag 85 holds f32, tag 86 f64, little endian."""
    letter, size = {85: ("f", 4), 86: ("d", 8)}[value.tag]
    return struct.unpack(f"<{len(value.value) // size}{letter}", value.value)


def plan_id(value):
    return None if value is None else {"epoch": value >> 32, "seq": value & 0xFFFFFFFF}
