"""Pages: every link leads somewhere, every page is in the site, and the site can be made."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("slurm/*.md")])
# [text](target) and ![text](target); what is indented by four, fenced or in `..` is no link
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```$|^ {4}[^\n]*$|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def anchors(text):
    """What the headings of a page are called in a link."""
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def broken(page, text):
    """Links of a page that lead nowhere; those to other servers are not followed."""
    found = []
    for link in LINK.findall(CODE.sub("", text)):
        target, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link):
            continue
        path = page.parent / target if target else page
        if not path.exists() or (anchor and anchor not in anchors(path.read_text())):
            found.append(link)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    assert broken(page, page.read_text()) == []


def test_a_broken_link_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A page\n\n## The head\n")
    text = "[a](none.md) ![b](none.png) [c](#no-such-head) [d](page.md#the-head) `[e](none)`\n"
    assert broken(page, text) == ["none.md", "none.png", "#no-such-head"]
    code = "    [a](none.md)\n```\n[a](none.md)\n```\n[b](https://example.org/none)\n[c](no.md)"
    assert broken(page, code) == ["no.md"]


def test_the_site_has_every_page():
    listed = re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text())
    docs = ROOT / "docs"
    assert sorted(listed) == sorted(str(page.relative_to(docs)) for page in docs.glob("**/*.md"))


def test_the_site_is_made_without_a_warning(tmp_path):
    if not all(importlib.util.find_spec(name) for name in ("mkdocs", "material", "mkdocstrings")):
        pytest.skip("no mkdocs: pip install 'vgmpi[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path / "site")]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    made = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert made.returncode == 0, made.stdout + made.stderr
    assert (tmp_path / "site" / "explanation" / "time-step" / "index.html").is_file()
    page = (tmp_path / "site" / "reference" / "api" / "index.html").read_text()
    assert 'id="vgmpi.api.load"' in page
