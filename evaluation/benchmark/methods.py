"""Methods that take part in the benchmark: a table and the model that is given enter, its findings leave.

What each may use is the same: contexts, readings, and the given model with its predictions. Those that name effects
choose from the same catalogue.
"""

import csv
import json
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest, norm, t

from evaluation.benchmark.slices import MODEL, slices_of
from evaluation.benchmark.stepwise import BASE, search
from evaluation.blind_peers.library import entries_of, log_prob
from evaluation.blind_peers.library import with_previous as complete
from evaluation.product import command
from evaluation.runner import Row
from msp_range.recording.csv_form import read_csv, write_csv
from msp_sim.model.model import load_model

HERE = Path(__file__).parent
NAMES = HERE / "names.csv"
ALPHA = 0.01
"""Probability of a false finding in a table, where a method asks for one: the default of `msp-lab gap`."""
SLICE_ALPHA = 0.05
"""The same of one slice among all of a table."""
PASTIS_SHARE = 0.001
"""Default of the authors' own program (StochasticForceInference, ``p_param``): a term costs the logarithm of the number
of terms over this (Gerardos and Ronceray, Principled model selection for stochastic dynamics, arXiv 2501.10339)."""
THRESHOLDS = np.arange(1.5, 8.1, 0.5)
"""From which PySINDy's is chosen: sizes of a term in its standard errors, were it alone."""
SR3_STEPS = 300
"""Ten times its default, with which it does not converge here."""
SEEN_NATS = 3.0
"""A slice is reported by a method that names effects where these gain so much in it: a likelihood ratio of 20."""
ALIKE = 0.95
"""Correlation from which two columns are one to PySINDy: with a scale and a bent scale at once it begins at hundreds of
per cent of each, and ends there."""
NOTHING = 1e-9
"""What an effect does less than, a constant does as well."""
FOLDS = 5
SHALLOW: Mapping[str, Any] = {"max_leaf_nodes": 3, "learning_rate": 0.05, "max_iter": 40, "min_samples_leaf": 60}
"""Of the boosted trees: the best of four settings tried on these tables, the default among them. Larger trees learn the
noise of 1,500 readings."""

Findings = dict[str, Any]


@dataclass(frozen=True)
class Table:
    """A frozen table: all its columns, those that are contexts, its readings, and the model that is given."""

    columns: Mapping[str, NDArray[Any]]
    model: Path

    @classmethod
    def of(cls, name: str) -> "Table":
        """The table of this name; rows without a reading are left out."""
        data = read_csv(HERE / "tables" / f"{name}.csv.gz")
        return cls(data.select(~np.isnan(data["reading_cm"])).columns, HERE / "models" / f"{name}.yaml")

    @property
    def contexts(self) -> dict[str, NDArray[Any]]:
        """Columns that a reading may depend on."""
        return {
            name: each for name, each in self.columns.items() if name != "reading_cm" and not name.startswith(MODEL)
        }


def find(method: str, name: str) -> Row:
    """Findings of a method in a table, with the seconds of a processor that it took."""
    table = Table.of(name)
    start_s = time.process_time()
    return METHODS[method](table) | {"seconds": round(time.process_time() - start_s, 2)}


def gap(table: Table, by_model: bool = False) -> Findings:
    """The product, with its defaults; where is what it says of slices, or where the effects of its model gain."""
    with TemporaryDirectory() as folder:
        measured, out = Path(folder) / "measured.csv", Path(folder) / "gap"
        write_csv(measured, table.contexts | {"reading_cm": table.columns["reading_cm"]})
        wrong = command("msp-lab", "gap", measured, "--model", table.model, "--out", out, "--until", "add")
        if wrong:
            raise RuntimeError(wrong)
        report = json.loads((out / "gap.json").read_text(encoding="utf-8"))
        found = load_model(out / "model.yaml")
    with NAMES.open(encoding="utf-8", newline="") as file:
        parameters = {row["name"]: row["parameter"] for row in csv.DictReader(file)}
    effects, unknown = [], [(each["channel"], column) for each in report["unknown"] for column in each["variables"]]
    for each in report["effects"]:
        if each["verdict"] not in ("named", "indistinguishable"):
            continue
        names = [each["name"], *(other["name"] for other in each["alternatives"])]
        # What a column of words or numbers of one's own does has the column's name.
        unknown += [("bias", name) for name in names if name not in parameters]
        if each["name"] in parameters:
            numbers = each["parameters"].get(parameters[each["name"]], {})
            known = {key: numbers[key] for key in ("value", "low", "high") if numbers.get(key) is not None}
            others = [name for name in names[1:] if name in parameters]
            effects.append({"name": names[0], "alternatives": others, **known})
    if by_model:
        contexts, reading_cm = complete(table.contexts, table.columns["reading_cm"]), table.columns["reading_cm"]
        without = replace(found, effects=load_model(table.model).effects)
        where = gaining(table, log_prob(found, contexts, reading_cm) - log_prob(without, contexts, reading_cm))
    else:
        where = [
            _region(each["where"], table)
            for each in report["slices"]
            if each["differs"] and len(each["variables"]) == 1 and each["where"].split()[0] in table.contexts
        ]
    # What gap calls time is a wander of the hits.
    curves = [{"channel": channel.replace("time", "bias"), "column": column} for channel, column in unknown]
    return {"effects": effects, "unknown": curves, "where": where}


def _region(words: str, table: Table) -> dict[str, Any]:
    """A slice of `gap.json` as a region: ``throttle 0.5 to 0.7``, ``battery 4``, or ``anchor a1``."""
    column, _, rest = words.partition(" ")
    if table.contexts[column].dtype.kind == "U":
        return {"column": column, "word": rest}
    low, _, high = rest.partition(" to ")
    return {"column": column, "low": float(low), "high": float(high or low)}


def gaining(table: Table, gain: NDArray[Any]) -> list[dict[str, Any]]:
    """Slices in which readings gain enough from what was found, each so many nats, (n,)."""
    return [region for region, rows in slices_of(table.contexts) if gain[rows].sum() > SEEN_NATS]


def stepwise(price: Callable[[int, int], float]) -> Callable[[Table], Findings]:
    """A method that takes what pays a price in nats, from the number of readings and that of the terms."""

    def method(table: Table) -> Findings:
        best, alone = search(load_model(table.model), table.contexts, table.columns["reading_cm"], price)
        found = zip((entry.effect.name for entry in best.entries), best.at[BASE:], best.errors, strict=True)
        return {"effects": _clearest(found), "where": gaining(table, best.log_p - alone.log_p)}

    return method


def _clearest(found: Iterable[tuple[str, float, float]]) -> list[dict[str, Any]]:
    """Names, values and standard errors as effects; of a name that came several times, as for several runs, one."""
    best: dict[str, tuple[float, float]] = {}
    for name, value, error in found:
        best[name] = max(best.get(name, (value, error)), (value, error), key=lambda each: abs(each[0]) / each[1])
    return [
        {"name": name, "value": float(value), "low": float(value - 1.96 * error), "high": float(value + 1.96 * error)}
        for name, (value, error) in best.items()
    ]


def sindy(optimizer: Callable[[Any, float], Any]) -> Callable[[Table], Findings]:
    """PySINDy on the hits' residuals: columns are what each effect that moves hits does to them, next to a constant.

    Of columns that are alike the one that is most like the residuals stays, as the optimizers begin with all of them at
    once. The threshold is that of the lowest BIC, and what it leaves is fitted by least squares, as PySINDy does.
    """

    def method(table: Table) -> Findings:
        from pysindy import optimizers

        model, contexts = load_model(table.model), table.contexts
        hits, sigma_cm = table.columns["model_hit"] > 0.5, table.columns["model_sigma_cm"]
        centre_cm = model.rows(contexts).centre_cm
        constant = 1.0 / sigma_cm[hits]

        def next_to_constant(values_cm: NDArray[Any]) -> NDArray[Any]:
            of_sigma: NDArray[Any] = (values_cm / sigma_cm)[hits]
            return of_sigma - constant * (of_sigma @ constant) / (constant @ constant)

        y = next_to_constant(table.columns["reading_cm"] - centre_cm)
        columns = []
        for entry in entries_of(contexts):
            if entry.effect.channels == ("bias",):
                step = entry.parameter.step
                column = next_to_constant(entry.added_to(model, step).rows(contexts).centre_cm - centre_cm) / step
                size = float(np.sqrt(column @ column))
                if size * step > NOTHING:
                    columns.append((entry.effect.name, size, column / size))
        names: list[str] = []
        sizes, unit = np.zeros(0), np.zeros((y.size, 0))
        for name, size, column in sorted(columns, key=lambda each: -abs(each[2] @ y)):
            if np.all(np.abs(column @ unit) < ALIKE):
                names, sizes, unit = [*names, name], np.append(sizes, size), np.column_stack([unit, column])
        best: tuple[float, NDArray[Any]] = (y.size * np.log(y @ y), np.zeros(0, dtype=int))
        for threshold in THRESHOLDS * np.sqrt(y @ y / y.size):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                terms = np.flatnonzero(optimizer(optimizers, threshold).fit(unit, y[:, None]).coef_.ravel())
            left = y - unit[:, terms] @ (np.linalg.pinv(unit[:, terms]) @ y)
            bic = y.size * np.log(left @ left) + np.log(y.size) * terms.size
            best = min(best, (float(bic), terms), key=lambda each: each[0])
        terms = best[1]
        inverse = np.linalg.pinv(unit[:, terms])
        values = inverse @ y
        left = y - unit[:, terms] @ values
        variance = left @ left / y.size
        errors = np.sqrt((inverse**2).sum(axis=1) * variance)
        gain = np.zeros(hits.size)
        gain[hits] = 0.5 * (y**2 - left**2) / variance
        found = zip([names[k] for k in terms], values / sizes[terms], errors / sizes[terms], strict=True)
        return {"effects": _clearest(found), "where": gaining(table, gain)}

    return method


def boosting(table: Table) -> Findings:
    """Boosted trees of the PIT's normal scores over all contexts, taught on other runs than those that they predict.

    Two of them, for the scores and for their size, say bias and spread; what counts is how much smaller their squared
    errors are, by runs. The column is the one whose permutation costs most.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.model_selection import GroupKFold

    columns = {name: each for name, each in table.contexts.items() if name not in ("run", "time_s")}
    run = np.unique(table.contexts["run"], return_inverse=True)[1]
    inputs = np.column_stack(
        [np.unique(each, return_inverse=True)[1] if each.dtype.kind == "U" else each for each in columns.values()]
    )
    score = norm.ppf(table.columns["model_pit"])
    rng, unknown, where = np.random.default_rng(1), [], []
    for channel, target in (("bias", score), ("spread", np.abs(score) - np.sqrt(2.0 / np.pi))):
        gain, cost = np.zeros(target.size), np.zeros(inputs.shape[1])
        for taught, asked in GroupKFold(FOLDS).split(inputs, groups=run):
            trees = HistGradientBoostingRegressor(**SHALLOW, random_state=1).fit(inputs[taught], target[taught])
            off = (target[asked] - trees.predict(inputs[asked])) ** 2
            gain[asked] = target[asked] ** 2 - off
            for k in range(inputs.shape[1]):
                mixed = inputs[asked].copy()
                mixed[:, k] = rng.permutation(mixed[:, k])
                cost[k] += np.sum((target[asked] - trees.predict(mixed)) ** 2 - off)
        if _p_by_runs(gain, run) > 0.5 * ALPHA:
            continue
        unknown.append({"channel": channel, "column": list(columns)[int(np.argmax(cost))]})
        pieces = list(slices_of(table.contexts))
        where += [region for region, rows in pieces if _p_by_runs(gain * rows, run) < SLICE_ALPHA / len(pieces)]
    return {"unknown": unknown, "where": where}


def _p_by_runs(gain: NDArray[Any], run: NDArray[np.intp]) -> float:
    """One-sided p-value of a mean above 0, by Student's t over the runs."""
    sums = np.bincount(run, gain)
    return float(t.sf(sums.mean() / (sums.std(ddof=1) / np.sqrt(sums.size) + 1e-12), sums.size - 1))


def pit_by_slice(table: Table) -> Findings:
    """Kolmogorov and Smirnov on the PIT in each slice, with Bonferroni."""
    pieces = list(slices_of(table.contexts))
    pit = table.columns["model_pit"]
    return {"where": [each for each, rows in pieces if kstest(pit[rows], "uniform").pvalue < SLICE_ALPHA / len(pieces)]}


def everywhere(table: Table) -> Findings:
    """All slices: what the others' F1 has to be compared with."""
    return {"where": [region for region, _ in slices_of(table.contexts)]}


METHODS: Mapping[str, Callable[[Table], Findings]] = {
    "msp-lab gap": gap,
    "msp-lab gap, slices by its model": partial(gap, by_model=True),
    "AIC, stepwise": stepwise(lambda n, terms: 1.0),
    "BIC, stepwise": stepwise(lambda n, terms: 0.5 * float(np.log(n))),
    "PASTIS, stepwise": stepwise(lambda n, terms: float(np.log(terms / PASTIS_SHARE))),
    "PySINDy, STLSQ": sindy(lambda module, threshold: module.STLSQ(threshold=threshold)),
    "PySINDy, SR3": sindy(
        lambda module, threshold: module.SR3(reg_weight_lam=0.5 * threshold**2, regularizer="L0", max_iter=SR3_STEPS)
    ),
    "boosted trees on PIT": boosting,
    "KS of PIT by slice": pit_by_slice,
    "all slices": everywhere,
}
NEEDS = {"PySINDy, STLSQ": "pysindy", "PySINDy, SR3": "pysindy", "boosted trees on PIT": "sklearn"}
"""Methods that need a package of the extra ``bench``."""
