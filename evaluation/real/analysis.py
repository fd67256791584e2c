"""What is in the measured sets, by numpy alone.

Written, and its table of names (`names.csv`) with it, before the gap workflow was run on the sets as they are tested
here. Residuals against every column, repeats, autocorrelation, and regressions with runs or stretches of time as
clusters, judged by clusters that were left out.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evaluation.real.columns import FloatArray, read_table, read_tilt, read_words
from evaluation.real.regress import (
    autocorrelation,
    hinges,
    print_bins,
    print_forms,
    print_jumps,
    regress,
    robust_sd,
    smooth_rate,
)


def data_folder() -> Path:
    """Where the measured sets are: `MSP_RANGE_DATA`, or next to the clone."""
    return Path(os.environ.get("MSP_RANGE_DATA", "../shared/data"))


def robot_hcsr04(data: Path) -> None:
    """The HC-SR04 of the robot before a wall."""
    for file in ("calibration", "training1"):
        table = read_table(data / "enmt482" / f"{file}.csv")
        z, r = 100.0 * table["range"], 100.0 * table["sonar1"]
        e = r - z
        hit = np.abs(e + 2.6) < 6.0
        print(f"  {file}: {z.size} readings, hits {hit.mean():.3f}; step of the readings 0.0172 cm (1 us)")
        print_bins("range", z[hit], e[hit], (0, 20, 40, 60, 80, 100, 140, 180, 220, 260, 300, 340))
        cluster = (table["time"] // 15.0).astype(int)[hit]
        x = z[hit] / 100.0
        print_forms(
            e[hit],
            {
                "nothing": [],
                "straight line": [x],
                "logarithm": [np.log(x)],
                "bend at 140 cm": hinges(x, (1.4,)),
                "curve": hinges(x, (0.3, 0.5, 0.8, 1.2, 1.6, 2.0, 2.5)),
            },
            cluster,
        )
        line = regress(e[hit], hinges(x, (0.3, 0.5, 0.8, 1.2, 1.6, 2.0, 2.5)), cluster)
        print(f"    autocorrelation of what the curve leaves: {autocorrelation(line.rest)}")
        rate = 100.0 * table["velocity_command"][hit]
        if np.ptp(rate) > 5.0:
            print_forms(line.rest, {"rate of the range [cm/s]": [rate]}, cluster)
        for low, high in ((10, 60), (60, 120), (120, 200), (200, 340)):
            both = hit[1:] & hit[:-1] & (z[1:] > low) & (z[1:] < high) & (np.abs(e[1:] + 2.6) < 3.0)
            print_jumps(f"at {low}-{high} cm", np.diff(e)[both])
        for name, which in (("short", (e < -8.6) & (r > 1.1)), ("no echo (1 and 800 cm)", (r < 1.1) | (r > 799.0))):
            shares = [f"{100.0 * which[(z >= low) & (z < low + 50)].mean():.1f}" for low in range(0, 350, 50)]
            print(f"    {name}, % by 50 cm of range: {' '.join(shares)}")
        moving = (np.abs(np.diff(z)) > 0.15) & hit[1:] & hit[:-1]
        print(f"    exact repeats while moving: {np.sum(np.diff(r)[moving] == 0)} of {moving.sum()}")


def robot_mb1433(data: Path) -> None:
    """The MB1433 of the same robot."""
    for file in ("calibration", "training1"):
        table = read_table(data / "enmt482" / f"{file}.csv")
        t, z, r = table["time"], 100.0 * table["range"], 100.0 * table["sonar2"]
        e = r - z
        fresh = np.r_[True, np.diff(r) != 0]
        moving = np.r_[False, np.abs(np.diff(z)) > 0.3]
        print(f"  {file}: {z.size} readings in steps of 0.1 cm, {np.diff(t).mean():.3f} s apart")
        if moving.sum() > 10:
            print(f"    repeats while the truth moves more than 0.3 cm: {(~fresh[moving]).mean():.3f}")
        print(f"    a new reading every {1.0 / fresh.mean():.2f} rows")
        far = (z > 35.0) & (np.abs(e) < 30.0) & (r > 30.05) & (r < 499.0)
        for name, rows in (("all", far), ("new", far & fresh), ("held", far & ~fresh)):
            fits = []
            for delay_s in np.arange(0.0, 0.8, 0.01):
                late = (r - np.interp(t - delay_s, t, z))[rows]
                fits.append((np.std(late - np.polyval(np.polyfit(z[rows], late, 1), z[rows])), delay_s))
            best, delay_s = min(fits)
            print(
                f"    {name}: least scatter {best:.2f} cm at an age of {1000.0 * delay_s:.0f} ms, {fits[0][0]:.2f} at 0"
            )
        rate = smooth_rate(z, t)
        command = 100.0 * table["velocity_command"]
        if np.ptp(command) > 5.0:
            print(f"    true rate over commanded rate: {np.polyfit(command, rate, 1)[0]:.2f}")
            print_forms(e[far], {"rate [cm/s], slope in s": [rate[far]]}, (t[far] // 10.0).astype(int))
        steady = (z > 35.0) & (np.abs(e) < 6.0)
        x, cluster = z[steady] / 100.0, (t[steady] // 15.0).astype(int)
        if np.ptp(command) < 5.0:
            forms = {"nothing": [], "straight line": [x], "logarithm": [np.log(x)], "bend at 225": hinges(x, (2.25,))}
            print_forms(e[steady], {**forms, "line and step at 225 cm": [x, 1.0 * (x > 2.25)]}, cluster)
            rest = regress(e[steady], [x, 1.0 * (x > 2.25)], cluster).rest
            print(f"    autocorrelation of the rest, row by row: {autocorrelation(rest)}")
            new = fresh[steady]
            print(f"    the same of new readings only: {autocorrelation(rest[new])}")
            print_bins("range", z[steady], rest, (35, 100, 160, 225, 280, 340))
        for low, high in ((0, 13), (13, 16), (16, 20), (20, 30), (30, 40), (40, 60)):
            here = r[(z >= low) & (z < high)]
            print(
                f"    true {low}-{high} cm (n {here.size}): reads 30 in {np.mean(here < 30.05):.2f}, "
                f"400 to 500 in {np.mean(here > 400):.2f}; median {np.median(here):.1f}"
            )


def drone_ranger(data: Path) -> None:
    """The time-of-flight ranger below a tilting drone, two flights."""
    for file in ("0425__TDOA2__0425-traj1", "0607__tdoa2-obs-log1"):
        table = read_table(data / "util-uwb" / f"{file}.csv")
        t, z, r = table["t_s"], 100.0 * table["mocap_z_m"], 100.0 * table["range_m"]
        cosine = np.clip(table["cos_tilt"], -1.0, 1.0)
        rate = smooth_rate(z, t)
        flying = z > 20.0
        e, cluster = (r - z)[flying], (t[flying] // 3.0).astype(int)
        print(f"  {file}: {flying.sum()} flying, {(~flying).sum()} on or near the ground, steps of 0.1 cm")
        print(f"    bias flying {e.mean():.2f} (sd {e.std():.2f}), near the ground {(r - z)[~flying].mean():.2f} cm")
        tilt = np.degrees(np.arccos(cosine))
        print(f"    tilt: median {np.median(tilt):.1f}, most {tilt.max():.1f} deg")
        columns = {
            "slant z (1 / cos - 1)": (z * (1.0 / cosine - 1.0))[flying],
            "range [m]": z[flying] / 100.0,
            "rate [m/s]": rate[flying] / 100.0,
            "mocap_x_m": table["mocap_x_m"][flying],
            "mocap_y_m": table["mocap_y_m"][flying],
            "roll z": (table["roll_rad"] * z)[flying],
            "pitch z": (table["pitch_rad"] * z)[flying],
            "time [min]": t[flying] / 60.0,
        }
        slant = columns["slant z (1 / cos - 1)"]
        print_forms(e, {"nothing": []} | {name: [each] for name, each in columns.items()}, cluster)
        print("    on top of slant:")
        print_forms(e, {name: [each] for name, each in columns.items() if each is not slant}, cluster, [slant])
        names = ("range [m]", "rate [m/s]", "mocap_y_m", "roll z", "pitch z")
        line = regress(e, [slant, *(columns[name] for name in names)], cluster)
        values = ", ".join(
            f"{name} {value:.2f} ({error:.2f})"
            for name, value, error in zip(("constant", "slant", *names), line.value, line.error, strict=True)
        )
        print(f"    all together: {values}; rms left {line.rest.std():.2f} cm")
        print(f"    autocorrelation of the rest: {autocorrelation(line.rest)}")
        print_bins("tilt", tilt[flying], line.rest, (0, 2, 4, 7, 10, 13, 21))
        print_bins("range", z[flying], line.rest, (20, 60, 100, 120, 140, 160, 180))
        print(f"    exact repeats: {np.mean(np.diff(r[flying]) == 0):.3f}")


def ruler_hcsr04(data: Path) -> None:
    """The HC-SR04 at ruler distances."""
    path = data / "hcsr04-ccu" / "readings.csv"
    table, files = read_table(path), read_words(path, "file")
    z, r, celsius = table["actual_cm"], table["measured_cm"], table["temp1_C"]
    e = r - z
    hit = np.abs(e + 1.0) < 2.6
    print(f"  {z.size} readings in {np.unique(files).size} files, hits {hit.mean():.3f}")
    _print_compensation(r, celsius, files)
    rows = hit & ~np.isnan(celsius)
    x, cluster = z[rows] / 100.0, np.unique(files[rows], return_inverse=True)[1]
    air = z[rows] * (np.sqrt(293.15 / (273.15 + celsius[rows])) - 1.0)
    curve = hinges(x, (0.04, 0.1, 0.2, 0.5, 0.8, 1.1))
    print_forms(
        e[rows],
        {
            "nothing": [],
            "straight line": [x],
            "logarithm": [np.log(x)],
            "bend at 100 cm": hinges(x, (1.0,)),
            "curve": curve,
            "curve and air temperature, share": [*curve, air],
        },
        cluster,
    )
    rest = regress(e[rows], curve, cluster).rest
    means = np.array([rest[cluster == k].mean() for k in range(cluster.max() + 1)])
    setup = np.unique(np.char.add(files, z.astype(str)), return_inverse=True)[1]
    inside, between = [], []
    for k in range(setup.max() + 1):
        here = hit & (setup == k)
        if here.sum() > 3:
            inside.append(e[here].std())
            between.append((rest[setup[rows] == k]).mean() if (setup[rows] == k).any() else np.nan)
    expected = np.nanstd(between) / np.sqrt(np.unique(setup).size / means.size)
    print(
        f"    sd inside a set-up (file and distance) {np.median(inside):.3f}, between them {np.nanstd(between):.3f} cm"
    )
    print(f"    sd between files {means.std():.3f}; {expected:.3f} if set-ups of a file are independent")
    same = (setup[1:] == setup[:-1]) & hit[1:] & hit[:-1]
    print_jumps("between readings of a set-up", np.diff(e)[same])
    counts = np.histogram(e[rows & (z <= 20)], np.arange(-1.75, 1.0, 0.125))[0]
    print(f"    residuals up to 20 cm, counts per 0.125 cm from -1.75: {counts.tolist()}")
    for low, high in ((0, 30), (30, 60), (60, 80), (80, 105), (105, 130), (130, 151)):
        here = (z >= low) & (z < high)
        out = {name: round(float((~hit)[here & (files == name)].mean()), 2) for name in np.unique(files[here & ~hit])}
        print(f"    {low}-{high} cm: not hit {(~hit)[here].mean():.3f}, by file {out}")


def _print_compensation(r: FloatArray, celsius: FloatArray, files: NDArray[np.str_]) -> None:
    """Whether readings are compensated for the temperature already."""
    print("    step of the readings against the air's temperature (a step of c 1 us / 2 means: already compensated):")
    for name in (
        "3_12MAR21/Results/3_ultraS_14cm_25ms.md",
        "26FEB21/ultraS_14cm_25ms.md",
        "3_03MAR21/ultraS_14cm_25ms_1.md",
    ):
        here = files == name
        gaps = np.diff(np.unique(r[here]))
        steps = np.arange(0.0168, 0.0180, 5e-7)
        best = steps[np.argmax([np.abs(np.exp(2j * np.pi * gaps / step).mean()) for step in steps])]
        air_c = np.nanmean(celsius[here])
        sound = 20.05 * np.sqrt(273.15 + air_c)
        print(f"      {name}: step {best:.5f} cm, so c = {2e4 * best:.1f} m/s; {air_c:.1f} C: {sound:.1f}")


def tilted_hcsr04(data: Path) -> None:
    """The HC-SR04 turned before a plate."""
    for name, distance_cm, angle, reading in read_tilt(data / "hcsr04-tilt" / "Misure_prove.csv"):
        cells = []
        for low in range(0, 50, 5):
            here = reading[(angle >= low) & (angle < low + 5)]
            near = here[here < 3.0 * distance_cm + 6.0]
            slant = distance_cm / np.cos(np.radians(low + 2))
            cells.append(
                f"{low}: {np.median(near) if near.size else np.nan:.0f} ({slant:.1f}), far {np.mean(here >= 50):.2f}"
            )
        print(
            f"  {name} cm, by 5 deg, median of the near readings (z / cos), share beyond 50 cm:\n    "
            + "; ".join(cells)
        )
        far = reading[reading >= 50]
        values, counts = np.unique(far, return_counts=True)
        most = np.argsort(-counts)[:6]
        print("    most frequent far readings: " + ", ".join(f"{values[k]:.0f} ({counts[k]})" for k in most))


def museum_lidar(data: Path) -> None:
    """Laser beams in a museum."""
    table = read_table(data / "carmen-fhw" / "fhw-pairs-derived.csv.gz")
    z, r = np.round(100.0 * table["expected_m"], 6), np.round(100.0 * table["measured_m"], 6)
    e = r - z
    hit = np.abs(e) <= 30.0
    print(f"  {z.size} beams, {np.unique(table['scan']).size} scans")
    print(f"    on a grid of 5 cm: readings {np.mean(r % 5 == 0):.3f}, truth {np.mean(z % 5 == 0):.3f}")
    print(f"    readings off it: last digit {np.unique((r[r % 5 != 0] % 5).round(2), return_counts=True)}")
    for low, high in ((0, 100), (100, 200), (200, 400), (400, 800), (800, 1600), (1600, 3200), (3200, 6000)):
        here = (z >= low) & (z < high)
        inside = e[here & hit]
        print(
            f"    {low}-{high} cm (n {here.sum()}): hits {hit[here].mean():.2f}, median {np.median(inside):.0f}, mean "
            f"{inside.mean():.1f}, sd {inside.std():.1f}, short {np.mean(e[here] < -30):.3f}, "
            f"nothing seen {np.mean(r[here] > 5000):.3f}"
        )
    inside = e[hit]
    scaled = (inside - inside.mean()) / inside.std()
    print(f"    kurtosis of hits {np.mean(scaled**4):.1f} (normal 3, cut at 30 cm less)")
    block = (table["scan"] // 25).astype(int)
    shares = [hit[block == k].mean() for k in np.unique(block)]
    print(f"    share of hits by 25 scans: {np.round(shares, 2).tolist()}")
    beams = [f"{low}: {e[hit & (table['beam'] // 20 == low // 20)].mean():.1f}" for low in range(0, 180, 20)]
    print(f"    mean of hits by beam: {', '.join(beams)} cm")
    cluster = (table["scan"] // 5).astype(int)[hit]
    x = z[hit] / 100.0
    print_forms(e[hit], {"nothing": [], "straight line": [x], "curve": hinges(x, (2.0, 4.0, 8.0, 16.0))}, cluster)


def terrain_ranger(data: Path) -> None:
    """A ranger over boxes, with the filter's own estimate for a truth."""
    table = read_table(data / "crazyflie-terrain" / "log07.csv")
    t, z, r = table["t_s"], 100.0 * table["est_z_m"], 100.0 * table["range_m"]
    e = r - z
    rate = np.gradient(z, t)
    for name, low, high in (
        ("ground", 0, 1),
        ("climb", 1.2, 2.6),
        ("floor", 3, 5.6),
        ("box", 5.8, 7.1),
        ("floor", 7.3, 8.6),
        ("box", 8.8, 11.7),
        ("floor", 11.9, 12.8),
        ("descent", 13, 14),
        ("ground", 14.5, 17),
    ):
        here = (t > low) & (t < high)
        slope = np.polyfit(z[here], r[here], 1)[0] if np.ptp(z[here]) > 0.5 else np.nan
        print(
            f"  {name} {low}-{high} s (n {here.sum()}): truth {z[here].mean():.1f}, reading {r[here].mean():.1f}, "
            f"residual {e[here].mean():.2f} (sd {e[here].std():.2f}), reading per truth {slope:.2f}"
        )
    moving = ((t > 1.2) & (t < 2.9)) | ((t > 12.9) & (t < 13.6))
    line = regress(e[moving], [rate[moving]], (t[moving] // 0.4).astype(int))
    print(f"  climb and descent: residual over rate {1000 * line.value[1]:.0f} ({1000 * line.error[1]:.0f}) ms")
    print(
        f"  share over boxes {np.mean(e < -10):.2f}; robust sd on the floor {robust_sd(e[(e > -3) & (z > 45)]):.2f} cm"
    )
    print(f"  est_x_m over boxes {np.percentile(table['est_x_m'][e < -10], [0, 50, 100])}")


SETS = {
    "enmt482 HC-SR04": robot_hcsr04,
    "enmt482 MB1433": robot_mb1433,
    "util-uwb": drone_ranger,
    "hcsr04-ccu": ruler_hcsr04,
    "hcsr04-tilt": tilted_hcsr04,
    "carmen-fhw": museum_lidar,
    "crazyflie-terrain": terrain_ranger,
}


def plot_all(data: Path, folder: Path) -> None:
    """Residual against each column of each set, as pictures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    folder.mkdir(parents=True, exist_ok=True)
    for file, reading, truth in (
        ("enmt482/calibration.csv", "sonar1", "range"),
        ("enmt482/calibration.csv", "sonar2", "range"),
        ("enmt482/training1.csv", "sonar1", "range"),
        ("enmt482/training1.csv", "sonar2", "range"),
        ("util-uwb/0425__TDOA2__0425-traj1.csv", "range_m", "mocap_z_m"),
        ("util-uwb/0607__tdoa2-obs-log1.csv", "range_m", "mocap_z_m"),
        ("hcsr04-ccu/readings.csv", "measured_cm", "actual_cm"),
        ("carmen-fhw/fhw-pairs-derived.csv.gz", "measured_m", "expected_m"),
        ("crazyflie-terrain/log07.csv", "range_m", "est_z_m"),
    ):
        table = read_table(data / file)
        e: FloatArray = (table[reading] - table[truth]) * (1.0 if reading.endswith("_cm") else 100.0)
        middle, width = np.median(e), 8.0 * robust_sd(e) + 1.0
        figure, axes = pyplot.subplots(1, len(table), figsize=(4 * len(table), 4))
        for axis, (name, column) in zip(axes, table.items(), strict=True):
            axis.plot(column, e, ".", markersize=2)
            axis.set(xlabel=name or "row", ylim=(middle - width, middle + width))
        axes[0].set_ylabel("reading - truth [cm]")
        figure.suptitle(f"{file} {reading}")
        figure.savefig(folder / f"{file.split('.')[0].replace('/', '-')}-{reading}.png", dpi=60)
        pyplot.close(figure)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--plots", type=Path, help="folder for pictures of residuals against each column")
    parser.add_argument("--only", choices=list(SETS), help="one set")


def main(given: argparse.Namespace) -> None:
    """Print what is in the sets, and draw it."""
    data = data_folder()
    if not data.exists():
        raise SystemExit(f"no measured data in {data}; MSP_RANGE_DATA names its folder")
    for name, analyse in SETS.items():
        if given.only in (None, name):
            print(name)
            analyse(data)
    if given.plots:
        plot_all(data, given.plots)
