"""The XML of a drawing, from bytes in any encoding that it declares, as a tree of elements; text is kept of <style>."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple
from xml.parsers import expat

from fovconn_env.errors import SettingError
from fovconn_env.maps.outlines import Short

MAX_ELEMENTS = 50_000  # of a drawing, copies included
SHAPES = ("circle", "ellipse", "line", "path", "polygon", "polyline", "rect")
GROUPS = ("g", "a")
DRAWN = (*SHAPES, *GROUPS, "switch", "use", "svg", "symbol", "clipPath")  # elements that draw, or hold what does
_SIMPLER = "take out the layers that are no walls"
_HREF = ("href", "http://www.w3.org/1999/xlink}href")


class DrawingError(SettingError):
    """A drawing that is refused as a whole."""


def drawing_rule(holds: bool, file: str, says: str, value: object, hint: str) -> None:
    """Raise the `DrawingError` of a broken rule."""
    if not holds:
        raise DrawingError(f"{file}: an .svg map must be {says}, got {value!r}: {hint}")


class Element(NamedTuple):
    """An element: its name, attributes by name, children in order, and pieces of text."""

    tag: str  # "" for one of another namespace
    attributes: dict[str, str]
    children: list[Element]
    text: list[str]

    def get(self, name: str, default: str = "") -> str:
        """An attribute's value."""
        return self.attributes.get(name, default)

    def link(self) -> str:
        """The id of the element to which `href` points, "" if there is none."""
        target = next((self.get(name) for name in _HREF if name in self.attributes), "").strip()
        return target[1:] if target.startswith("#") else ""

    def walk(self) -> Iterator[Element]:
        """The element and all below it, in order; no recursion, for groups nest deeper than Python calls."""
        stack: list[Element] = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))

    def has_shapes(self) -> bool:
        """Whether there is a shape, or a copy of one, among the element and all below it."""
        return any(element.tag in SHAPES or element.tag == "use" for element in self.walk())


def parse(data: bytes, file: str) -> Element:
    """The root of a drawing. Raises `DrawingError` for what is no SVG, has entities or too many elements."""
    top = Element("", {}, [], [])
    stack, namespace, count = [top], "", 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count, namespace
        count += 1
        drawing_rule(count <= MAX_ELEMENTS, file, f"of at most {MAX_ELEMENTS} elements", "more", _SIMPLER)
        space, _, tag = name.rpartition("}")
        if count == 1:
            namespace = space
            drawing_rule(tag == "svg", file, "an <svg>", Short(f"<{tag}>"), "is it another format?")
        element = Element(tag if space == namespace else "", attributes, [], [])
        stack[-1].children.append(element)
        stack.append(element)

    def data_of(text: str) -> None:
        if stack[-1].tag == "style":
            stack[-1].text.append(text)

    def entity(*_: object) -> None:
        drawing_rule(False, file, "without entities", "<!ENTITY", "save it as plain SVG")

    parser = expat.ParserCreate(namespace_separator="}")
    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: stack.pop()
    parser.CharacterDataHandler, parser.EntityDeclHandler = data_of, entity
    try:
        parser.Parse(data, True)
    except DrawingError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as problem:  # the last two: of an encoding
        raise DrawingError(f"{file}: an .svg map must be XML, got something else: {problem}") from None
    return top.children[0]
