"""Hooks of the site: what links out of docs/ is named by its path in the repository."""

import re
from typing import Any

OUTWARD = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)[^)]*\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A page's text with links to files that are not part of the site as code."""
    return OUTWARD.sub(r"\1 (`\2`)", markdown)
