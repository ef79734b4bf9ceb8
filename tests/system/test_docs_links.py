"""Links of README, pages and docs lead somewhere on disk, so that they work on GitHub as on the site."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts)])
LINK = re.compile(r"!?\[[^\]]*\]\(\s*<?([^)>\s]+)>?\s*\)")
FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"``.*?``|`[^`]*`", re.DOTALL)
HEADING = re.compile(r"^#{1,6} (.+)$", re.MULTILINE)
MADE_BY_THE_BUILD = ("gallery/",)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and MyST make them."""
    found = HEADING.findall(FENCE.sub("", page.read_text(encoding="utf-8")))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in found}


@pytest.mark.parametrize("page", PAGES, ids=[p.relative_to(ROOT).as_posix() for p in PAGES])
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    text = CODE.sub("", FENCE.sub("", page.read_text(encoding="utf-8")))
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link) or link.startswith(MADE_BY_THE_BUILD):
            continue
        target, _, anchor = link.partition("#")
        file = (page.parent / target).resolve() if target else page
        assert file.exists(), link
        if anchor and file.suffix == ".md":
            assert anchor in anchors(file), link


def test_every_picture_of_the_site_is_shown_somewhere() -> None:
    shown = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    files = [p for p in (ROOT / "docs" / "pictures").iterdir() if p.suffix in (".png", ".webp", ".mp4")]
    assert {p.name for p in files if p.name not in shown} == set()


def test_bibliography_has_every_key_once_and_a_section() -> None:
    text = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")
    keys = re.findall(r"^@\w+\{(\w+),", text, re.MULTILINE)
    assert len(keys) == len(set(keys)) > 60
    page = (ROOT / "docs" / "reference" / "bibliography.md").read_text(encoding="utf-8")
    sections = set(re.findall(r'keywords % "(\w+)"', page))
    assert set(re.findall(r"keywords = \{(\w+)\}", text)) == sections


def test_reference_page_of_the_api_names_all_of_it() -> None:
    import evanesce

    page = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^   (\w+)$", page, re.MULTILINE)
    assert sorted(listed) == sorted(name for name in evanesce.__all__ if not name.startswith("__"))


def test_pages_together_stay_short() -> None:
    """At most 40,000 words in docs/, 2,000 on a page, or nobody reads them."""
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in PAGES if (ROOT / "docs") in page.parents}
    assert sum(words.values()) <= 40_000
    assert max(words.values()) <= 2_000
