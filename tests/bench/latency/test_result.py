"""The file of a measurement: its schema, what is read back, and what is refused."""

from __future__ import annotations

import copy
import json
from dataclasses import asdict

import jsonschema
import pytest

from bench.latency.result import (
    LeftOut,
    Percentiles,
    Result,
    Row,
    Stream,
    Timer,
    read_result,
    schema,
    shipped_schema,
)
from scenarios import ScenarioError

TIMES = Percentiles(10.0, 20.0, 30.0, 40.0, 50.0, 9.0, 12.0, 14.0)


def a_row(**changes):
    given = {
        "backend": "daqp", "path": "interpreted", "horizon": 8, "axes": "x,y,z", "mode": "hot",
        "passes": 3, "instances": 5000, "recorded": 5000, "cut": None,
        **{f"{stage}_us": TIMES for stage in ("prepare", "update", "build", "solve", "step")},
        "response_us": Percentiles(), "lateness_us": Percentiles(), "pass_p50_us": [10.0, 10.1],
        "error": 1e-12, "without_reference": 0, "violation": {"force": 0.0}, "active_share": 0.29,
        "ratio_to_analytic": 1.2, "misses": 4, "missed_in_every_pass": 1,
        "status": {"solved": 5000}, "source": {"solution": 5000},
    }  # fmt: skip
    return Row(**(given | changes))


def a_result(*rows, **changes):
    given = {
        "scenario": "latency", "seed": 0, "period_us": 1000.0, "complete": True,
        "rows": list(rows) or [a_row(), a_row(mode="paced", response_us=TIMES, error=None)],
        "left_out": [LeftOut("ecos", None, None, None, None, "not installed")],
        "streams": [Stream("x,y,z", 8, 5000, 5000, 1e-12, 0.29, {"force": 0.1})],
        "timer": Timer("monotonic_ns", 40.0, 50.0, "clock_nanosleep"),
        "machine": {"cpu": "one", "versions": {"numpy": "2"}},
    }  # fmt: skip
    return Result(**(given | changes))


def test_the_shipped_schema_is_that_of_the_records():
    assert shipped_schema() == schema()
    jsonschema.Draft202012Validator.check_schema(shipped_schema())


def test_what_is_written_follows_the_schema_and_is_read_back(tmp_path):
    text = a_result().to_json()
    jsonschema.validate(json.loads(text), shipped_schema())
    (tmp_path / "a.json").write_text(text)
    assert read_result(tmp_path / "a.json") == a_result()
    # What a later version adds is nobody's error.
    more = json.loads(text) | {"more": 1}
    more["rows"][0]["more"] = 1
    jsonschema.validate(more, shipped_schema())
    (tmp_path / "a.json").write_text(json.dumps(more))
    assert read_result(tmp_path / "a.json") == a_result()


def edit(place, value):
    def apply(told):
        told = copy.deepcopy(told)
        *path, last = place
        inner = told
        for part in path:
            inner = inner[part]
        if value is None and not isinstance(inner, list):
            del inner[last]
        else:
            inner[last] = value
        return told

    return apply


WRONG = {
    "no rows": edit(["rows"], None),
    "rows is a number": edit(["rows"], 3),
    "a row is a word": edit(["rows", 0], "daqp"),
    "no backend": edit(["rows", 0, "backend"], None),
    "no step": edit(["rows", 1, "step_us"], None),
    "no p999": edit(["rows", 0, "step_us"], 3.0),
    "horizon 0": edit(["rows", 0, "horizon"], 0),
    "horizon is a word": edit(["rows", 0, "horizon"], "8"),
    "another mode": edit(["rows", 0, "mode"], "cold"),
    "another path": edit(["rows", 0, "path"], "assembled"),
    "negative time": edit(["rows", 0, "solve_us", "p50"], -1.0),
    "share above one": edit(["rows", 0, "active_share"], 1.5),
    "negative misses": edit(["rows", 0, "misses"], -1),
    "error is a word": edit(["rows", 0, "error"], "small"),
    "period 0": edit(["period_us"], 0.0),
    "no machine": edit(["machine"], None),
    "no timer": edit(["timer"], None),
    "no reason": edit(["left_out", 0, "reason"], None),
    "another schema": edit(["schema"], "pulsempc.latency/9"),
    "no schema": edit(["schema"], None),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_what_does_not_follow_the_schema_is_refused_by_both(change, tmp_path):
    told = change(json.loads(a_result().to_json()))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(told, shipped_schema())
    path = tmp_path / "a.json"
    path.write_text(json.dumps(told))
    with pytest.raises(ScenarioError) as error:
        read_result(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_rows_that_cannot_be_told_apart_have_keys_all_the_same():
    told = asdict(a_row(update_us=Percentiles()))
    assert told["update_us"] == dict.fromkeys(told["step_us"])
