"""The bridge's state as Prometheus metrics, for ``/metrics``."""

from collections.abc import Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from msp_range.health import BridgeState
from msp_range.watch.facts import facts_of
from msp_range.watch.newest import Newest


class BridgeMetrics(Collector):
    """Metrics of a bridge's newest state; the state alone where no bridge runs.

    Parameters
    ----------
    newest
        The state.
    """

    def __init__(self, newest: Newest) -> None:
        self._newest = newest

    def collect(self) -> Iterator[Metric]:
        """All metrics."""
        newest, status = self._newest, self._newest.status
        is_good = newest.state in (BridgeState.STARTING, BridgeState.ACTIVE, BridgeState.SENDS_NOTHING)
        critical = "1 if a distance is missing, nobody gets it, or no bridge runs."
        yield GaugeMetricFamily("msp_range_critical", critical, float(not is_good))
        if not status:
            return
        readings = CounterMetricFamily("msp_range_readings", "Readings of each sensor.", labels=["sensor"])
        rejected = CounterMetricFamily(
            "msp_range_rejected", "Readings that were not used, by reason.", labels=["sensor", "reason"]
        )
        good = GaugeMetricFamily("msp_range_sensor_good", "1 if the sensor has no fault.", labels=["sensor"])
        distance = GaugeMetricFamily("msp_range_range_m", "Last corrected range of each sensor.", labels=["sensor"])
        for name, counts in status["sensors"].items():
            readings.add_metric([name], counts["readings"])
            good.add_metric([name], counts["fault"] is None)
            for reason, count in counts["rejected"].items():
                rejected.add_metric([name, reason], count)
            corrected_m = newest.readings.get(name, {}).get("corrected_m")
            if corrected_m is not None:
                distance.add_metric([name], corrected_m)
        labels = ["what", "severity", "cause"]
        wrong = GaugeMetricFamily("msp_range_fault", "1 for each fault; a cause has no cause.", labels=labels)
        for fault in status["faults"]:
            wrong.add_metric([fault[label] or "" for label in labels], 1)
        link = status["link"]
        sent = CounterMetricFamily("msp_range_messages_sent", "MAVLink messages sent.", labels=["message"])
        for name, count in link["sent"].items():
            sent.add_metric([name], count)
        yield from (readings, rejected, good, distance, wrong, sent)
        yield GaugeMetricFamily("msp_range_faults", "Faults at present.", len(status["faults"]))
        yield CounterMetricFamily("msp_range_frames_dropped", "Frames that the link did not take.", link["dropped"])
        for fact in facts_of(newest):
            for name, (help_text, value) in fact.gauges.items():
                yield GaugeMetricFamily(name, help_text, float(value))
