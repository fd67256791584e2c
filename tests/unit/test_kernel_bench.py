"""A bench with real sensors: its thermometer, and what it opens."""

import os
import pty
from pathlib import Path

import pytest

from msp_lab.campaigns.bench import KernelBench
from msp_range.correction.temperature import FileSource
from msp_range.yaml_file import ConfigError
from tests.support.waiting import until


def test_a_bench_reads_its_thermometer_in_a_thread_and_refuses_no_jump(tmp_path: Path) -> None:
    """People put hot boxes over sensors there; and a slow thermometer must not delay the pings."""
    file = tmp_path / "temp1_input"
    file.write_text("21000")
    source = FileSource.model_validate(
        {"source": "file", "path": str(file), "period_s": 0.01, "max_age_s": 0.3, "bias_c": 1.0}
    )
    bench = KernelBench(str(tmp_path / "i2c-1"), [0x70], source)

    def read_until(expected_c: float | None) -> None:
        until(lambda: bench.air_c(bench.clock.now()) == expected_c, seen=lambda: bench.air_c(bench.clock.now()))

    read_until(20.0)
    file.write_text("48000")
    read_until(47.0)
    file.write_text("99000")
    read_until(None)
    file.write_text("22000")
    read_until(21.0)
    file.unlink()
    read_until(None)
    bench.close()


def test_a_bench_opens_the_ports_of_its_sensors_and_the_bus_only_for_one_on_it(tmp_path: Path) -> None:
    no_bus = str(tmp_path / "i2c-1")
    ends = pty.openpty()
    port = f"serial:{os.ttyname(ends[1])}:9600"
    bench = KernelBench(no_bus, [port], None)
    bench.open()
    with pytest.raises(ConfigError, match=f"{port}: cannot be opened: Device or resource busy; is it plugged in"):
        KernelBench(no_bus, [port], None).open()
    bench.close()
    with pytest.raises(ConfigError, match=f"{no_bus}: cannot be opened: No such file or directory; is I2C"):
        KernelBench(no_bus, [port, 0x70], None).open()
    for end in ends:
        os.close(end)
    with pytest.raises(ConfigError, match=f"{port}: cannot be opened: No such file or directory; is it plugged in"):
        KernelBench(no_bus, [port], None).open()
