"""The study of settings: what it says was tried can be tried again."""

import re
from pathlib import Path

from quadwalk.learn.flags import parse_config

RECIPE = Path(__file__).parents[2] / "studies" / "recipe" / "recipe.md"


def test_the_flags_that_were_tried_are_flags():
    tried = set(re.findall(r"^\| `(--[^`]*)` \|", RECIPE.read_text(), re.MULTILINE))
    assert len(tried) > 3
    default = parse_config([])
    assert all(parse_config(flags.split()) != default for flags in tried)
