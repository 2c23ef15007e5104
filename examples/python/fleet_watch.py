#!/usr/bin/env python3
"""Who is in the fleet, where each robot is, what it does and what is planned for it.

    python3 fleet_watch.py --connect tcp/127.0.0.1:7447 --seconds 5

Listens only: it takes no lease and sends nothing. Exit code 0; 1 if no robot was seen; 2 if there was no station to connect to.
Needs eclipse-zenoh and cbor2 (requirements.txt); the messages are docs/protocol.md.
"""

import argparse
import json
import math
import sys
import threading
import time

import zenoh

import sphere_fleet

KEYS = ["fleet/v1/*/up/**", "fleet/v1/*/down/plan", "fleet/v1/*/beacon"]


class Fleet:
    """The newest message of each kind of each robot. Messages arrive on Zenoh's threads."""

    def __init__(self):
        self.lock = threading.Lock()
        self.robots = {}
        self.refused = []

    def on_sample(self, sample):
        key = str(sample.key_expr)
        _, _, robot, *rest = key.split("/")
        topic = rest[-1]
        try:
            message = sphere_fleet.decode(topic, sample.payload.to_bytes())
            if message["robot"] != robot:
                raise sphere_fleet.Refused(f"a message of {message['robot']}")
        except sphere_fleet.Refused as error:
            with self.lock:
                self.refused.append(f"{key}: {error}")
            return
        with self.lock:
            seen = self.robots.setdefault(robot, {"counts": {}})
            seen["counts"][topic] = seen["counts"].get(topic, 0) + 1
            seen[topic] = message

    def snapshot(self):
        with self.lock:
            return {robot: dict(seen, counts=dict(seen["counts"])) for robot, seen in sorted(self.robots.items())}


def session(endpoint):
    """A client of the router at `endpoint`, tried for 5 s."""
    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 5000,
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 1000,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def line(robot, seen):
    telemetry, plan = seen.get("telemetry"), seen.get("plan")
    if telemetry is None:
        return f"{robot:<8}  no telemetry"
    text = (
        f"{robot:<8}  {telemetry['mode']:<8}  {telemetry['x']:8.3f}  {telemetry['y']:8.3f}  "
        f"{math.degrees(math.remainder(telemetry['heading'], math.tau)):8.1f}  {telemetry['v']:6.2f}  {telemetry['position_sigma'] * 1e3:6.1f}  "
    )
    if plan is None:
        return text + "none"
    x, y = plan["x"][-1][:2]
    seconds = len(plan["u"]) * plan["period_ns"] * 1e-9
    return text + f"{plan['id']['seq']:5d}  {plan['source']:<8}  {len(plan['u'])} knots, in {seconds:.1f} s at {x:.2f}, {y:.2f}"


HEADER = f"{'robot':<8}  {'mode':<8}  {'x m':>8}  {'y m':>8}  {'heading°':>8}  {'v m/s':>6}  {'± mm':>6}  {'plan':>5}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connect", metavar="ENDPOINT", default="tcp/127.0.0.1:7447", help="where the station listens")
    parser.add_argument("--seconds", type=float, default=5.0, help="how long to watch")
    parser.add_argument("--json", action="store_true", help="print the last messages as JSON, and nothing else, at the end")
    arguments = parser.parse_args()

    fleet = Fleet()
    try:
        bus = session(arguments.connect)
    except zenoh.ZError as error:
        print(f"fleet_watch: no station at {arguments.connect}: {error}", file=sys.stderr)
        return 2
    with bus:
        subscriptions = [bus.declare_subscriber(key, fleet.on_sample) for key in KEYS]
        end = time.monotonic() + arguments.seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(1.0, left))
            if not arguments.json:
                print(HEADER)
                for robot, seen in fleet.snapshot().items():
                    print(line(robot, seen))
                print(flush=True)
        for subscription in subscriptions:
            subscription.undeclare()

    robots = fleet.snapshot()
    if arguments.json:
        print(json.dumps({"robots": robots, "refused": fleet.refused}))
    for refusal in fleet.refused[:5]:
        print(f"fleet_watch: {refusal}", file=sys.stderr)
    if not any("telemetry" in seen for seen in robots.values()):
        print(f"fleet_watch: no robot in {arguments.seconds:g} s at {arguments.connect}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
