#!/usr/bin/env python3
"""Writes mavlink.json: the frames of tests/mavlink.rs, by pymavlink from protocol/mavlink/sphere.xml.

    pip install pymavlink; python3 tests/golden/mavlink_generate.py > tests/golden/mavlink.json

pymavlink's generator shares no code with mavlink-bindgen: the two agree only where both follow the definitions.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

XML = Path(__file__).resolve().parents[2] / "protocol/mavlink/sphere.xml"

with tempfile.TemporaryDirectory() as folder:
    module = Path(folder) / "sphere.py"
    generate = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang=Python3", "--wire-protocol=2.0"]
    subprocess.run([*generate, "-o", module, XML], check=True, stdout=subprocess.DEVNULL)
    os.environ["MAVLINK20"] = "1"
    spec = importlib.util.spec_from_file_location("sphere", module)
    sphere = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sphere)

NAN = float("nan")
frames = {}


def frame(name, system, component, sequence, send):
    link = sphere.MAVLink(None, srcSystem=system, srcComponent=component)
    link.seq = sequence
    frames[name] = bytes(send(link).pack(link)).hex()


frame(
    "sensors", 1, 1, 250,
    lambda link: link.sphere_sensors_encode(
        time_usec=12_345_678_901,
        theta_r=1234.56789,
        theta_p=-98765.4321,
        theta_r_rate=0.5,
        theta_p_rate=-0.25,
        gyro=[0.125, -0.375, 0.625],
        accel=[1.5, -2.5, 9.75],
        sequence=4_000_000_001,
        status=1 | 4,
    ),
)
frame("torque", 1, 191, 0, lambda link: link.sphere_torque_encode(1, 1, 70_000, 2.5, -3.75, 250))
covariance = [NAN] * 21
covariance[0], covariance[1], covariance[6] = 0.0625, 0.0, 0.0625
frame(
    "fix", 1, 1, 7,
    # x north, y east: our Y and X.
    lambda link: link.vision_position_estimate_encode(5_000_000, -2.5, 1.5, 0.0, NAN, NAN, NAN, covariance, 0),
)
frame("heartbeat", 1, 191, 255, lambda link: link.heartbeat_encode(10, 0, 128 | 1, 4, 4))
frame("param_request_list", 255, 190, 3, lambda link: link.param_request_list_encode(1, 0))

print(json.dumps({"mavlink": frames}, indent=1))
