"""Rules that results on random scenes must obey, each broken one as a sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

Record = dict[str, Any]
Value = Callable[[Record], "float | None"]
RIGHT = "right_1_percent"
MAX_LOSS = 0.01  # of right pixels, by edges or faces
LOSING_SHARE = 0.01  # of the scenes of a family may lose more
MIN_MEAN_F, MIN_LOW_F, LOW_PERCENTILE = 0.97, 0.90, 5  # of the edges of the family cad
# Against a baseline, the mean difference of a family may be worse than nothing by so many standard
# errors of the paired differences, and is never too small to count below that size.
STANDARD_ERRORS, LEAST_DIFFERENCE = 3.0, 0.001
# A scene changes much if a share changes by more. Of n such scenes, those that become worse may
# outnumber those that become better by that many square roots of n, as of coins.
LARGE_DIFFERENCE, COIN_DEVIATIONS = 0.05, 2.0


def of_mesh(mesh: str, figure: str) -> Value:
    """A figure of a mesh, None in a failed scene."""
    return lambda record: record["meshes"][mesh][figure] if "meshes" in record else None


def of_edges(figure: str) -> Value:
    """A figure of the edges, None in a failed scene or one without true curves."""
    return lambda record: (record.get("edges") or {}).get(figure)


COMPARED: dict[str, Value] = {  # shares that are better when larger
    "right at 1 % of meshes": of_mesh("patches", RIGHT),
    "right at 1 % of edges": of_mesh("edges", RIGHT),
    "coverage of meshes": of_mesh("patches", "coverage"),
    "normals within 10° of meshes": of_mesh("patches", "normals_10_deg"),
    "F of edges": of_edges("f_score"),
}


def broken_rules(records: Sequence[Record], baseline: Sequence[Record] = ()) -> list[str]:
    """The broken rules, of all scenes and of every family."""
    found = [f"{name_of(r)} failed: {r['failure']}" for r in records if "failure" in r]
    for family in families(records):
        ours = [record for record in records if record["family"] == family]
        found += losses(family, ours, "edges", "sfm")
        found += losses(family, ours, "faces", "edges")
        found += losses(family, ours, "patches", "faces")
        if family == "cad":
            found += low_scores(ours)
        found += worse(family, pairs(ours, baseline))
    return found


def name_of(record: Record) -> str:
    """Family and seed of a scene."""
    return f"{record['family']} {record['seed']}"


def families(records: Sequence[Record]) -> list[str]:
    """The families in order of appearance."""
    return list(dict.fromkeys(record["family"] for record in records))


def losses(family: str, records: Sequence[Record], mesh: str, simpler: str) -> Iterator[str]:
    """Whether more scenes of a family than allowed lose right pixels to a simpler mesh."""
    measured = [record for record in records if "meshes" in record]
    gains = {r["seed"]: r["meshes"][mesh][RIGHT] - r["meshes"][simpler][RIGHT] for r in measured}
    lost = sorted((gain, seed) for seed, gain in gains.items() if gain < -MAX_LOSS)
    if len(lost) > LOSING_SHARE * len(gains):
        yield (
            f"{family}: {mesh} lose more than {MAX_LOSS} of right pixels against {simpler} in "
            f"{len(lost)} of {len(gains)} scenes; most in seed {lost[0][1]}: {lost[0][0]:.3f}"
        )


def low_scores(records: Sequence[Record]) -> Iterator[str]:
    """Whether F of the edges is too low in the mean or in the worst scenes."""
    scores = [score for r in records if (score := of_edges("f_score")(r)) is not None]
    if not scores:
        return
    mean, low = float(np.mean(scores)), float(np.percentile(scores, LOW_PERCENTILE))
    if mean < MIN_MEAN_F:
        yield f"cad: mean F of edges is {mean:.3f}, below {MIN_MEAN_F}"
    if low < MIN_LOW_F:
        yield f"cad: {LOW_PERCENTILE}th percentile of F of edges is {low:.3f}, below {MIN_LOW_F}"


def pairs(records: Sequence[Record], baseline: Sequence[Record]) -> list[tuple[Record, Record]]:
    """Scenes with their results by the baseline."""
    known = {name_of(record): record for record in baseline}
    return [(r, known[name_of(r)]) for r in records if name_of(r) in known]


def differences(paired: Sequence[tuple[Record, Record]], value: Value) -> dict[int, float]:
    """Now minus baseline by seed, of the scenes in which both have a value."""
    found = {}
    for record, base in paired:
        now, before = value(record), value(base)
        if now is not None and before is not None and np.isfinite(now) and np.isfinite(before):
            found[record["seed"]] = now - before
    return found


def worse(family: str, paired: Sequence[tuple[Record, Record]]) -> Iterator[str]:
    """Which figures are worse than the baseline's beyond noise."""
    for name, value in COMPARED.items():
        by_seed = differences(paired, value)
        if not by_seed:
            continue
        changes = np.array(list(by_seed.values()))
        spread = changes.std(ddof=1) if len(changes) > 1 else MAX_LOSS
        limit = max(STANDARD_ERRORS * spread / np.sqrt(len(changes)), LEAST_DIFFERENCE)
        if changes.mean() < -limit:
            yield (
                f"{family}: {name} is worse than the baseline's by {-changes.mean():.4f} in the "
                f"mean of {len(changes)} scenes, noise {limit:.4f}"
            )
        lost, won = (changes < -LARGE_DIFFERENCE).sum(), (changes > LARGE_DIFFERENCE).sum()
        if lost - won > COIN_DEVIATIONS * np.sqrt(lost + won):
            worst = min(by_seed, key=by_seed.__getitem__)
            yield (
                f"{family}: {name} is worse than the baseline's by more than {LARGE_DIFFERENCE} in "
                f"{lost} scenes and better in {won}; worst is seed {worst}: {by_seed[worst]:.3f}"
            )
