"""The Markdown pages: every link and picture leads somewhere, and the README stays short."""

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
    prose = re.sub(r"```.*?```|^    .*$|`[^`\n]*`", "", text, flags=re.S | re.M)
    for link in re.findall(r"\]\(([^)\s]+)\)", prose):
        if "://" in link or link.startswith("mailto:"):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target.read_text()), link


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_bytes()) <= 7_000
