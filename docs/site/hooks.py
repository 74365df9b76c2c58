"""Hooks of the site: notebooks, the README's first steps, changelog and history become pages.

The page in which robots run is one of its files. Links out of docs/ lead there or become code.
"""

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.web.robots import make_files

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "notebooks"
PLAYED = ("drive", "run", "walk", "rough")  # packaged policies on the site's page to play with
TO_NOTEBOOK = re.compile(r"\]\(\.\./notebooks/(\w+)\.ipynb\)")
TO_ROOT = {
    "](../README.md)": "](quickstart.md)",
    "](../CHANGELOG.md)": "](changelog.md)",
    "](../studies/history.md": "](history.md",
}
OUTWARD = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)[^)]*\)")
# In a notebook: links to another, and to a page of docs/
BESIDE, TO_PAGE = re.compile(r"\]\((\w+)\.ipynb\)"), re.compile(r"\]\(\.\./docs/(\w+\.md[^)]*)\)")
MARKS = re.compile(r"<!-- (table: \w+|end) -->\n")  # of studies/tables.py
COLORS = re.compile(r"\x1b\[[0-9;]*m")  # of a terminal


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A page's text; links to files that are not part of the site as code."""
    if page.file.src_uri.startswith("notebooks/"):
        return markdown
    markdown = TO_NOTEBOOK.sub(r"](notebooks/\1.md)", MARKS.sub("", markdown))
    for link, page_of_it in TO_ROOT.items():
        markdown = markdown.replace(link, page_of_it)
    return OUTWARD.sub(
        lambda link: f"`{link[2]}`" if link[1] == link[2] else f"{link[1]} (`{link[2]}`)", markdown
    )


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The site's files, with each notebook as a page and its pictures beside it."""
    readme, changes = (
        (ROOT / name).read_text().replace("](docs/", "](") for name in ("README.md", "CHANGELOG.md")
    )
    first = [
        text
        for text in readme.split("\n## ")
        if text.startswith(("Try it", "Train it", "Your robot"))
    ]
    steps = "\n## ".join(["# Quickstart\n", *first])
    history = (ROOT / "studies" / "history.md").read_text().replace("](../docs/", "](")
    history = history.replace("](recipe/", "](../studies/recipe/")
    texts = {"quickstart.md": steps, "changelog.md": changes, "history.md": history}
    for name, text in texts.items():
        files.append(File.generated(config, name, content=text))
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        parts, pictures = [], {}
        for cell in json.loads(path.read_text())["cells"]:
            source = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                parts.append(TO_PAGE.sub(r"](../\1)", BESIDE.sub(r"](\1.md)", source)))
                continue
            parts.append(f"```python\n{source}\n```")
            for kind, content in shown(cell["outputs"]):
                if kind == "image/png":
                    name = f"{path.stem}_{len(pictures)}.png"
                    pictures[name] = base64.b64decode(content)
                    parts.append(f"![What the code above shows]({name})")
                else:
                    parts.append(f"```text\n{content.rstrip()}\n```")
        made: dict[str, str | bytes] = {f"{path.stem}.md": "\n\n".join(parts), **pictures}
        for name, data in made.items():
            files.append(File.generated(config, f"notebooks/{name}", content=data))
    for name, content in make_files([Run(PRETRAINED / run) for run in PLAYED], "last").items():
        files.append(File.generated(config, f"play/{name}", content=content))
    return files


def shown(outputs: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Kind and content of each output, in the form that says most."""
    for output in outputs:
        data = output.get("data", {"text/plain": output.get("text", "")})
        kind = "image/png" if "image/png" in data else "text/plain"
        yield kind, COLORS.sub("", "".join(data[kind]))
