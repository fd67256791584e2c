"""A short formula for a curve that was found.

It is made of knots, values and their standard errors.
"""

from collections.abc import Iterator

import numpy as np

from msp_range.arrays import Array


def formula(variable: str, at: Array, values: Array, deviation: Array) -> str:
    """The shortest form of a small grammar that goes through a curve, with its numbers.

    Parameters
    ----------
    variable
        Its name.
    at, values, deviation
        Knots, values there and their standard errors, (k,).
    """
    weight = 1.0 / np.maximum(deviation, 1e-9 + 1e-3 * np.abs(values).max(initial=0.0)) ** 2
    span = float(at[-1] - at[0]) or 1.0
    best: tuple[float, str] | None = None
    for text, columns, shapes in _grammar(variable, at, span):
        design = np.column_stack([np.ones(at.size), *columns])
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        misfit = float((weight * (values - design @ solution) ** 2).sum())
        cost = misfit + 2.0 * (design.shape[1] + shapes)
        if best is None or cost < best[0] - 1e-9:
            best = (cost, text.format(*(f"{each:.3g}" for each in solution)))
    return best[1].replace("+ -", "- ") if best else ""


def _grammar(variable: str, at: Array, span: float) -> Iterator[tuple[str, list[Array], int]]:
    yield f"{{0}} + {{1}} {variable}", [at], 0
    yield f"{{0}} + {{1}} {variable} + {{2}} {variable}^2", [at, at**2], 0
    for cycles in (0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0):
        wave = 2.0 * np.pi * cycles / span
        yield (
            f"{{0}} + {{1}} sin({wave:.3g} {variable}) + {{2}} cos({wave:.3g} {variable})",
            [np.sin(wave * at), np.cos(wave * at)],
            1,
        )
    for middle in (at[:-1] + at[1:]) / 2.0:
        yield f"{{0}} + {{1}} [{variable} > {middle:.3g}]", [(at > middle).astype(float)], 1
        yield (
            f"{{0}} + {{1}} tanh(({variable} - {middle:.3g}) / {span / 8:.3g})",
            [np.tanh((at - middle) / (span / 8))],
            2,
        )
    for length in (span / 8, span / 4, span / 2):
        yield (
            f"{{0}} + {{1}} exp(-{variable} / {length:.3g})",
            [np.exp(-(at - at[0]) / length) * np.exp(-at[0] / length)],
            1,
        )
    if variable.endswith("_deg") and np.all(np.abs(at) < 80.0):
        yield f"{{0}} + {{1}} / cos({variable})", [1.0 / np.cos(np.radians(at))], 0
