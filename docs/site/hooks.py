"""Make pages of the site from notebooks, the README's first steps, the changelog and the history.

MkDocs calls the functions `on_...` of this file. The page in which robots run is one of the files.
Links out of docs/ lead to these pages or become code.
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
FIRST_STEPS = ("Try it", "Train it", "Your robot")  # sections of the README
# Links of the pages in docs/: to notebooks, to files that become pages, and to any other file.
NOTEBOOK_LINK = re.compile(r"\]\(\.\./notebooks/(\w+)\.ipynb\)")
LINKS_TO_MADE_PAGES = {
    "](../README.md)": "](quickstart.md)",
    "](../CHANGELOG.md)": "](changelog.md)",
    "](../studies/history.md": "](history.md",
}
OUTWARD_LINK = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)[^)]*\)")
# Links of the notebooks: to one another, and to pages in docs/.
SIBLING_LINK = re.compile(r"\]\((\w+)\.ipynb\)")
PAGE_LINK = re.compile(r"\]\(\.\./docs/(\w+\.md[^)]*)\)")
TABLE_MARKS = re.compile(r"<!-- (table: \w+|end) -->\n")  # studies/tables.py fills in between
TERMINAL_COLORS = re.compile(r"\x1b\[[0-9;]*m")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return the text of a page, with links to files outside the site as code."""
    if page.file.src_uri.startswith("notebooks/"):
        return markdown
    markdown = TABLE_MARKS.sub("", markdown)
    markdown = NOTEBOOK_LINK.sub(r"](notebooks/\1.md)", markdown)
    for link, site_link in LINKS_TO_MADE_PAGES.items():
        markdown = markdown.replace(link, site_link)
    return OUTWARD_LINK.sub(format_outward_link, markdown)


def format_outward_link(link: re.Match[str]) -> str:
    """Return the words of a link, and the path that it leads to as code."""
    words, path = link.groups()
    return f"`{path}`" if words == path else f"{words} (`{path}`)"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that this file makes, and the page in which robots run."""
    contents: dict[str, str | bytes] = {
        "quickstart.md": format_quickstart(),
        "changelog.md": read_page_of_root("CHANGELOG.md"),
        "history.md": format_history(),
    }
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        contents |= convert_notebook(path)
    contents |= make_play_page()
    for name, content in contents.items():
        files.append(File.generated(config, name, content=content))
    return files


def read_page_of_root(name: str) -> str:
    """Return a page of the repository's root with its links as they are from docs/."""
    return (ROOT / name).read_text().replace("](docs/", "](")


def format_quickstart() -> str:
    """Return the page of the README's first steps."""
    sections = read_page_of_root("README.md").split("\n## ")
    steps = [section for section in sections if section.startswith(FIRST_STEPS)]
    return "\n## ".join(["# Quickstart\n", *steps])


def format_history() -> str:
    """Return the page of the studies' history with its links as they are from docs/."""
    history = (ROOT / "studies" / "history.md").read_text().replace("](../docs/", "](")
    return history.replace("](recipe/", "](../studies/recipe/")


def make_play_page() -> dict[str, bytes]:
    """Return the files, by name, of the page in which robots run."""
    runs = [Run(PRETRAINED / name) for name in PLAYED]
    return {f"play/{name}": content for name, content in make_files(runs, "last").items()}


def convert_notebook(path: Path) -> dict[str, str | bytes]:
    """Return the files, by name, of a notebook: its page, and the pictures beside it."""
    parts: list[str] = []
    pictures: dict[str, str | bytes] = {}
    for cell in json.loads(path.read_text())["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(replace_notebook_links(source))
            continue
        parts.append(f"```python\n{source}\n```")
        for kind, content in read_outputs(cell["outputs"]):
            if kind == "image/png":
                name = f"{path.stem}_{len(pictures)}.png"
                pictures[f"notebooks/{name}"] = base64.b64decode(content)
                parts.append(f"![What the code above shows]({name})")
            else:
                parts.append(f"```text\n{content.rstrip()}\n```")
    return {f"notebooks/{path.stem}.md": "\n\n".join(parts), **pictures}


def replace_notebook_links(markdown: str) -> str:
    """Return the text of a notebook's cell with its links as they are on the site."""
    markdown = SIBLING_LINK.sub(r"](\1.md)", markdown)
    return PAGE_LINK.sub(r"](../\1)", markdown)


def read_outputs(outputs: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield the kind and the content of each output: its picture, or else its text."""
    for output in outputs:
        data = output.get("data", {"text/plain": output.get("text", "")})
        kind = "image/png" if "image/png" in data else "text/plain"
        yield kind, TERMINAL_COLORS.sub("", "".join(data[kind]))
