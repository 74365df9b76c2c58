"""Words of pages, docstrings, comments, help and messages, as far as a machine can tell.

These are American spelling, zeros before the point, and the field's words. Sentences are not too
long, and functions' names and docstrings say what they do.
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
LONG = 22  # words of a sentence that is better split
MOST_LONG = 0.04  # share of such sentences
# A function's name and its docstring begin with one of these; properties and terms are nouns.
VERBS = """
    act adapt add advance anneal append apply assert average batch begin build call cast change
    check choose claim clip close collect command compare compile compose compute configure connect
    convert copy count create cross cut decide declare delete derive describe differentiate draw
    drive drop encode end enter estimate evaluate exclude execute exit explain export extract fail
    fetch fill find finish fit fix flatten flush follow format freeze gather generate get give go
    guess handle hash have hold identify import init integrate interpolate interrupt is has iterate
    join keep kill label lay learn leave let limit link list listen load locate lock log look main
    make map mark measure merge mirror move multiply name normalize note observe offset open order
    pack paint parse pin place plan play plot post prepare print process project prune publish push
    put raise randomize reach read record reduce refine refresh refuse register release remember
    remove rename render repeat replace replay report reset resize resolve restart restore resume
    retry return rewrite roll rotate round run sample save say scale scan search select send
    serialize serve set shape share show sign simulate slice smooth solve split stack stand start
    step stop strip subtract suggest sum summarize suppress swap sweep switch sync take test tile
    time to from trace track train transform transpose try tune turn update view wait warm warn
    watch wrap write yield
"""
OBLIQUE = ("of", "what", "how", "whether", "where", "as", "those", "its", "one", "that", "by")
# Percent of functions that are named for what they do, percent of docstrings that say it, and how
# many docstrings may open obliquely. Rooms that are behind may not fall back.
RATIOS = (80, 96, 0)
BEHIND = {
    "quadwalk/tasks": (80, 80, 1),
}
FOLDERS = sorted(path.parent.name for path in (ROOT / "quadwalk").glob("*/__init__.py"))
ROOMS = ["quadwalk", "benchmarks", "studies", *(f"quadwalk/{folder}" for folder in FOLDERS)]
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
    """Yield paragraphs, items and cells of a Markdown page without code."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"^( {4}\S.*\n)+", "", text, flags=re.MULTILINE)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) |#|\|)", text):
        yield from block.strip("#|-* \n").split("|") if block.startswith("|") else [block]


def docstrings(source: str) -> Iterator[str]:
    """Yield paragraphs of a module's docstrings; an indented line, as of an argument, is one."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield from re.split(r"\n\s*\n|\n(?=\s+\S)", ast.get_docstring(node) or "")


def find_texts(source: str) -> Iterator[str]:
    """Yield comments, and strings of several words: docstrings, help and messages."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.value


def plain(text: str) -> str:
    """Return `text` without what is in backticks, addresses of links, and pictures."""
    text = re.sub(r"`[^`]*`", "code", text)
    return " ".join(re.sub(r"!\[[^\]]*\]|(?<=\])\([^)]*\)", "", text).split())


def problems(text: str) -> Iterator[str]:
    """Yield a line for each problem with the words of `text`."""
    text = plain(text)
    for pattern, better in AVOID.items():
        for match in re.finditer(rf"\b(?:{pattern})\b", text, re.IGNORECASE):
            yield f"{match[0]!r}; expected {better}: {around(text, match)}"
    for match in re.finditer(r"(?:^|[ (~±|+-])\.\d", text):
        yield f"a number without its zero: {around(text, match)}"


def around(text: str, match: re.Match[str]) -> str:
    return text[max(match.start() - 40, 0) : match.end() + 40]


def too_long(text: str) -> Iterator[str]:
    """Yield a line for each sentence of more than `LONGEST` words."""
    for sentence in re.split(r"(?<=[\w)\]%\"*])[.!?:;] ", plain(text)):
        count = len(re.findall(r"\S*\w\S*", sentence))
        if count > LONGEST:
            yield f"{count} words; expected at most {LONGEST}: {sentence}"


def split_sentences(text: str) -> list[int]:
    """Return the numbers of words of the sentences of `text`."""
    sentences = re.split(r"(?<=[\w)\]%\"*])[.!?:;] ", plain(text))
    return [len(re.findall(r"\S*\w\S*", sentence)) for sentence in sentences]


def begins_with_verb(text: str) -> bool:
    """Return True if the first word is a verb, as it is or with an s."""
    word = re.split(r"[\W_]+", text.strip("_`"), maxsplit=1)[0].lower()
    return bool({word, word.removesuffix("s"), word.removesuffix("es")} & set(VERBS.split()))


def find_functions(room: str) -> Iterator[tuple[str, str, str]]:
    """Yield the place, the name and the docstring of a room's functions that are no terms."""
    pattern = "*.py" if room == "quadwalk" else "**/*.py"
    for path in sorted((ROOT / room).glob(pattern)):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("__"):
                continue
            decorators = " ".join(ast.unparse(decorator) for decorator in node.decorator_list)
            inputs = [argument.arg for argument in node.args.args[:2]]
            is_term = inputs in (["robot", "step"], ["robot", "state"], ["robot", "action"])
            if "property" not in decorators and not is_term:
                place = f"{path.relative_to(ROOT)}:{node.lineno}"
                yield place, node.name, ast.get_docstring(node) or ""


@pytest.mark.parametrize("room", ROOMS)
def test_functions_are_named_for_what_they_do(room):
    functions = list(find_functions(room))
    wrong = [f"{place} {name}" for place, name, _ in functions if not begins_with_verb(name)]
    least = BEHIND.get(room, RATIOS)[0]
    assert 100 * len(wrong) <= (100 - least) * len(functions), "\n".join(wrong)


@pytest.mark.parametrize("room", ROOMS)
def test_docstrings_say_what_functions_do(room):
    functions = [(place, text) for place, _, text in find_functions(room) if text]
    wrong = [f"{place} {text}" for place, text in functions if not begins_with_verb(text)]
    _, least, most_oblique = BEHIND.get(room, RATIOS)
    assert 100 * len(wrong) <= (100 - least) * len(functions), "\n".join(wrong)
    oblique = [f"{place} {text}" for place, text in functions if text.split()[0].lower() in OBLIQUE]
    assert len(oblique) <= most_oblique, "\n".join(oblique)


def test_few_sentences_are_long():
    counts = [
        count
        for path in SOURCES
        for part in docstrings(path.read_text())
        for count in split_sentences(part)
    ]
    assert sum(count > LONG for count in counts) <= MOST_LONG * len(counts)


def test_pages():
    lines = [
        f"{page.relative_to(ROOT)}: {problem}"
        for page in PAGES
        if page.name != "CHANGELOG.md"  # it names what was called otherwise
        for part in pages(page.read_text())
        for problem in (*problems(part), *too_long(part))
    ]
    assert not lines, "\n".join(lines)


def test_sources():
    lines = []
    for path in SOURCES:
        text = path.read_text()
        wrong = [problem for part in find_texts(text) for problem in problems(part)]
        wrong += [problem for part in docstrings(text) for problem in too_long(part)]
        lines += [f"{path.relative_to(ROOT)}: {problem}" for problem in wrong]
    assert not lines, "\n".join(lines)


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
