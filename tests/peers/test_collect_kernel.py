"""`msp-lab collect` as a person starts it, with the stock smbus2 on an emulated kernel's bus, typing its answers.

The bench is a small computer: nothing of the extras is installed.
"""

import sys
from pathlib import Path

import numpy as np

from msp_range.recording.csv_form import read_csv
from msp_sim.device.device import Fault
from tests.support.campaigns import condition, written
from tests.support.kernel_bus import Sonar, kernel_bus
from tests.support.waiting import LIMIT_S

EXTRAS = ("filterpy", "jinja2", "matplotlib", "scipy")
PROGRAM = f"import sys; sys.modules.update(dict.fromkeys({EXTRAS})); from msp_lab.cli import main; main()"


def test_a_campaign_on_a_kernel_bus(tmp_path: Path) -> None:
    both = condition(
        condition="crosstalk", ranges_cm=[120], sensors=["one", "two"], firing=["simultaneous"], readings=4
    )
    path = written(tmp_path, condition(ranges_cm=[120], readings=5), both)
    command = [sys.executable, "-c", PROGRAM, "collect", str(path), "--out", str(tmp_path / "out"), "--bus", "1"]
    sonars = [
        Sonar(0x70, [121], faults=[Fault("clock_fault", 0.0, 1e9, probability=0.5)]),
        Sonar(0x71, [119]),
    ]
    typed = "21.5\nrange=120.5\n\n" + "\n" * 20
    with kernel_bus(sonars) as testbed:
        program = testbed.popen(command, stdin=-1, stdout=-1, stderr=-1, text=True)
        output, errors = program.communicate(typed, timeout=LIMIT_S)
    assert program.returncode == 0, errors
    assert "0 of 2 points are left" in output
    data = read_csv(tmp_path / "out/readings.csv")
    assert set(data["air_temperature_c"]) == {21.5}
    alone = data.select(data["condition"] == "baseline")
    answered = ~np.isnan(alone["reading_cm"])
    assert alone["reading_cm"][answered].tolist() == [121] * 5
    assert not answered.all(), "the clock faults are there as pings without an answer"
    assert set(alone["true_range_cm"]) == {120.5}
    second = data.select((data["condition"] == "crosstalk") & (data["sensor"] == "two"))
    assert len(second) >= 4
    assert (second["neighbour_lag_ms"] > 0).all()
    assert (second["neighbour_lag_ms"] < 20).all()
