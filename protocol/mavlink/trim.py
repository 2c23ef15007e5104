#!/usr/bin/env python3
"""Cuts MAVLink's own definitions down to the messages of sphere.xml's includes, unchanged, into common.xml.

    python3 trim.py <message_definitions/v1.0> > common.xml

The definitions come with the `mavlink` crate (mavlink/message_definitions/v1.0 of its sources), release in the head of the
output. Compiling all 236 messages takes five times as long. To add a message, name it in MESSAGES and run again.
"""

import re
import sys
from pathlib import Path

SOURCE = "mavlink 0.21.0"
FILES = ["minimal.xml", "standard.xml", "common.xml"]
MESSAGES = """
    HEARTBEAT SYS_STATUS SYSTEM_TIME TIMESYNC STATUSTEXT AUTOPILOT_VERSION
    PARAM_REQUEST_READ PARAM_REQUEST_LIST PARAM_VALUE PARAM_SET
    COMMAND_LONG COMMAND_INT COMMAND_ACK SET_MODE MANUAL_CONTROL REQUEST_DATA_STREAM
    ATTITUDE LOCAL_POSITION_NED GLOBAL_POSITION_INT HOME_POSITION VISION_POSITION_ESTIMATE ODOMETRY
    MISSION_CURRENT MISSION_REQUEST_LIST MISSION_COUNT MISSION_CLEAR_ALL MISSION_ACK
    MISSION_REQUEST_INT MISSION_ITEM_INT
""".split()
# Whole: a receiver must be able to read any command in order to refuse it.
ENUMS = {"MAV_CMD"}

text = "".join((Path(sys.argv[1]) / name).read_text() for name in FILES)
text = re.sub(r" *<!--.*?-->\n?", "", text, flags=re.S)


def blocks(kind):
    """Every <kind ... name="X"> ... </kind> by name."""
    found = re.findall(rf'( *<{kind} [^>]*name="(\w+)".*?</{kind}>\n)', text, re.S)
    return {name: block for block, name in found}


messages, enums = blocks("message"), blocks("enum")
kept = [messages[name] for name in MESSAGES]
kept.sort(key=lambda block: int(re.search(r'id="(\d+)"', block)[1]))
wanted = ENUMS | set(re.findall(r'enum="(\w+)"', "".join(kept)))

print('<?xml version="1.0"?>')
print(f"<!-- Cut by trim.py from {', '.join(FILES)} of {SOURCE}: {len(kept)} messages, otherwise unchanged. -->")
print("<mavlink>\n  <version>3</version>\n  <dialect>0</dialect>\n  <enums>")
print("".join(block for name, block in enums.items() if name in wanted), end="")
print("  </enums>\n  <messages>")
print("".join(kept), end="")
print("  </messages>\n</mavlink>")
