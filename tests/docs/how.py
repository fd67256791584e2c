"""How the commands of documents are run: what a document's reader has before, smaller numbers, and other tests.

A command that is in none of the tables is run as it is shown, in a folder like a clone of this repository. One that
ends with ' ...' stands for all that begin so.
"""

from collections.abc import Mapping

LOOP = "sed 's#sensors/mb1242.yaml#mb1242#; s#14550#'$PORT'#' configs/loopback.yaml > my_airframe.yaml"
FLOWN = "cp -r $FLOWN/. ."
"""Four simulated flights over terrain: 1.mcap to 4.mcap, and flights/1.csv to flights/4.csv."""

LINK = "--link udpout:127.0.0.1:$PORT"
"""Where the emulated autopilot is, instead of at a serial port."""
ENDED_BY = "timeout --preserve-status -s"
"""Ends what runs for ever; a signal and a number of seconds follow."""

PREPARE = {
    "docs/watching.md": "cp configs/sensors/mb1242_in_flight.yaml MODEL.yaml",
    "docs/extending.md": "cp tests/third_party/package/sonar_extras/supply_sag.py .",
    "docs/flying.md": f"{LOOP}; {FLOWN}; cp 1.mcap flight.mcap; head -c -20000 1.mcap > cut.mcap",
    "docs/fleets.md": f"{FLOWN}; mv flights/1.csv one.csv; mv flights/2.csv two.csv",
    "docs/fusion.md": FLOWN,
    "docs/laboratory.md": "printf 'distance_mm,ruler_cm\\n' > table.csv; "
    "for cm in 40 80 120 160 200; do for i in 1 2 3 4 5 6 7 8 9 10 11 12; do "
    "printf '%s,%s\\n' $((cm * 10 + i % 3 * 10 - 10)) $cm >> table.csv; done; done",
}
"""What is there before a document's first command, as a script: what its text tells the reader to have."""

ON_BUS = {
    "docs/flying.md",
    "docs/laboratory.md",
    "docs/tutorials/ardupilot.md",
    "docs/tutorials/first-distance.md",
    "docs/tutorials/px4.md",
}
"""Documents whose commands find four sensors on an I2C bus and an autopilot on a UDP port, both emulated."""

ONE_SENSOR = {"msp-range address 0x70 0x71"}
"""Commands that the text says to give with one sensor connected."""

INSTEAD = {
    "make demo": "make --dry-run demo && msp-sim fly configs/scenarios/demo.yaml --out flights/demo --force",
    "make bench": "make --dry-run bench && python -m benchmarks rates",
    ".venv/bin/python -m benchmarks.bench_gap_coverage 40": "python -m benchmarks.bench_gap_coverage 1",
    "make fuzz": "make --dry-run fuzz && python -m tests.fuzz --seconds 0.2 --seed 1",
    "msp-range address 0x70 0x71": "yes | msp-range address 0x70 0x71",
    "msp-range doctor configs/loopback.yaml": "msp-range doctor configs/loopback.yaml || test $? = 1",
    "msp-range run configs/loopback.yaml --no-record": (
        f"{ENDED_BY} INT 4 msp-range run configs/loopback.yaml --no-record"
    ),
    "msp-range doctor my_airframe.yaml": "msp-range doctor my_airframe.yaml || test $? = 1",
    "msp-range params my_airframe.yaml --compare": f"msp-range params my_airframe.yaml --compare {LINK} || test $? = 1",
    "msp-range params my_airframe.yaml --write": f"yes | msp-range params my_airframe.yaml --write {LINK}",
    "msp-range run my_airframe.yaml": f"{ENDED_BY} INT 4 msp-range run my_airframe.yaml {LINK} --record recordings",
    "msp-range run my_airframe.yaml --log json --record /var/lib/msp-range": (
        f"{ENDED_BY} TERM 4 msp-range run my_airframe.yaml --log json --record recordings"
    ),
    ".venv/bin/msp-lab gap flights/[1-6]/flight.mcap --model MODEL.yaml --out gap --until add": (
        ".venv/bin/msp-lab gap flights/[1-6]/flight.mcap --model MODEL.yaml --out gap --until compare"
    ),
    "msp-lab gap one.csv two.csv --model configs/sensors/mb1242.yaml --each log --jobs 2 --out gaps": (
        "msp-lab gap one.csv two.csv --model configs/sensors/mb1242.yaml --each log --jobs 2 --out gaps --until compare"
    ),
    "msp-range tune FLIGHT.mcap [MORE.mcap ...]": "msp-range tune 1.mcap 2.mcap",
    "msp-sim fly configs/scenarios/hover.yaml --realtime --link udpout:127.0.0.1:14550": (
        f"{ENDED_BY} INT 4 "
        "msp-sim fly configs/scenarios/hover.yaml --realtime --link udpout:127.0.0.1:14550 || test $? = 130"
    ),
    ".venv/bin/msp-lab compare ../shared/data/enmt482/training1.csv --map reading_cm=sonar2 --map true_range_cm=range "
    "--model configs/sensors/mb1433.yaml --out build/guide/wrong": (
        "msp-lab compare ../shared/data/enmt482/training1.csv --map reading_cm=sonar2 --map true_range_cm=range "
        "--model configs/sensors/mb1433.yaml --out build/guide/wrong || test $? = 3"
    ),
    "python -m tests.soak --hours ...": "python -m tests.soak --hours 0.02 --minutes 0 --seed 1",
    ".venv/bin/python -m tests.faults --only one two --flights 700 --seed 2": (
        "python -m tests.faults --only one two --flights 2 --seed 2 --jobs 1"
    ),
}
"""Commands as they are run where the shown one runs for minutes or for ever, asks for a person's yes, or ends with the
message that the document shows."""

ELSEWHERE = {
    "msp-lab design gaps/june --bench ...": "tests/loop/test_design.py",
    "msp-lab collect gaps/june/design/1-.../campaign.yaml --out new": "tests/peers/test_collect_kernel.py",
    "msp-lab gap OLD.csv new/readings.csv --model MODEL.yaml --out gaps/july": "tests/loop/test_gap.py",
    "msp-lab gap one.csv two.csv --model configs/sensors/mb1242.yaml --each log ...": "tests/unit/test_gap_separate.py",
    "msp-lab import logs/*/*.BIN --truth rtk --out readings": "tests/unit/test_logs_import.py",
    "msp-lab fleet readings --model configs/sensors/mb1242.yaml --out fleet": "tests/loop/test_fleet.py",
    "msp-lab import logs/*/*.BIN --truth rtk ...": "tests/unit/test_logs_import.py",
    "msp-lab fleet readings ...": "tests/loop/test_fleet.py",
    "dask scheduler ...": "tests/unit/test_workers.py",
    "dask worker ...": "tests/unit/test_workers.py",
    "msp-sim monte-carlo rough_grass --flights 5 --scheduler ...": "tests/unit/test_workers.py",
    "python -m tests.blind ...": "tests/unit/test_blind_run.py",
    ".venv/bin/python -m tests.blind ...": "tests/unit/test_blind_run.py",
    "make check": ".ci/run",
    "make test": ".ci/run",
    ".venv/bin/pip install -e '.[bench]'": "Makefile",
    "pip install 'msp-range[lab,logs]'": "tests/loop/test_wheel.py",
    "sudo ./install.sh": "tests/install/__main__.py",
    "make test-install": "tests/install/__main__.py",
    "make gap-demo": "tests/loop/test_gap_demo.py",
    ".venv/bin/msp-lab collect configs/campaigns/table_4_1.yaml --simulate --out campaign": (
        "tests/loop/test_collect.py"
    ),
    ".venv/bin/msp-lab characterise campaign/readings.csv --out model.yaml --report report": (
        "tests/unit/test_characterise_page.py"
    ),
    "msp-lab collect configs/campaigns/table_4_1.yaml --simulate --out campaigns/simulated": (
        "tests/loop/test_collect.py"
    ),
    "msp-lab collect configs/campaigns/afternoon.yaml --out campaigns/mine": "tests/peers/test_collect_kernel.py",
    "msp-lab collect CAMPAIGN --out FOLDER --only baseline": "tests/loop/test_collect.py",
    "msp-lab collect CAMPAIGN --out FOLDER --repeat material-asphalt": "tests/loop/test_collect.py",
    "msp-lab characterise campaigns/simulated/readings.csv --out models/mine.yaml --report reports/mine": (
        "tests/unit/test_characterise_page.py"
    ),
    "make blind N=200 SEED=1": "tests/unit/test_blind_run.py",
    "make second N=20 SEED=1": "tests/unit/test_second_hand_score.py",
    "make others N=20 SEED=1": "tests/loop/test_gap_others.py",
    "make soak": "tests/loop/test_soak.py",
    "make faults": "tests/loop/test_faults_campaign.py",
    ".venv/bin/python -m tests.faults --again 1:499 --out flights/499": "tests/loop/test_faults_campaign.py",
    ".venv/bin/python -m benchmarks.blind_peers 20 1": "tests/peers/test_blind_peers.py",
    ".venv/bin/python -m benchmarks.blind_peers.power 40 1": "tests/peers/test_blind_peers.py",
    "msp-sim sample model.yaml --contexts c.csv --out readings.csv --effects supply_sag.py": (
        "tests/loop/test_third_party.py"
    ),
    "msp-lab gap readings.csv --model mb1242.yaml --out gap --effects supply_sag.py": "tests/loop/test_third_party.py",
    "msp-sim fly demo --model gap/model.yaml --effects supply_sag.py": "tests/loop/test_third_party.py",
    "msp-lab filters --out study": "tests/unit/test_filter_study.py",
    "msp-lab filters --table mine.csv": "tests/unit/test_filter_study.py",
    "msp-lab gap flights/*.csv --model configs/sensors/mb1242.yaml --out gaps/june": "tests/loop/test_gap.py",
    "msp-lab compare flights/*.csv --model MODEL.yaml --out DIR": "tests/loop/test_gap.py",
    "msp-lab name DIR": "tests/loop/test_gap.py",
    "msp-lab add DIR": "tests/loop/test_gap.py",
    "msp-lab show DIR": "tests/loop/test_gap.py",
    ".venv/bin/msp-lab gap flight-*.mcap --truth others --model configs/sensors/mb1242.yaml --out gap": (
        "tests/loop/test_gap_others.py"
    ),
    ".venv/bin/msp-lab gap FLIGHT.mcap --truth others --model configs/sensors/mb1242.yaml --out gap": (
        "tests/loop/test_gap_others.py"
    ),
    "msp-lab gap ../shared/data/hcsr04-ccu/readings.csv --model configs/sensors/hcsr04.yaml "
    "--map configs/maps/hcsr04-ccu.yaml --out build/ruler": "tests/recovery/test_gap_real_data.py",
    "msp-lab gap ../shared/data/crazyflie-terrain/log07.csv --model configs/sensors/tof_ranger.yaml "
    "--map tests/real/maps/terrain.yaml --out build/terrain": "tests/recovery/test_gap_real_data.py",
    "msp-lab gap ../shared/data/enmt482/training1.csv --model configs/sensors/mb1433.yaml "
    "--map configs/maps/enmt482-sonar2.yaml --out build/robot_mb1433": "tests/recovery/test_gap_real_data.py",
    "msp-range commission my_airframe.yaml": "tests/loop/test_commission.py",
    "sudo msp-range sign my_airframe.yaml": "tests/sitl/test_signing.py",
    "msp-lab import FILE... --out DATASET [--truth SOURCE]": "tests/unit/test_logs_import.py",
    "msp-lab gap DATASET --model configs/sensors/mb1242.yaml --out gap": "tests/unit/test_logs_import.py",
    "msp-sim sitl AIRFRAME.yaml --link URL [--autopilot ardupilot|px4] [--model MODEL.yaml] [--seed N]": (
        "tests/loop/test_sitl_verb.py"
    ),
    "[--ground SCENARIO.yaml] [--ground-clearance M] [--duration S] [--record DIR] [--out DIR [--force]]": (
        "tests/loop/test_sitl_verb.py"
    ),
    "sim_vehicle.py -v ArduCopter --add-param-file=range.parm": "tests/sitl/test_ardupilot.py",
    "msp-sim sitl configs/loopback.yaml --link tcp:127.0.0.1:5762": "tests/sitl/test_ardupilot.py",
    "arducopter --model + --speedup 1 --home -35.363262,149.165237,584,0 --defaults copter.parm,range.parm": (
        "tests/sitl/test_ardupilot.py"
    ),
    "sim_vehicle.py -v ArduCopter --add-param-file=range.parm --custom-location=-35.363262,149.165237,584,0": (
        "tests/sitl/test_ardupilot.py"
    ),
    "msp-sim sitl configs/proximity.yaml --ground configs/scenarios/proximity.yaml --link tcp:127.0.0.1:5762": (
        "tests/sitl/test_ardupilot.py"
    ),
    "make px4_sitl sihsim_quadx": "tests/sitl/test_px4.py",
    "msp-sim sitl configs/loopback.yaml --autopilot px4 --link udpin:0.0.0.0:14540": "tests/sitl/test_px4.py",
    "python -m pytest tests/sitl": ".ci/run",
    "journalctl -u msp-range | grep 'web page'": "tests/install/__main__.py",
    "msp-range status": "tests/peers/test_page.py",
    ".venv/bin/python -m tests.real.run drone_columns": "tests/real/test_sets.py",
}
"""Commands that are not run here, and the test that runs the same: it needs a person, root, another program or minutes,
or does it already."""

NOT_RUN = {
    "ssh -L 8642:127.0.0.1:8642 pi@vehicle": "needs a second computer",
}
"""Commands that nothing here can run, each with the reason."""


def found(table: Mapping[str, str], command: str) -> str | None:
    """What a table has for a command; None: nothing."""
    for key, value in table.items():
        if command == key or (key.endswith(" ...") and command.startswith(key.removesuffix("..."))):
            return value
    return None
