"""The pages ask nothing of other hosts, and every link between them leads somewhere."""

import re
from functools import cache
from urllib.parse import unquote, urldefrag, urlsplit

from conftest import HTML, soup

LOADING = {
    *(("script", "src"), ("img", "src"), ("source", "src"), ("iframe", "src"), ("video", "src")),
    *(("audio", "src"), ("embed", "src"), ("object", "data"), ("img", "srcset")),
    *(("source", "srcset"), ("video", "poster"), ("link", "href"), ("image", "href")),
}
NOT_LOADED = {"canonical", "index", "search", "next", "prev", "author", "license"}  # <link rel=...>


def remote(url):
    return bool(re.match(r"(?:[a-z]+:)?//", url.strip(), re.I))


def test_a_page_loads_nothing_remote(page):
    for tag in soup(page).find_all(True):
        if tag.name == "link" and NOT_LOADED & set(tag.get("rel", [])):
            continue
        for name, attribute in LOADING:
            if tag.name == name and tag.has_attr(attribute):
                assert not remote(tag[attribute]), tag
        if tag.has_attr("style"):
            assert not re.search(r"url\(\s*['\"]?(?:https?:)?//", tag["style"]), tag
    for style in soup(page).find_all("style"):
        assert not re.search(r"@import|url\(\s*['\"]?(?:https?:)?//", style.text)
    for script in soup(page).find_all("script", src=False):
        assert not re.search(r"\bimport\b[^;]*['\"]https?://|importScripts", script.text)


def test_style_sheets_load_nothing_remote():
    sheets = list(HTML.rglob("*.css"))
    assert sheets
    for sheet in sheets:
        text = sheet.read_text("utf8")
        assert not re.search(r"url\(\s*['\"]?(?:https?:)?//", text), sheet
        assert not re.search(r"@import\s+(?:url\()?\s*['\"]?(?:https?:)?//", text), sheet


@cache
def anchors(page):
    return {tag["id"] for tag in soup(page).find_all(id=True)}


def test_links_of_a_page_lead_somewhere(page):
    for tag in soup(page).find_all("a", href=True):
        address, anchor = urldefrag(tag["href"])
        if urlsplit(address).scheme or address.startswith("//"):
            continue
        target = (HTML / page).parent / unquote(address) if address else HTML / page
        assert target.exists(), f"{page} links to {tag['href']}"
        if anchor and target.suffix == ".html":
            other = target.resolve().relative_to(HTML.resolve()).as_posix()
            assert unquote(anchor) in anchors(other), f"{page} links to {tag['href']}"


def test_the_book_begins_at_its_landing_page():
    (meta,) = soup("index.html").select("meta[http-equiv]")
    assert meta["content"].replace(" ", "").lower().endswith("url=book/intro.html")


def test_a_notebook_can_be_downloaded(page):
    source = HTML / "_sources" / page.replace(".html", ".ipynb")
    if not source.exists():
        return
    buttons = soup(page).select("a.btn-download-source-button")
    assert [b for b in buttons if ((HTML / page).parent / b["href"]).resolve() == source.resolve()]
    assert b'"nbformat": 4' in source.read_bytes()
