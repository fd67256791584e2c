"""Keep files of this version, which later versions have to read: ``make stored`` writes tests/stored/VERSION.

A recording, the readings of a session at the bench, the sensor model made of them, and all that configs/ has.
tests/release/test_stored.py reads those of every version.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from msp_range import __version__
from release import ROOT

STORED = ROOT / "tests/stored"


def run(program: str, *words: str | Path) -> None:
    """Run a command of this clone in silence."""
    subprocess.run([sys.executable, ROOT / "bin" / program, *words], check=True, stdout=subprocess.DEVNULL)


def main() -> int:
    """Write the files; the exit code."""
    folder = STORED / __version__
    if folder.exists():
        print(f"{folder} exists: what a version wrote is kept as it is", file=sys.stderr)
        return 3
    with TemporaryDirectory() as work:
        flight, bench, model = (Path(work) / name for name in ("flight", "bench", "model.yaml"))
        run("msp-sim", "fly", STORED / "flight.yaml", "--out", flight)
        run("msp-lab", "collect", STORED / "bench.yaml", "--simulate", "--out", bench)
        run("msp-lab", "characterise", bench / "readings.csv", "--out", model)
        shutil.copytree(ROOT / "configs", folder / "configs")
        for path in (flight / "flight.mcap", bench / "readings.csv", model):
            shutil.copy(path, folder)
    print(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
