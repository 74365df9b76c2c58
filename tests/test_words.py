"""Words of pages, docstrings, comments, help and messages, as far as a machine can tell.

American spelling, zeros before the point, the field's words, and sentences that are not too long.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("studies/**/*.md")])
SOURCES = sorted(
    [*ROOT.glob("*.py"), *(file for part in ("quadwalk", "benchmarks", "studies") for file in
     (ROOT / part).rglob("*.py"))]
)  # fmt: skip
LONGEST = 30  # words of a sentence; a colon and a semicolon end one as well
# Written so, and what to write.
AVOID = {
    r"told|what (it|the robot) is to do": "commanded, set, reported",
    r"borne|suffers?|suffered": "withstands, conditions",
    r"judge[sd]?|judging": "evaluate",
    r"(go|goes|going|gone|went) on with": "resume, continue",
    r"who|whom|whose fall": "the episodes, robots or policies that",
    r"ha(s|ve) no word for": "cannot state",
    r"(is|are|has|have) but \w+": "only",
    r"half as wide again|as good as done": "by 50 %",
    r"learnt|burnt|spelt|misspelt|towards|backwards|fulfil|whilst|grey": "the American form",
    r"\w*(colour|behaviour|neighbour|favour|labour|honour)\w*": "-or",
    r"(kilo|centi|milli)?(metre|litre|centre)s?": "-er",
    r"(random|normal|initial|optim|minim|maxim|summar|recogn|penal|general|stabil|visual|serial"
    r"|regular|synchron|discret|linear|character|emphas|organ|real)is(e[ds]?|ing|ations?)": "-ize",
    r"analys(e|ed|ing)": "-yze",
    r"(model|label|travel|cancel|signal)l(ed|ing)|licences?|programmes?|catalogues?": "-led, -se",
}


def pages(text: str) -> Iterator[str]:
    """Paragraphs, items and cells of a Markdown page without code."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"^( {4}\S.*\n)+", "", text, flags=re.MULTILINE)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) |#|\|)", text):
        yield from block.strip("#|-* \n").split("|") if block.startswith("|") else [block]


def docstrings(source: str) -> Iterator[str]:
    """Paragraphs of a module's docstrings; an indented line, as of an argument, is one."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield from re.split(r"\n\s*\n|\n(?=\s+\S)", ast.get_docstring(node) or "")


def said(source: str) -> Iterator[str]:
    """Comments, and strings of several words: docstrings, help and messages."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.value


def plain(text: str) -> str:
    """`text` without what is in backticks, addresses of links, and pictures."""
    text = re.sub(r"`[^`]*`", "code", text)
    return " ".join(re.sub(r"!\[[^\]]*\]|(?<=\])\([^)]*\)", "", text).split())


def problems(text: str) -> Iterator[str]:
    """What is wrong with the words of `text`."""
    text = plain(text)
    for pattern, better in AVOID.items():
        for found in re.finditer(rf"\b(?:{pattern})\b", text, re.IGNORECASE):
            yield f"{found[0]!r}; expected {better}: {around(text, found)}"
    for found in re.finditer(r"(?:^|[ (~±|+-])\.\d", text):
        yield f"a number without its zero: {around(text, found)}"


def around(text: str, found: re.Match[str]) -> str:
    return text[max(found.start() - 40, 0) : found.end() + 40]


def too_long(text: str) -> Iterator[str]:
    """Sentences of more than `LONGEST` words."""
    for sentence in re.split(r"(?<=[\w)\]%\"*])[.!?:;] ", plain(text)):
        count = len(re.findall(r"\S*\w\S*", sentence))
        if count > LONGEST:
            yield f"{count} words; expected at most {LONGEST}: {sentence}"


def test_pages():
    found = [
        f"{page.relative_to(ROOT)}: {problem}"
        for page in PAGES
        if page.name != "CHANGELOG.md"  # it names what was called otherwise
        for part in pages(page.read_text())
        for problem in (*problems(part), *too_long(part))
    ]
    assert not found, "\n".join(found)


def test_sources():
    found = []
    for path in SOURCES:
        text = path.read_text()
        wrong = [problem for part in said(text) for problem in problems(part)]
        wrong += [problem for part in docstrings(text) for problem in too_long(part)]
        found += [f"{path.relative_to(ROOT)}: {problem}" for problem in wrong]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "The robot is told to walk.",
        "Level .5 is enough.",
        "Its behaviour is normalised.",
        "Who falls is judged.",
        "It goes on with a run.",
        f"A sentence {'and ' * LONGEST}an end.",
    ],
)
def test_a_sentence_to_mend_is_found(text):
    assert [*problems(text), *too_long(text)]


def test_a_plain_sentence_is_not():
    text = "The policy runs at 0.7 m/s on `.5`; its noise is realistic. Otherwise raise the limit."
    assert not [*problems(text), *too_long(text)]
