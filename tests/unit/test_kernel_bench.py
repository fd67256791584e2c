"""The thermometer of a bench with real sensors."""

from pathlib import Path

from msp_lab.campaigns.bench import KernelBench
from msp_range.correction.temperature import FileSource
from tests.support.waiting import until


def test_a_bench_reads_its_thermometer_in_a_thread_and_refuses_no_jump(tmp_path: Path) -> None:
    """People put hot boxes over sensors there; and a slow thermometer must not delay the pings."""
    file = tmp_path / "temp1_input"
    file.write_text("21000")
    source = FileSource.model_validate(
        {"source": "file", "path": str(file), "period_s": 0.01, "max_age_s": 0.3, "bias_c": 1.0}
    )
    bench = KernelBench(str(tmp_path / "i2c-1"), source)

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
