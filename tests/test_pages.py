"""The Markdown pages: links, pictures and paths lead somewhere, messages are real."""

import ast
import re

import pytest
from answers import ROOT

SKIP = {".venv", ".gpu", "runs", "build", "node_modules", ".pytest_cache"}
PAGES = sorted(p for p in ROOT.rglob("*.md") if not SKIP & set(p.relative_to(ROOT).parts))


def anchors(text):
    """Of the headings of a page, as the usual sites make them."""
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    """Files and headings of this repository; addresses of the web are not asked."""
    text = page.read_text()
    prose = re.sub(r"```[\s\S]*?```|^    .*$|`[^`\n]*`", "", text, flags=re.M)
    for link in re.findall(r"\]\(([^)\s]+)\)", prose):
        if "://" in link or link.startswith("mailto:"):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target.read_text()), link


FILES = [p.relative_to(ROOT).parts for p in ROOT.rglob("*")]
FILES = [parts for parts in FILES if not SKIP & set(parts)]
ENDS = {"/".join(parts[i:]) for parts in FILES for i in range(len(parts))}
FOLDERS = {parts[0] for parts in FILES} | {
    parts[1]
    for parts in FILES
    if len(parts) > 2 and parts[0] in ("dynappo", "tests", "experiments")
}
OURS = [ROOT / "README.md", *ROOT.glob("docs/*.md"), ROOT / "tests" / "README.md"]
OURS += ROOT.glob("experiments/**/*.md")


@pytest.mark.parametrize("page", OURS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_path_in_a_page_is_there(page):
    """`folder/file`, from any folder down; pages of tests and experiments name their scripts alone too.

    A file that is gone is written `git show COMMIT:path`, or in a line with its commit.
    """
    within = page.relative_to(ROOT).parts
    alone = within[0] == "tests" or within[0] == "experiments" and len(within) > 2
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    for line in text.splitlines():
        if re.search(r"\b(?=\w*\d)[0-9a-f]{7,40}\b", line):
            continue
        for path in re.findall(r"`((?:[\w.-]+/)*[\w.-]+(?:/|\.\w+))`", line):
            path = re.sub(r"^(\.\./)+", "", path).rstrip("/")
            ours = path.split("/")[0] in FOLDERS if "/" in path else alone and path.endswith(".py")
            assert not ours or "NAME" in path or path in ENDS, path


def said():
    """All that dynappo can say: texts of its source, one a line, with `...` for what is put in."""
    for path in [*ROOT.glob("dynappo/**/*.py"), *ROOT.glob("configs/*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                yield "".join(
                    getattr(part, "value", "...") if isinstance(part, ast.Constant) else "..."
                    for part in node.values
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
    yield (ROOT / "Makefile").read_text()


def test_the_messages_in_troubleshooting_are_those_of_the_code():
    text, known = (ROOT / "docs" / "troubleshooting.md").read_text(), "\n".join(said())
    cells = re.findall(r"^\| (.*?) \| ", text, re.M)
    assert len(cells) > 20
    for message in (span for cell in cells for span in re.findall(r"`([^`]+)`", cell)):
        for piece in message.split("..."):
            assert piece.strip() in known, message
