"""Results of studies: kept by variant and seed, whatever else is tried later."""

import json

import pytest

from quadwalk.errors import UserError
from studies.cases import Results


def test_a_result_takes_the_place_of_its_own_and_leaves_the_others(tmp_path):
    path = tmp_path / "results.json"
    first = Results(path, ["a", "b"])
    first.add({"variant": "b", "seed": 0, "speed": 1.0})
    first.add({"variant": "a", "seed": 1, "speed": 2.0})
    again = Results(path, ["a", "b"])
    again.add({"variant": "a", "seed": 0, "speed": 3.0})
    again.add({"variant": "b", "seed": 0, "speed": 4.0})
    results = [(r["variant"], r["seed"], r["speed"]) for r in json.loads(path.read_text())]
    assert results == [("a", 0, 3.0), ("a", 1, 2.0), ("b", 0, 4.0)]


@pytest.mark.parametrize("text", ["[1, 2", '{"a": 1}', '[{"variant": "c", "seed": 0}]', "[{}]"])
def test_a_file_that_is_something_else_is_named_and_left(tmp_path, text):
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(UserError, match=r"results\.json.*of variants a, b"):
        Results(path, ["a", "b"])
    assert path.read_text() == text
