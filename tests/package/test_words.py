"""Pages for users and messages speak the field's words, in short sentences: docs/contributing.md has the glossary."""

import ast
import re
from pathlib import Path

import robust_filterpy

ROOT = Path(__file__).parents[2]
PACKAGE = Path(robust_filterpy.__file__).parent
TO_READ = [
    ROOT / "README.md",
    *(ROOT / "docs" / f"{name}.md" for name in ("index", "choosing", "why", "troubleshooting", "fusion", "live")),
    *(ROOT / "docs" / f"{name}.md" for name in ("cheat_sheet", "glossary", "filterpy")),
    *sorted((ROOT / "docs" / "tutorial").glob("*.md")),
    *sorted((ROOT / "docs" / "situations").glob("*.md")),
]
#: The glossary itself has the words; the test bench's page is made from its docstrings.
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if page.name not in ("contributing.md", "testing.md")]
NOT_OURS = re.compile(
    r"\b(customs?|told|learnt|beside|insist\w*|strangers?|charged|rooms?|wander\w*|endless motion|"
    r"colour\w*|centred?|favour\w*|neighbour\w*|behaviour\w*|grey|metres?|labelled|modell\w+|\w+isations?|"
    r"(maxim|minim|optim|recogn|linear|normal|standard)is(e|ed|es|ing)|judgement)\b",
    re.IGNORECASE,
)


def without_code(text):
    """A page without programs, code in a line, raw HTML and targets of links."""
    text = re.sub(r"(?ms)^[ \t]*```.*?^[ \t]*```|<!--.*?-->", "\n\n", text)
    return re.sub(r"``[^`]*``|`[^`\n]*`", "code", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text))


def sentences(text):
    """The sentences of a page, an item of a list being one at least; headings and tables have none."""
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[*-]|\d+\.) )", without_code(text)):
        block = re.sub(r"^\s*(?:[*-]|\d+\.)\s+", "", block.strip())
        if block and block[0] not in "#|":
            yield from (part for part in re.split(r"(?<=[.!?])[*_]*\s+(?=[\w(\"'*])", " ".join(block.split())) if part)


def messages():
    """Texts of the package that are no docstrings, with where they stand; names of arguments in them are left out."""
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        silent = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in silent:
                if " " in node.value.strip():
                    said = re.sub(r"\blearnt:|Learnt\(|->\w+|`[^`]*`|'[^' ]*'|\"[^\" ]*\"", "", node.value)
                    yield f"{path.relative_to(PACKAGE)}:{node.lineno}", said


def test_sentences_are_short():
    wrong = []
    for page in TO_READ:
        read = list(sentences(page.read_text(encoding="utf-8")))
        lengths = [len(sentence.split()) for sentence in read]
        if sum(lengths) > 25 * len(lengths):
            wrong.append(f"{page.name}: {sum(lengths) / len(lengths):.1f} words a sentence")
        wrong += [f"{page.name}: {sentence}" for sentence, n in zip(read, lengths, strict=True) if n > 45]
        wrong += [
            f"{page.name}: {sentence}" for sentence in read if re.search(r"\)\s*\(|\([^)]*\([^)]*\)[^(]*\)", sentence)
        ]
    assert not wrong, "\n".join(wrong)


def test_the_field_s_words_are_used():
    every = list(messages())
    wrong = [f"{where}: {word[0]}: {said}" for where, said in every for word in NOT_OURS.finditer(said)]
    for page in PAGES:
        text = re.sub(r"\]\([^)]*\)", "]", without_code(page.read_text(encoding="utf-8")))
        wrong += [f"{page.name}: {word[0]}: {line}" for line in text.splitlines() for word in NOT_OURS.finditer(line)]
    assert len(every) > 1000 and not wrong, "\n".join(wrong)
