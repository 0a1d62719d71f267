import json

import isolation
import misbehaving
import pytest
import valid
from isolation import Job

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

RUNS = 16
SOAK_RUNS = 600


@pytest.fixture(scope="module")
def valid_inputs(tmp_path_factory):
    """The folder of a valid input of each kind."""
    folder = tmp_path_factory.mktemp("valid")
    for kind, write in valid.WRITERS.items():
        write(folder / kind)
    return {kind: folder / kind for kind in valid.WRITERS}


def test_damaged_input_ends_in_a_result_or_one_clear_line(valid_inputs, soak, show):
    """To read a failed input again: isolation.damaged_copy(Job(kind, source, seed), folder)."""
    seeds = range(SOAK_RUNS if soak else RUNS)
    jobs = [Job(kind, source, seed) for kind, source in valid_inputs.items() for seed in seeds]
    outcomes, failures = isolation.try_inputs(jobs)
    for kind in valid_inputs:
        counts = {outcome: outcomes[kind, outcome] for outcome in ("result", "error", "failure")}
        show(json.dumps({"kind": kind, **counts}))
    assert not failures, "\n".join(f"{f.kind} {f.seed}: {f.reason}" for f in failures[:5])
    assert sum(outcomes.values()) == len(jobs)


def test_failures_are_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(isolation, "MAX_SECONDS", 1.0)
    (tmp_path / "file").write_text("some text")
    jobs = [Job(kind, tmp_path, 0) for kind in misbehaving.READERS]
    outcomes, failures = isolation.try_inputs(jobs, "misbehaving")
    assert outcomes["well", "result"] == 1
    reasons = {failure.kind: failure.reason for failure in failures}
    assert reasons.keys() == misbehaving.READERS.keys() - {"well"}
    expected = {"crash": "killed", "hang": "longer", "memory": "MemoryError"}
    expected |= {"traceback": "IndexError", "many lines": "unclear"}
    assert all(word in reasons[kind] for kind, word in expected.items())
