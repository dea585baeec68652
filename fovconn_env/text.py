"""Texts of users and files, made fit to be shown: in a terminal, a picture, a page, a file's name."""

from __future__ import annotations

import hashlib
import re

_LONGEST, _LONGEST_LABEL = 2000, 80  # letters of a line that is shown, and of a name in a picture
_LONGEST_NAME = 80  # letters of a part of a file's name, of which most systems take 255


def printable(text: str) -> str:
    """A text with escapes for what is no letter, such as control characters and halves of surrogate pairs."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def literal(text: str) -> str:
    """Lines that are `printable`, each without its middle if it is very long."""
    return "\n".join(printable(_short(line, _LONGEST)) for line in text.split("\n"))


def label(text: str) -> str:
    """A name in a picture: one `printable` line, not long."""
    return printable(_short(text, _LONGEST_LABEL))


def in_figure(text: str) -> str:
    """A `label` in which matplotlib finds no formula, and which its legends do not leave out."""
    shown = label(text).replace("$", r"\$")
    return f"\N{ZERO WIDTH SPACE}{shown}" if shown.startswith("_") else shown


def _short(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest // 2]} ... {text[-longest // 2 :]}"


def file_name(text: str) -> str:
    """A text as a part of a file's name, on any system; short ones of letters, digits and -_.+ stay as they are."""
    name = re.sub(r"[^A-Za-z0-9_.+-]", "_", text[:_LONGEST_NAME])
    return name if name == text else f"{name}-{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"
