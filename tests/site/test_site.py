"""The site that `make site` builds: nothing from the network, no broken link, a whole reference, pages that fit."""

import re
import runpy
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from fovconn_env import PRESETS

pytest.importorskip("mkdocs")
griffe = pytest.importorskip("griffe")

ROOT = Path(__file__).parents[2]
SITE = ROOT / "out" / "site"
FLIGHTS = sorted((SITE / "flights").glob("*.html"))  # each is whole by itself: tests/render/test_page.py
PAGES = sorted({*SITE.rglob("*.html")} - {*FLIGHTS, SITE / "404.html"})  # that one is for a server
HOOKS = runpy.run_path(str(ROOT / "docs" / "site" / "hooks.py"))
WEB = ("http", "https", "mailto")
ARRAY = re.compile(r"ndarray|ArrayLike|Tensor")
# (B, N, 4), (n,), (..., M), (T - 1, 3), (B N, D): sizes in a bracket, a comma behind the first
SHAPE = re.compile(r"\((?:\.{3}|[A-Za-z](?: N| [-+] 1)?|\d+),(?: [\w() -]+,?)*\)")


class Page(HTMLParser):
    """What a page links to and loads, and the ids of its elements."""

    def __init__(self, file):
        super().__init__()
        self.ids, self.links, self.loaded = set(), [], []
        self.feed(file.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.ids |= {found[name] for name in ("id", "name") if found.get(name)}
        if tag == "a":
            self.links += [found["href"]] if "href" in found else []
        elif tag == "link" and found.get("rel") in ("next", "prev"):
            self.links.append(found["href"])
        else:
            self.loaded += [found[name] for name in ("src", "href", "poster", "data") if found.get(name)]


page_of = cache(Page)


def test_the_site_is_built_and_whole():
    names = {page.relative_to(SITE).as_posix() for page in PAGES}
    assert {"index.html", "quickstart.html", "changelog.html", "reference/fovconn_env.html"} <= names
    assert {f"{page.stem}.html" for page in (ROOT / "docs").glob("*.md")} <= names
    assert {page.stem for page in FLIGHTS} == set(PRESETS)
    cards = (SITE / "scenarios.html").read_text("utf-8")
    assert all(f'href="flights/{name}.html"' in cards for name in PRESETS)


def test_nothing_is_loaded_from_the_network():
    styles = "".join(style.read_text("utf-8") for style in SITE.rglob("*.css"))
    loaded = re.findall(r"url\(['\"]?([^)'\"]+)", styles) + re.findall(r"@import\s+['\"]([^'\"]+)", styles)
    loaded += [address for page in PAGES for address in page_of(page).loaded]
    assert len(loaded) > 100
    assert not {address for address in loaded if urlsplit(address).scheme in WEB or address.startswith("//")}


def test_no_link_is_broken():
    broken = []
    for page in PAGES:
        for link in {*page_of(page).links, *page_of(page).loaded}:
            parts = urlsplit(link)
            if parts.scheme in (*WEB, "data"):
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            found = target.is_file() and target.is_relative_to(SITE)
            if not found or (parts.fragment and unquote(parts.fragment) not in page_of(target).ids):
                broken.append(f"{page.relative_to(SITE)}: {link}")
    assert not broken


# --------------------------------------------------------------------------------------------------------- reference
@cache
def package():
    extensions = griffe.load_extensions(str(ROOT / "docs" / "site" / "comments.py"))
    return griffe.load("fovconn_env", search_paths=[ROOT], extensions=extensions, try_relative_path=False)


def documented(path):
    """A public name's object, and what of it the reference shows."""
    thing = package()[path.partition(".")[2]]
    thing = thing.final_target if thing.is_alias else thing
    yield path, thing
    if thing.is_class:
        for name, member in thing.members.items():
            if name == "__init__" or not name.startswith("_"):
                yield f"{path}.{name}", member


def says(thing):
    return thing.docstring.value if thing.docstring else ""


def undocumented(path):
    """Names without a docstring, and without shapes where they take or return arrays."""
    things = dict(documented(path))
    whole = says(things[path])
    for name, thing in things.items():
        text = says(thing)
        if thing.is_function:
            kinds = [str(parameter.annotation) for parameter in thing.parameters] + [str(thing.returns)]
        else:
            kinds = [str(getattr(thing, "annotation", ""))]
        if name.endswith("__init__") and "dataclass" in thing.parent.labels:
            continue  # made of its fields, which say theirs
        if name.endswith("__init__"):
            text += whole
        elif name == path and not text:
            yield f"{name} has no docstring"
        if any(map(ARRAY.search, kinds)) and not SHAPE.search(text):
            yield f"{name} says no shape: {' '.join(kinds)}"


def test_every_public_name_has_a_docstring_and_arrays_have_shapes():
    names = HOOKS["public"]()
    assert len(names) > 70
    assert not [problem for name in names for problem in undocumented(name)]


def test_the_reference_has_what_the_page_on_the_api_lists():
    text = (ROOT / "docs" / "api.md").read_text("utf-8").partition("## Public names")[2]
    rows = re.findall(r"^\| (`fovconn_env.*) \| (.*) \|$", text, re.MULTILINE)
    assert len(rows) >= 8
    for modules, names in rows:
        for module in re.findall(r"`([\w.]+)`", modules):
            path = module if module.startswith("fovconn_env") else f"fovconn_env{module}"
            listed = HOOKS["PUBLIC"][path]
            whole = "`__all__`" in names
            assert (listed is None) == whole, path
            assert whole or set(re.findall(r"`(\w+)`", names)) <= set(listed), path


def test_the_reference_shows_every_public_name():
    for path, module in HOOKS["public"]().items():
        assert path in page_of(SITE / "reference" / f"{module}.html").ids, path


# ----------------------------------------------------------------------------------------------------------- browser
@pytest.mark.parametrize("width", [360, 1280])
def test_pages_fit(browser, width):
    """No page is wider than the window, complains, or asks the network for anything."""
    wrong = []
    for page in PAGES:
        browser.open(page, size=(width, 800), mobile=width < 600, ready="document.readyState === 'complete'")
        browser.settle()
        wide = browser.evaluate("document.documentElement.scrollWidth")
        asked = [request for request in browser.requests if request.startswith("http")]
        if wide > width or browser.problems or asked:
            wrong.append((str(page.relative_to(SITE)), wide, browser.problems, asked))
    assert not wrong


def test_search_works_from_the_disk(browser):
    browser.open(SITE / "index.html", ready="document.readyState === 'complete'")
    browser.click("[data-md-component=search-query]")
    browser.call("Input.insertText", text="patience")
    browser.evaluate("document.activeElement.dispatchEvent(new Event('keyup'))")
    browser.wait("document.querySelector('.md-search-result__link')", seconds=60.0)
    assert ".html" in browser.evaluate("document.querySelector('.md-search-result__link').href")
