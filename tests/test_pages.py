"""Pages that people read: links that lead somewhere, numbers and lengths by the project's rules."""

import importlib.util
import re
from pathlib import Path

import pytest

from quadwalk.cli import main

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("studies/**/*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```", re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Return the names of a page's headings in links, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", CODE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for link in LINK.findall(CODE.sub("", page.read_text())):
        if link.startswith(("https://", "http://")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_numbers_have_their_zero_and_lines_end(page):
    text = CODE.sub("", page.read_text())
    assert not re.findall(r"(?:^|[ (~±|])-?\.\d+", text, re.MULTILINE)
    long = [line for line in text.splitlines() if len(line) > 125 and not line.startswith("|")]
    assert not long


@pytest.mark.parametrize("name", ["settings", "api"])
def test_a_page_from_the_source_is_what_the_source_says(name):
    path = ROOT / "docs/site" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.format_page(), f"expected: python docs/site/{name}.py"
    assert "|  |" not in module.format_page()  # a setting without a word


def test_the_page_of_settings_has_every_flag_of_a_task_s_terms(capsys):
    with pytest.raises(SystemExit):  # of the help
        main.call_command(["train", "rough", "--help-all"])
    kinds = r"--env\.(?:reward|observation|critic|termination|action)\.[\w.-]+"
    help_flags = set(re.findall(kinds, capsys.readouterr().out))
    rows = (ROOT / "docs/settings.md").read_text().splitlines()
    heads = [row.split(" | ") for row in rows if " | rough | " in row]
    column = {head.index("rough") for head in heads}.pop()
    cells = [row.split(" | ") for row in rows if re.match(rf"\| `{kinds}`", row)]
    page_flags = {flag.strip("| `") for flag, *values in cells if values[column - 1] != "-"}
    histories = {flag for flag in help_flags if flag.endswith(".history")}  # listed where not 0
    assert page_flags | histories == help_flags
    assert "| `--env.reward.kneel` | - | - | - | - | -1 | -1 | - | - | - |" in "\n".join(rows)


def test_every_page_is_on_the_site():
    site_pages = set(re.findall(r"(\w+\.md)", (ROOT / "mkdocs.yml").read_text()))
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    other_pages = {"quickstart.md", "changelog.md", "history.md"}  # of files beside docs/
    assert site_pages == {f"{page.stem}.md" for page in pages} | other_pages


def test_the_readme_is_short():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 120
    assert len(text.split()) <= 900


def test_the_page_of_results_is_short_beside_its_tables():
    lines = (ROOT / "docs/results.md").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("|"))
    assert len(text.split()) <= 1000
