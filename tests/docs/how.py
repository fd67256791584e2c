"""How the commands of documents are run: what a document's reader has before, smaller numbers, and other tests.

A command that is in none of the tables is run as it is shown, in a folder like a clone of this repository. One that
ends with ' ...' stands for all that begin so.
"""

from collections.abc import Mapping, Sequence

MAKE = {
    "N": "1",
    "SEED": "1",
    "FLIGHTS": "2",
    "HOURS": "0.02",
    "MINUTES": "0",
    "SECONDS": "1",
    "ONLY": "rates",
    "KINDS": "null:0",
}
"""How much `make` computes: its variables come from the environment."""
Changes = Mapping[str, Sequence[tuple[str, str]]]
SMALLER: Changes = {
    "configs/scenarios/terrain.yaml": [
        (r"duration_s: 80", "duration_s: 32"),
        (r"duration_s: 50", "duration_s: 18"),
        (r"duration_s: 40", "duration_s: 12"),
    ],
    "configs/campaigns/table_4_1.yaml": [
        (r"readings: 20000", "readings: 400"),
        (r"readings: \d00\b", "readings: 8"),
        (r"readings: 50\b", "readings: 3"),
    ],
    "configs/campaigns/afternoon.yaml": [
        (r"readings: \d+", "readings: 2"),
        (r"first: -27, last: 27, step: 5.4", "first: 0, last: 27, step: 27"),
    ],
}
"""Files of the clone in which flights are shorter and readings fewer: patterns with what stands in their place."""

NUMBERS_CHECKED = {"docs/one-ping.md"}
"""Documents whose last program prints their numbers: each line of its output stands in the text."""

ON_BUS = {
    "docs/commissioning.md",
    "docs/flying.md",
    "docs/laboratory.md",
    "docs/sitl.md",
    "docs/tutorials/ardupilot.md",
    "docs/tutorials/first-distance.md",
    "docs/tutorials/first-hour.md",
    "docs/tutorials/px4.md",
    "docs/watching.md",
}
"""Documents whose commands find four sensors on an I2C bus and an autopilot, both emulated, in real time."""

PX4 = {"docs/tutorials/px4.md": "udpout:127.0.0.1:14540"}
"""Documents whose autopilot is a PX4, and where it speaks to; others have an ArduPilot that listens at $PORT."""

CTRL_C = "python -m tests.docs.ctrl_c {}"
YES = "yes | {}"
DISCONTENT = "{} || test $? = 1"
"""It finds something wrong, as its document shows."""
NOTHING_INSTALLED = "{} --dry-run --no-index --no-build-isolation"
AROUND = {
    "make test": "PYTEST_ADDOPTS='tests/unit/msp_range/mavlink/test_frames.py' {}",
    "msp-lab filters --table mine.csv": "{} --seeds 10",
    "python -m pytest tests/sitl": "env -u MSP_RANGE_ARDUCOPTER -u MSP_RANGE_PX4 {}",
    "pip install '.[lab,logs]'": NOTHING_INSTALLED,
    "dask scheduler ...": "{} & sleep 4",
    "dask worker ...": "{} & sleep 4",
    "msp-lab collect configs/campaigns/afternoon.yaml --out campaigns/mine ...": "yes '' | {}",
    "sudo msp-range sign my_airframe.yaml": "sed -i 's#^link:#link:\\n  signing_key: signing.key#' my_airframe.yaml; "
    'sudo() { "$@"; }; {}',
    "msp-range address 0x70 0x71": "yes | UMOCKDEV_DIR=$ONE_SENSOR {}",
    "msp-range commission my_airframe.yaml": "{} || test $? = 3",
    "msp-range doctor my_airframe.yaml": DISCONTENT,
    "msp-range doctor --preflight my_airframe.yaml": DISCONTENT,
    "msp-range doctor configs/loopback.yaml": DISCONTENT,
    "msp-range params my_airframe.yaml --compare": DISCONTENT,
    "msp-range params my_airframe.yaml --write": YES,
    "msp-range run my_airframe.yaml ...": CTRL_C,
    "msp-range run configs/loopback.yaml --no-record": "timeout --preserve-status -s INT 9 {} & sleep 4",
    "msp-range status": "{} || test $? = 4",
    "msp-sim fly configs/scenarios/hover.yaml --realtime --link udpout:127.0.0.1:14550": CTRL_C + " || test $? = 130",
    "msp-sim sitl ...": CTRL_C,
    ".venv/bin/msp-lab compare ../shared/data/enmt482/training1.csv --map reading_cm=sonar2 ...": "{} || test $? = 3",
}
"""Commands that are run word by word, and what a person would do: answer, press Ctrl-C, take a message for what it is.
The command stands in the place of '{}'."""

INSTEAD = {
    "export ADDRESS=192.168.1.5": "export ADDRESS=127.0.0.1",
}
"""Lines of which the words are others here: other numbers, an address of this computer."""

ELSEWHERE = {
    "make check": ".ci/run",
    "make lock": "tests/release/test_lock.py",
    "make stored": "tests/release/test_stored.py",
    "make release": "tests/release/test_twice.py",
    "make test-install": "evaluation/install/command.py",
    "sudo ./install.sh": "evaluation/install/command.py",
    "sudo msp-range web on": "evaluation/install/command.py",
    "msp-lab design gaps/june --bench --max-minutes 90": "tests/loop/test_design.py",
    "msp-lab collect gaps/june/design/1-*/campaign.yaml --out new": "tests/loop/test_design.py",
    "msp-lab gap OLD.csv new/readings.csv --model MODEL.yaml --out gaps/july": "tests/loop/test_design.py",
    "arducopter --model + ...": "tests/sitl/arducopter.py",
    "msp-lab filters --out study": "tests/unit/msp_lab/filter_study/test_filter_study.py",
    "make gap-demo": "tests/loop/test_gap_demo.py",
    "python -m tests.peers.fetch_flights flights/public": "tests/peers/test_public_logs.py",
    "sim_vehicle.py -N -v ArduCopter --add-param-file=range.parm ...": "tests/sitl/shown.py",
    "make px4_sitl sihsim_quadx": "tests/sitl/shown.py",
}
"""Commands that are not run here, and the test that runs exactly that."""


def found(table: Mapping[str, str], command: str) -> str | None:
    """What a table has for a command; None: nothing."""
    for key, value in table.items():
        if command == key or (key.endswith(" ...") and f"{command} ".startswith(key.removesuffix("..."))):
            return value
    return None
