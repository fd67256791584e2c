"""Cut a log of an autopilot's simulator to what an import reads: ``python -m tests.support.cut_logs IN OUT``.

The kept messages are the autopilot's own bytes (.BIN), or its own values (.ulg, every so many samples of fast topics).
"""

import sys
from pathlib import Path

from pymavlink.DFReader import DFReader_binary

KEPT = (
    *("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "VER"),
    *("RFND", "ATT", "XKF1", "GPS", "GPA", "SIM", "BARO", "CTUN", "VIBE"),
)
TOPICS = {
    "distance_sensor": 1,
    "vehicle_attitude": 25,
    "vehicle_local_position": 12,
    "vehicle_local_position_groundtruth": 5,
    "estimator_status_flags": 1,
    "vehicle_gps_position": 1,
    "vehicle_air_data": 2,
    "vehicle_thrust_setpoint": 5,
    "vehicle_imu_status": 1,
}
"""Topic -> every so many samples are kept."""


def cut_dataflash(source: Path, target: Path) -> None:
    """Keep the messages of `KEPT`."""
    log = DFReader_binary(str(source))
    kinds = [log.name_to_id[name] for name in KEPT if name in log.name_to_id]
    places = sorted((at, log.formats[kind].len) for kind in kinds for at in log.offsets[kind])
    content = source.read_bytes()
    target.write_bytes(b"".join(content[at : at + length] for at, length in places))


def cut_ulog(source: Path, target: Path) -> None:
    """Keep the topics of `TOPICS`."""
    from pyulog import ULog

    log = ULog(str(source), list(TOPICS))
    for each in log.data_list:
        each.data = {name: values[:: TOPICS[each.name]] for name, values in each.data.items()}
    log.write_ulog(str(target))


if __name__ == "__main__":
    read, written = Path(sys.argv[1]), Path(sys.argv[2])
    (cut_ulog if written.suffix == ".ulg" else cut_dataflash)(read, written)
