"""The recording that the program's `export` writes, read by the Python package mcap, which shares no code with it."""

import base64
import csv
import json
import os
import subprocess
from decimal import Decimal
from pathlib import Path

import pytest
from conftest import BENDING, ROOT

reader = pytest.importorskip("mcap.reader")
PROGRAM = Path(os.environ.get("SNAKELOOP_PROGRAM", ROOT / "target" / "debug" / "snakeloop"))
ROWS = """index,time_s,theta_deg,delta_deg,sigma_theta_deg,sigma_delta_deg,status
0,1700000000.25,5.6,-2.5,0.015,0.44,ok
2,1700000001,,,,,occluded
4,1700000002.5,60.9,3.3,0.017,0.049,ok
"""


@pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built")
def test_every_row_and_frame_is_there_with_its_own_time(tmp_path):
    (tmp_path / "measurements.csv").write_text(ROWS)
    bag = tmp_path / "run.mcap"
    subprocess.run([PROGRAM, "export", tmp_path, "--experiment", BENDING, "-o", bag, "--quiet"], check=True)
    with open(bag, "rb") as file:
        messages = list(reader.make_reader(file, validate_crcs=True).iter_messages())
    by_topic = {}
    for _, channel, message in messages:
        by_topic.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    assert [message.log_time for *_, message in messages] == sorted(message.log_time for *_, message in messages)

    rows = list(csv.DictReader(ROWS.splitlines()))
    times = [int(10**9 * Decimal(row["time_s"])) for row in rows]
    assert [time for time, _ in by_topic["/measurement"]] == times
    for (_, found), row in zip(by_topic["/measurement"], rows, strict=True):
        assert {name: str(value) for name, value in found.items() if name == "status"} == {"status": row["status"]}
        assert ("theta_deg" in found) == bool(row["theta_deg"]) and found["index"] == int(row["index"])
    assert [time for time, _ in by_topic["/camera/side"]] == times
    for (_, found), row in zip(by_topic["/camera/side"], rows, strict=True):
        assert base64.b64decode(found["data"]) == (BENDING / "frames" / f"{int(row['index']):05}.jpg").read_bytes()
    assert len(by_topic["/encoders"]) == 17
