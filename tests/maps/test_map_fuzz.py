"""Any map, however broken: it is read, or refused with a documented error, and the work for it is bounded."""

import json
import random
import re

import pytest

from fovconn_env.errors import SettingError
from fovconn_env.files import OtherKind
from fovconn_env.maps.obstacles import Map
from tests.fuzzing import count

pytestmark = pytest.mark.fuzz

REFUSALS = (SettingError, OtherKind)
NUMBERS = (
    "0",
    "1",
    "-2",
    "3.5",
    ".5",
    "-.5.5",
    "1e3",
    "1e-9",
    "1e400",
    "-0",
    "nan",
    "9e99",
    "1,2",
    "7px",
    "3mm",
    "50%",
    "",
)
COLOURS = (
    "red",
    "none",
    "#fff",
    "#fff0",
    "rgba(1,2,3,0)",
    "transparent",
    "url(#a)",
    "url(#a) none",
    "inherit",
    "var(--x)",
)
PROPERTIES = (
    *("display", "visibility", "opacity", "fill", "stroke", "stroke-width", "fill-rule", "clip-rule", "stroke-linecap"),
    *("stroke-linejoin", "stroke-miterlimit", "stroke-dasharray", "transform", "transform-origin", "clip-path", "mask"),
    *("overflow", "vector-effect", "fill-opacity", "rotate", "r", "width", "x"),
)
WORDS = (
    "none",
    "hidden",
    "visible",
    "inline",
    "round",
    "square",
    "bevel",
    "evenodd",
    "nonzero",
    "0 0",
    "center",
    "inherit",
)
NAMES = ("a", "b", "c", "d")
TAGS = (
    *(
        "g",
        "g",
        "path",
        "path",
        "path",
        "rect",
        "circle",
        "ellipse",
        "line",
        "polyline",
        "polygon",
        "polygon",
        "use",
        "svg",
    ),
    *(
        "a",
        "switch",
        "symbol",
        "clipPath",
        "mask",
        "defs",
        "text",
        "image",
        "foreignObject",
        "style",
        "title",
        "b:c",
        "p",
    ),
)


class Maker:
    """Draws drawings at random, some tame, some wild."""

    def __init__(self, seed):
        self.rng = random.Random(seed)
        self.wild = self.rng.choice((0.0, 0.01, 0.1))

    def any(self, *choices):
        return self.rng.choice(choices)

    def number(self):
        if self.rng.random() >= self.wild:
            return self.any(str(self.rng.randint(-9, 9)), f"{self.rng.uniform(-9, 9):.3f}", repr(self.rng.gauss(0, 1)))
        return self.any(*NUMBERS)

    def numbers(self, n):
        return self.any(" ", ",", " ,").join(self.number() for _ in range(n))

    def path(self):
        text = f"{self.any('M', 'm')}{self.numbers(2)}" if self.rng.random() >= self.wild else self.any("L", "")
        for _ in range(self.rng.randint(1, 8)):
            kind = self.any(*"LlHhVvCcSsQqTtAazZMm")
            n = {"L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0, "M": 2}[kind.upper()]
            if kind in "Aa" and self.rng.random() < 0.8:
                text += (
                    f"{kind}{self.numbers(3)} {self.any('0', '1')} {self.any('0', '1')} {self.number()} {self.number()}"
                )
            else:
                text += kind + self.numbers(n * self.any(1, 1, 2) + (self.rng.random() < self.wild))
        return text + self.any("z", "Z", "")

    def transform(self):
        if self.rng.random() < self.wild:
            names = ("translate", "scale", "rotate", "matrix", "skewX", "spin", "translateX", "rotate3d")
            return " ".join(f"{self.any(*names)}({self.numbers(self.any(1, 2, 3, 6))})" for _ in range(2))
        kinds = {"translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "matrix": (6,), "skewX": (1,)}
        names = [self.any(*kinds) for _ in range(self.any(1, 1, 2))]
        return " ".join(f"{name}({self.numbers(self.any(*kinds[name]))})" for name in names)

    def value(self, name):
        if name in ("fill", "stroke"):
            return self.any(*COLOURS)
        if name == "transform":
            return self.transform()
        if name in ("clip-path", "mask"):
            return self.any(f"url(#{self.any(*NAMES)})", "none", "circle()")
        return self.any(self.number(), self.any(*WORDS), self.any(*WORDS))

    def declarations(self):
        names = [self.any(*PROPERTIES) for _ in range(self.rng.randint(0, 3))]
        return self.any(";", "; ", ";;").join(
            f"{name}:{self.value(name)}{self.any('', '', '!important')}" for name in names
        )

    def sheet(self):
        selectors = (
            ".a",
            "#b",
            "path",
            "*",
            "g > path",
            "a.b",
            ".a,.b",
            ":hover",
            "@media print",
            "@media all{.c",
            "}",
            "/*",
        )
        return "".join(f"{self.any(*selectors)}{{{self.declarations()}}}" for _ in range(self.rng.randint(1, 4)))

    def attributes(self, tag):
        given = {
            "path": {"d": self.path()},
            "polygon": {"points": self.numbers(self.rng.randint(0, 12))},
            "polyline": {"points": self.numbers(self.rng.randint(0, 12))},
            "use": {"href": f"#{self.any(*NAMES)}"},
        }.get(tag, {})
        for name in self.rng.sample(("x", "y", "cx", "cy", "r", "rx", "ry", "width", "height", "x1", "y2"), 5):
            given[name] = self.number()
        for name in self.rng.sample(
            ("id", "class", "style", "transform", "viewBox", "data-low", "data-high", "rest"), 3
        ):
            given[name] = {
                "id": self.any(*NAMES),
                "class": f"{self.any(*NAMES)} {self.any(*NAMES)}",
                "style": self.declarations(),
                "transform": self.transform(),
                "viewBox": self.numbers(4),
            }.get(name, self.number())
        for name in self.rng.sample(PROPERTIES, self.any(0, 1, 2) if self.wild else self.any(0, 0, 1)):
            given[name] = self.value(name)
        return "".join(f' {name}="{re.sub("[<&]", "", value)}"' for name, value in given.items())

    def element(self, depth):
        tag = self.any(*TAGS)
        inside = self.sheet().replace("<", "") if tag == "style" else ""
        if depth and tag not in ("path", "style"):
            inside = "".join(self.element(depth - 1) for _ in range(self.rng.randint(0, 3)))
        return f"<{tag}{self.attributes(tag)}>{inside}</{tag}>"

    def drawing(self):
        body = "".join(self.element(self.any(0, 1, 1, 2, 3)) for _ in range(self.rng.randint(1, 4)))
        names = 'xmlns="http://www.w3.org/2000/svg" xmlns:b="urn:b"'
        return f"<svg {names}{self.any('', self.attributes('g'))}>{body}</svg>".encode()

    def broken(self, data):
        """Some bytes changed, lost, repeated or moved."""
        data = bytearray(data)
        for _ in range(self.any(1, 1, 2, 5)):
            at, size = self.rng.randrange(max(len(data) - 9, 1)), self.rng.randint(1, 9)
            change = self.any("flip", "set", "cut", "repeat", "end")
            if change == "flip":
                data[at] ^= 1 << self.rng.randrange(8)
            elif change == "set":
                data[at] = self.any(*b"<>/\"'&;:,.- 0e9(){}[]#\x00\xff")
            elif change == "cut":
                del data[at : at + size]
                data = data or bytearray(b"<")
            elif change == "repeat":
                data[at:at] = data[at : at + size] * self.any(1, 2, 50)
            else:
                del data[max(at, 9) :]
        return bytes(data)

    def json_value(self, depth):
        values = [None, True, -1, 0.5, 1e300, 10**400, "circle", "", [], {}, [1, 2], [[0, 0], [3, 0], [3, 4]], [[1]]]
        if depth and self.rng.random() < 0.5:
            return [self.json_value(depth - 1) for _ in range(self.rng.randint(0, 3))]
        return self.any(*values)

    def json_map(self):
        number = lambda: self.any(self.rng.uniform(-5, 5), self.rng.randint(-5, 5))  # noqa: E731
        obstacles = []
        for _ in range(self.rng.randint(0, 4)):
            corners = [[number(), number()] for _ in range(self.rng.randint(3, 7))]
            shape = self.any(
                {"shape": "circle", "center": [number(), number()], "radius": abs(number())},
                {"shape": "wall", "start": [number(), number()], "end": [number(), number()], "thickness": 0.5},
                {"shape": "polygon", "outline": corners},
            )
            for _ in range(self.any(0, 0, 1, 2)):
                shape[self.any(*shape, "low", "high", "radius", "to_file")] = self.json_value(2)
            obstacles.append(
                self.any(shape, shape, [shape, shape], self.json_value(1)) if self.rng.random() < 0.3 else shape
            )
        record = {"format": "fovconn-map", "version": 1, "obstacles": obstacles}
        if self.rng.random() < 0.1:
            record[self.any(*record, "more")] = self.json_value(2)
        return json.dumps(record).encode()


def understood(folder, suffix, data, **changes):
    """Whether a map's file holds obstacles that are understood; any error but the documented ones passes through."""
    file = folder / f"map{suffix}"
    file.write_bytes(data)
    try:
        report = Map.inspect_file(file, **changes)
    except REFUSALS:
        return False
    assert len(report.names) == len({piece["source"] for piece in report.map.flatten()[0]})
    assert str(report)
    if len(data) % 8 == 0:
        report.map.to_file(folder / "again.json")
        assert Map.from_file(folder / "again.json") == report.map
    return len(report.names) > 0


def test_any_drawing_is_read_or_refused(tmp_path):
    n, read = count(120, 60_000), 0
    for seed in range(n):
        maker = Maker(seed)
        data = maker.drawing()
        read += understood(tmp_path, ".svg", maker.broken(data) if seed % 4 == 0 else data, strokes=seed % 3 > 0)
    assert read > n / 30


def test_any_json_map_is_read_or_refused(tmp_path):
    n, read = count(200, 40_000), 0
    for seed in range(n):
        maker = Maker(seed)
        data = maker.json_map()
        read += understood(tmp_path, ".json", maker.broken(data) if seed % 3 == 0 else data)
    assert read > n / 20


HEAD = '<svg xmlns="http://www.w3.org/2000/svg">'
USE = '<use href="#p"/>'
STAIRS = "h.1v.1" * 50 + "zm9 0"
LINK = '<a class="a"/>'


@pytest.mark.parametrize(
    "name, text, limit",
    [
        ("a.svg", HEAD + '<path d="M0 0' + "l1 1 " * 700_000 + 'z"/></svg>', "of at most 100000 corners"),
        ("a.svg", HEAD + '<path d="' + "M0 0h1v1z" * 60_000 + '"/></svg>', "of at most 100000 corners"),
        ("a.svg", HEAD + '<path d="' + "M0 0" * 900_000 + '"/></svg>', "of at most 100000 corners"),
        ("a.svg", HEAD + f'<path d="M0 0{STAIRS * 201}"/></svg>', "of at most 20000 corners, got 20"),
        ("a.svg", HEAD + '<circle r="1"/>' * 60_000 + "</svg>", "of at most 50000 elements"),
        ("a.svg", HEAD + "<g>" * 900_000, "of at most 50000 elements"),
        ("a.svg", f"{HEAD}<style>{'.a{b:c}' * 90_000}</style></svg>", "of at most 10000 rules"),
        ("a.svg", f"{HEAD}<style>{'.a{b:c}' * 9000}</style>{LINK * 9000}</svg>", "at most 300000 comparisons"),
        ("a.svg", f"{HEAD}<style>{'@media a{' * 90_000}</style></svg>", "blocks in blocks"),
        ("a.svg", f'{HEAD}<circle r="1" transform="{"scale(1)" * 90_000}"/></svg>', "transform must be like"),
        (
            "a.svg",
            f'{HEAD}<path id="p" d="M0 0{"l1 1" * 900}"/>{USE * 900}</svg>',
            "of at most 100000 corners",
        ),
        (
            "a.json",
            '{"format":"fovconn-map","version":1,"obstacles":[' + "[]," * 900_000 + "[]]}",
            "at most 20000 corners",
        ),
        ("a.json", "[" * 4_000_000, "must be JSON"),
        ("a.json", "{" + ",".join(f'"{k % 300_000}":1' for k in range(300_001)) + "}", "'0' is there twice"),
        ("a.svg", f'{HEAD}<path d="M0 0{"l0 0" * 90_000}"/></svg>', "shapes that are seen, got none"),
        ("a.svg", f'{HEAD}<circle r="{"9" * 4_000_000}x"/></svg>', "r must be a finite number"),
        ("a.svg", f'{HEAD}<circle r="x" fill="rgba(1,{"0" * 4_000_000}x)"/></svg>', "r must be a finite number"),
        ("a.svg", f'{HEAD}<circle r="1" transform="scale({"9" * 4_000_000}x)"/></svg>', "transform must be like"),
        ("a.svg", f'{HEAD}<path d="M0 0h{"9" * 4_000_000}x"/></svg>', "its coordinates must be finite"),
        ("a.json", '{"format":"fovconn-map","version":1,"obstacles":[' + "9" * 4_000_000 + "]}", "must be an object"),
    ],
    ids=range(20),
)
def test_what_would_take_minutes_is_refused_with_its_limit(tmp_path, name, text, limit):
    (tmp_path / name).write_text(text)
    with pytest.raises(SettingError, match=limit):
        Map.from_file(tmp_path / name)


def test_many_obstacles_are_placed_each_in_a_moment(tmp_path):
    circles = [f'<circle cx="{k % 99}" cy="{k // 99}" r=".1"/>' for k in range(5000)]
    (tmp_path / "a.svg").write_text(f"{HEAD}{''.join(circles)}</svg>")
    found = Map.from_file(tmp_path / "a.svg")
    assert found.flatten()[0]["source"].tolist() == list(range(5000))
