#!/usr/bin/env python3
"""What agents and their motor boards say to each other, from a copy of their frames.

    sphere-sim demo --mirror 127.0.0.1:24700        # or: sphere-sim plants --mirror ...
    python3 motor_link.py --port 24700 --robots 3 --seconds 5

A motor link joins two pinned addresses, so nobody else can listen to it. With --mirror the plants send a copy of every datagram, both
ways, to another address: robot number i (from 0) to its port + i. Frames from component 191 are the agent's, from 1 the board's.

Exit code 0; 1 if a robot's link was silent in either direction; 2 if a port is taken.
Needs pymavlink (requirements.txt), which compiles protocol/mavlink/sphere.xml here; the messages are docs/protocol.md.
"""

import argparse
import importlib.util
import json
import os
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

XML = Path(__file__).resolve().parents[2] / "protocol/mavlink/sphere.xml"
AGENT, BOARD = 191, 1


def dialect():
    """The dialect sphere.xml as a Python module, compiled by mavgen."""
    os.environ["MAVLINK20"] = "1"
    with tempfile.TemporaryDirectory() as folder:
        module = Path(folder) / "sphere.py"
        generate = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang=Python3", "--wire-protocol=2.0"]
        made = subprocess.run([*generate, "-o", module, XML], capture_output=True, text=True, check=False)
        if made.returncode != 0 or not module.exists():
            sys.exit(f"motor_link: mavgen cannot compile {XML}:\n{made.stdout}{made.stderr}")
        spec = importlib.util.spec_from_file_location("sphere", module)
        sphere = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sphere)
        return sphere


class Link:
    """One robot's link, both directions."""

    def __init__(self, sphere):
        # One parser a direction: each end numbers its own frames.
        self.parsers = {AGENT: sphere.MAVLink(None), BOARD: sphere.MAVLink(None)}
        for parser in self.parsers.values():
            parser.robust_parsing = True
        self.counts = {AGENT: {}, BOARD: {}}
        self.newest = {}
        self.bad = 0
        self.lost = 0

    def on_datagram(self, data):
        # Byte 6 of a MAVLink 2 frame is its component.
        parser = self.parsers.get(data[6]) if len(data) > 6 else None
        if parser is None:
            self.bad += 1
            return
        for message in parser.parse_buffer(data) or []:
            name = message.get_type()
            if name == "BAD_DATA" or name.startswith("UNKNOWN"):
                self.bad += 1
                continue
            before = self.newest.get(name)
            if name == "SPHERE_SENSORS" and before is not None:
                gap = (message.sequence - before.sequence - 1) % 2**32
                # A board that has restarted counts anew.
                self.lost += gap if gap < 2**31 else 0
            counts = self.counts[message.get_srcComponent()]
            counts[name] = counts.get(name, 0) + 1
            # Both ends send heartbeats: the agent's carries the mode.
            if name != "HEARTBEAT" or message.get_srcComponent() == AGENT:
                self.newest[name] = message

    def is_whole(self):
        return "SPHERE_SENSORS" in self.counts[BOARD] and "SPHERE_TORQUE" in self.counts[AGENT]

    def summary(self):
        return {
            "from_board": self.counts[BOARD],
            "from_agent": self.counts[AGENT],
            "bad": self.bad,
            "samples_lost": self.lost,
            "newest": {name: without_nan(message.to_dict()) for name, message in self.newest.items()},
        }

    def line(self):
        sensors, torque = self.newest.get("SPHERE_SENSORS"), self.newest.get("SPHERE_TORQUE")
        if sensors is None or torque is None:
            return "silent" if sensors is torque else "one direction is silent"
        return (
            f"{sum(self.counts[BOARD].values()):6d} frames, {self.lost} samples lost  "
            f"θ_p {sensors.theta_p:9.3f} θ_r {sensors.theta_r:7.3f} rad, up {sensors.accel[2]:6.2f} m/s²  │  "
            f"{sum(self.counts[AGENT].values()):6d} frames  "
            f"τ_p {torque.torque_pitch:7.3f} τ_r {torque.torque_roll:7.3f} N·m for {torque.validity_ms} ms"
        )


def without_nan(value):
    """JSON has no NaN, which a fix's attitude is."""
    if isinstance(value, float) and value != value:
        return None
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    return [without_nan(item) for item in value] if isinstance(value, (list, tuple)) else value


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1", help="address of the mirror")
    parser.add_argument("--port", type=int, default=24700, help="port of the mirror's first robot")
    parser.add_argument("--robots", type=int, default=1, help="how many robots")
    parser.add_argument("--seconds", type=float, default=5.0, help="how long to listen")
    parser.add_argument("--json", action="store_true", help="print counts and newest messages as JSON, and nothing else, at the end")
    arguments = parser.parse_args()

    sphere = dialect()
    links, selector = [], selectors.DefaultSelector()
    for i in range(arguments.robots):
        end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            end.bind((arguments.host, arguments.port + i))
        except OSError as error:
            print(f"motor_link: {arguments.host}:{arguments.port + i}: {error}", file=sys.stderr)
            return 2
        links.append(Link(sphere))
        selector.register(end, selectors.EVENT_READ, links[-1])

    now = time.monotonic()
    end, show = now + arguments.seconds, now + 1.0
    while (now := time.monotonic()) < end:
        for ready, _ in selector.select(timeout=min(end, show) - now if show > now else 0):
            ready.data.on_datagram(ready.fileobj.recv(2048))
        if time.monotonic() >= show:
            show += 1.0
            if not arguments.json:
                for i, link in enumerate(links):
                    print(f"{i}: {link.line()}")
                print(flush=True)

    if arguments.json:
        print(json.dumps({"robots": [link.summary() for link in links]}))
    silent = [i for i, link in enumerate(links) if not link.is_whole()]
    if silent:
        print(f"motor_link: no sensors or no torques of robot number {silent} at port {arguments.port} + number", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
