"""The numbers of a flight for ``summary.json`` and the table.

An error is a reading minus the truth at the time of its echo. Readings without a range or truth and readings at the
sensor's minimum are left out; for the fused distance so are times at which the ground differs between the sensors.
'Before' is the raw reading, also where the filters reject it, 'after' the filters' output, so that the counts differ.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from msp_sim.flight.flight_log import FlightResult, SensorTrack


def error_of(track: SensorTrack, value_m: list[float | None]) -> dict[str, float]:
    """Bias, root mean square, 95th percentile of the magnitude [cm], and the number of errors; only the number if it is
    0."""
    errors_cm = [
        (value - truth) * 100
        for truth, value, reason in zip(track.truth_m, value_m, track.why, strict=True)
        if truth is not None and value is not None and reason not in ("at_minimum", "edge")
    ]
    if not errors_cm:
        return {"count": 0}
    return {"count": len(errors_cm), **error_numbers(errors_cm)}


def error_numbers(errors_cm: Sequence[float]) -> dict[str, float]:
    """Bias, root mean square, and 95th percentile of the magnitude of errors, at least one [cm]."""
    errors = np.array(errors_cm)
    # Summed exactly, so that the last digit does not depend on the processor.
    bias_cm, rms_cm = math.fsum(errors) / errors.size, math.sqrt(math.fsum(errors**2) / errors.size)
    values = {"bias_cm": bias_cm, "rms_cm": rms_cm, "p95_cm": float(np.percentile(np.abs(errors), 95))}
    return {name: round(value, 3) for name, value in values.items()}


def summarise(flight: FlightResult, scenario: str, seed: int | None) -> dict[str, Any]:
    """The content of ``summary.json``: the same for the same scenario and seed, None for a recorded flight."""
    rejected = flight.rejected
    return {
        "scenario": scenario,
        "seed": seed,
        "duration_s": round(flight.duration_s, 6),
        "sensors": {
            name: {
                "readings": len(track.time_s),
                "rejected": dict(sorted(rejected[name].items())),
                "error_before": error_of(track, track.raw_m),
                "error_after": error_of(track, track.filtered_m),
            }
            for name, track in flight.tracks.items()
        },
        "fused": _fused(flight.fused),
        "link": {
            "sent": {
                name: {"messages": count, "rate_hz": round(count / flight.duration_s, 3) if flight.duration_s else 0.0}
                for name, count in sorted(flight.sent.items())
            },
            "dropped": dict(sorted(flight.dropped.items())),
            "autopilot_received": dict(sorted(flight.autopilot_received.items())),
            "sha256": flight.frames_sha256,
        },
        "texts": [
            {"time_s": round(time_s, 3), "severity": severity, "text": text} for time_s, severity, text in flight.texts
        ],
    }


def _fused(track: SensorTrack) -> dict[str, Any]:
    count = len(track.time_s)
    elapsed_s = track.time_s[-1] - track.time_s[0] if count > 1 else 0.0
    return {
        "estimates": count,
        "rate_hz": round((count - 1) / elapsed_s, 3) if elapsed_s else 0.0,
        "over_edges": track.why.count("edge"),
        "error": error_of(track, track.filtered_m),
    }
