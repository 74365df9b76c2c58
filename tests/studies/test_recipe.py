"""The study of settings: what it says was tried can be tried again."""

import re
from pathlib import Path

from quadwalk.train.flags import parse_config
from studies.recipe import recipe


def test_the_flags_that_were_tried_are_flags():
    text = Path(recipe.__file__).with_name("recipe.md").read_text()
    tried = set(re.findall(r"^\| `(--[^`]*)` \|", text, re.MULTILINE))
    assert len(tried) > 3
    default = parse_config([])
    assert all(parse_config(flags.split()) != default for flags in tried)
    heads = [row.strip("| ").split(" | ") for row in text.splitlines() if row.startswith("| flags")]
    assert heads
    assert all(tuple(head) == recipe.COLUMNS for head in heads)
