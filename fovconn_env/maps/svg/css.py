"""Style sheets of a drawing: which declarations they hold for an element, by element name, class and id."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from fovconn_env.maps.svg.document import DRAWN, Element, drawing_rule

MAX_RULES = 10_000  # of a drawing, a selector each
MAX_TESTS = 300_000  # of a rule against an element
_MAX_DEPTH = 4  # of blocks in blocks
_COMMENT = re.compile(r"/\*.*?(?:\*/|\Z)", re.DOTALL)
_PIECE = re.compile(r""""[^"]*"?|'[^']*'?|[{};]|[^"'{};]+""")
_DECLARATION = re.compile(r"""(?:[^;"'(]++|"[^"]*+"?|'[^']*+'?|\([^)]*+\)?)++""")
_SELECTOR = re.compile(r"(\*|[^\W\d][\w-]*)?((?:[.#]-?[^\W\d][\w-]*)*)")
_NEVER = re.compile(
    r":(hover|focus|focus-visible|focus-within|active|visited|target|before|after|selection|-[\w-]+)\b|::"
)
_ALWAYS = ("", "all", "screen")
_HINT = "give the elements attributes instead"
_OTHER_MEDIA = re.compile(
    r"(only )?(print|speech|aural|braille|handheld|projection|tty|tv)\b.*|.*prefers-color-scheme:\s*dark.*"
)
_HARMLESS = re.compile(r"@(font-face|import|charset|namespace|page|(-\w+-)?keyframes|counter-style|property)\b")


class Declaration(NamedTuple):
    """One declaration of a rule or of a style attribute."""

    name: str
    value: str
    important: bool


class _Rule(NamedTuple):
    specificity: tuple[int, int, int]  # ids, classes, element names
    order: int
    tag: str
    ids: frozenset[str]
    classes: frozenset[str]
    declarations: list[Declaration]


def declarations(text: str) -> list[Declaration]:
    """The declarations of a style attribute or of a rule's block."""
    found = []
    for part in _DECLARATION.findall(_COMMENT.sub(" ", text)):
        name, colon, value = part.partition(":")
        value, mark, word = value.strip().rpartition("!")
        important = bool(mark) and word.strip().lower() == "important"
        value = value.strip() if important else value + mark + word
        if colon and value:
            found.append(Declaration(name.strip().lower(), value, important))
    return found


class Sheets:
    """The style sheets of a drawing."""

    def __init__(self, root: Element, file: str) -> None:
        self._file, self._rules, self._count, self._tests = file, {}, 0, 0
        self.unread: list[tuple[str, list[Declaration]]] = []  # selectors and media that are not understood
        for element in root.walk():
            if element.tag == "style" and element.get("type", "text/css").strip() in ("", "text/css"):
                self._read(_COMMENT.sub(" ", "".join(element.text)), element.get("media"), 0)

    def matching(self, element: Element) -> list[tuple[tuple[int, int, int], int, Declaration]]:
        """Declarations for an element, each with specificity and order of its rule."""
        if not self._rules:
            return []
        classes = frozenset(element.get("class").split())
        keys = ["*", element.tag, f"#{element.get('id')}", *(f".{name}" for name in classes)]
        found = []
        for candidate in (each for key in keys for each in self._rules.get(key, ())):
            self._tests += 1
            if (
                candidate.tag in ("", element.tag)
                and candidate.classes <= classes
                and candidate.ids <= {element.get("id")}
            ):
                found += [(candidate.specificity, candidate.order, each) for each in candidate.declarations]
        says = f"with a style sheet of at most {MAX_TESTS} comparisons"
        drawing_rule(self._tests <= MAX_TESTS, self._file, says, "more", _HINT)
        return found

    def _read(self, text: str, media: str, depth: int) -> None:
        drawing_rule(depth <= _MAX_DEPTH, self._file, "with a simple style sheet", "blocks in blocks in blocks", _HINT)
        media = media.strip().lower()
        if _OTHER_MEDIA.fullmatch(media):
            return
        for prelude, block in _blocks(text):
            if not prelude.startswith("@"):
                self._add(prelude, declarations(block), media)
            elif prelude.lower().startswith("@media"):
                self._read(block, prelude[len("@media") :], depth + 1)
            elif not _HARMLESS.match(prelude.lower()):
                self.unread += [(prelude, declarations(inner)) for _, inner in _blocks(block)]

    def _add(self, selectors: str, block: list[Declaration], media: str) -> None:
        for selector in (part.strip() for part in selectors.split(",", MAX_RULES)):
            self._count += 1
            says = f"with a style sheet of at most {MAX_RULES} rules"
            drawing_rule(self._count <= MAX_RULES, self._file, says, "more", _HINT)
            match = _SELECTOR.fullmatch(selector) if selector and media in _ALWAYS else None
            if match is None:
                if not _NEVER.search(selector) and _may_draw(selector):
                    self.unread.append((selector if media in _ALWAYS else f"@media {media}", block))
                continue
            tag, marks = (match[1] or "").replace("*", ""), re.findall(r"[.#][^.#]+", match[2])
            ids, classes = (frozenset(m[1:] for m in marks if m[0] == sign) for sign in "#.")
            key = f"#{min(ids)}" if ids else f".{min(classes)}" if classes else tag or "*"
            specificity = (sum(m[0] == "#" for m in marks), sum(m[0] == "." for m in marks), int(bool(tag)))
            self._rules.setdefault(key, []).append(_Rule(specificity, self._count, tag, ids, classes, block))


def _may_draw(selector: str) -> bool:
    """Whether a selector that is not understood may mean a shape or a group: not so if it ends in another element."""
    tag = re.match(r"[A-Za-z][\w-]*", re.split(r"[\s>+~]+", selector)[-1])
    return tag is None or tag[0] in DRAWN


def _blocks(text: str) -> Iterator[tuple[str, str]]:
    """Pairs (prelude, block) of the rules on the outermost level; at-rules without a block are left out."""
    prelude, block, depth = [], [], 0
    for piece in _PIECE.findall(text):
        if piece == "{":
            depth += 1
        elif piece == "}":
            depth = max(depth - 1, 0)
        if depth == 0 and piece == "}":
            yield "".join(prelude).strip(), "".join(block[1:])
            prelude, block = [], []
        elif depth == 0 and piece == ";":
            prelude = []
        else:
            (block if depth else prelude).append(piece)
    if depth:  # the end of a sheet ends its blocks
        yield "".join(prelude).strip(), "".join(block[1:])
