"""What is shipped: the folder of configuration files, and the sensor of the report."""

from pathlib import Path

from msp_range.reading_model.sensor_model import load_sensor_model

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
MB1242 = CONFIGS / "sensors" / "mb1242.yaml"


def write_airframe(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """A shipped airframe with changes of its text, as a file of its owner."""
    text = (CONFIGS / f"{name}.yaml").read_text()
    for old, new in (("sensors/mb1242.yaml", "mb1242"), ("sensors/lidar_lite_v3.yaml", "lidar_lite_v3"), *changes):
        assert old in text or old.startswith("sensors/"), old
        text = text.replace(old, new)
    path = folder / "airframe.yaml"
    path.write_text(text)
    return path


SENSOR = load_sensor_model(MB1242)
