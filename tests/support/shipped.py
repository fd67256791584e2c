"""What is shipped: the folder of configuration files, and the sensor of the report."""

from pathlib import Path

from msp_range.reading_model.sensor_model import load_sensor_model

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
MB1242 = CONFIGS / "sensors" / "mb1242.yaml"
SENSOR = load_sensor_model(MB1242)
