"""What works and what does not: conditions of sensors and of all else, and what is reported of them to the pilot."""

from msp_range.health.below import ObservationsBelow
from msp_range.health.bus import BusHealth
from msp_range.health.conditions import Health
from msp_range.health.expected import Expected
from msp_range.health.neighbours import GroundUse, Sighting
from msp_range.health.output import FUSED, OutputWatch
from msp_range.health.reminder import Reminder
from msp_range.health.sensor_watch import SensorWatch
from msp_range.health.verdict import BridgeState, BridgeVerdict, verdict_of
