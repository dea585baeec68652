"""The keys of `fovconn play`, and a `Stick` with ramps from held keys. Imports no library.

Names are those of `pygame.key.name`, with "shift+" in front if Shift is held; `name_of` gives a pressed key its name
on any layout.
"""

from __future__ import annotations

from typing import NamedTuple

from fovconn_env.training.play.stick import Stick

RISE = 0.40  # s from rest to the whole stick while a key is held
FALL = 0.25  # s from the whole stick back to rest


class Key(NamedTuple):
    """One row of the key table. A held key pushes an axis of `Stick`; other keys run a command once."""

    names: tuple[str, ...]
    does: str  # axis of `Stick`, or a command of `cockpit.Cockpit`
    description: str
    value: int = 0  # direction of an axis, or argument of the command


TABLE: dict[str, tuple[Key, ...]] = {
    "fly": (
        Key(("w", "up"), "forward", "forward", 1),
        Key(("s", "down"), "forward", "back", -1),
        Key(("a", "left"), "left", "left", 1),
        Key(("d", "right"), "left", "right", -1),
        Key(("r", "page up"), "up", "climb", 1),
        Key(("f", "page down"), "up", "sink", -1),
        Key(("q",), "yaw", "turn left", 1),
        Key(("e",), "yaw", "turn right", -1),
        Key(("v",), "frame", "forward: away from you, or where it looks"),
    ),
    "team": (
        *(Key((str(k),), "fly", f"fly robot {k}", k - 1) for k in range(1, 10)),
        Key(("tab",), "next_robot", "fly the next robot", 1),
        Key(("shift+tab",), "next_robot", "fly the previous robot", -1),
        Key(("0",), "hands_off", "hand your robot back"),
        Key(("l",), "lead", "your robot leads"),
        Key(("g",), "script", "script pulls the leader you do not fly"),
        Key(("p",), "next_policy", "next policy", 1),
        Key(("shift+p",), "next_policy", "previous policy", -1),
    ),
    "flight": (
        Key(("space",), "pause", "pause, go on"),
        Key((".",), "single", "a single step"),
        Key(("m",), "slow", "slow motion: 1, 1/2, 1/4"),
        Key(("backspace",), "again", "the same flight again"),
        Key(("n",), "new_seed", "another flight (next seed)"),
        Key(("o",), "next_scenario", "next scenario", 1),
        Key(("shift+o",), "next_scenario", "previous scenario", -1),
    ),
    "picture": (
        Key(("c",), "camera", "orbit, behind a robot, from above"),
        Key(("x",), "cones", "cameras' views"),
        Key(("z",), "trails", "trails"),
        Key(("k",), "links", "links of your robot alone, or all"),
        Key(("b",), "above", "view from above, beside"),
        Key(("t",), "theme", "light or dark"),
        Key(("h", "f1"), "help", "these keys"),
        Key(("escape",), "quit", "close what is open, or ask whether to quit"),
        Key(("return",), "confirm", "quit, when asked"),
    ),
}
MOUSE = (("drag", "turn the view"), ("wheel", "nearer, farther"), ("right click", "the view as it was"))
_BY_NAME = {name: key for keys in TABLE.values() for key in keys for name in key.names}


_FLYING = {name for key in TABLE["fly"] if key.does in Stick._fields for name in key.names if len(name) == 1}
_KEYPAD = {f"[{digit}]": digit for digit in "0123456789."} | {"enter": "return"}


def name_of(name: str, place: str) -> str:
    """The name in `TABLE` of a key with a name on the person's layout, at a place of the keyboard.

    place: the name of the key there on a US layout, "" if unknown. Keys that fly lie where they do on a US keyboard,
    whatever their letters. Other letters are the layout's; where they mean nothing, as Cyrillic ones, the place counts.
    """
    name = _KEYPAD.get(name, name)
    if place in _FLYING:
        return place
    known = name in _BY_NAME and (not place or name not in _FLYING)
    return name if known else place or name


def find_key(name: str) -> Key | None:
    """The row of a key name, or None; Shift is ignored for keys without a row of their own for it."""
    return _BY_NAME.get(name) or _BY_NAME.get(name.removeprefix("shift+"))


def rows(group: str) -> list[tuple[str, str]]:
    """(keys, description) of a group for people; one row for all numbers, and one for a pair with Shift."""
    table = []
    for key in TABLE[group]:
        if key.does == "fly":
            if key.value == 0:
                table.append(("1-9", "fly that robot"))
        elif key.names[0].startswith("shift+"):
            keys, description = table[-1]
            table[-1] = f"{keys}, Shift+{keys}", description.replace("next", "next, previous")
        else:
            table.append((" ".join(_label(name) for name in key.names), key.description))
    return table


def _label(name: str) -> str:
    arrows = {"up": "↑", "down": "↓", "left": "←", "right": "→", "page up": "PgUp", "page down": "PgDn"}
    return (
        arrows.get(name)
        or {"escape": "Esc", "return": "Enter"}.get(name)
        or (name.upper() if len(name) == 1 else name.capitalize())
    )


class Keyboard:
    """Held keys as a stick: an axis ramps towards the held direction, with the times RISE and FALL."""

    def __init__(self) -> None:
        self._held: set[str] = set()
        self._stick = Stick()

    def press(self, name: str) -> bool:
        """Handle a pressed key; return whether it moves the stick."""
        name = name.removeprefix("shift+")
        key = find_key(name)
        if key is None or key.does not in Stick._fields:
            return False
        self._held.add(name)
        return True

    def release(self, name: str) -> None:
        """Handle a released key."""
        self._held.discard(name.removeprefix("shift+"))

    def release_all(self) -> None:
        """Release all keys, for a window that lost the keyboard; the stick ramps to rest."""
        self._held.clear()

    def update(self, duration: float) -> Stick:
        """The stick after `duration`, s."""
        goals = dict.fromkeys(Stick._fields, 0)
        for key in {key for name in self._held if (key := find_key(name))}:
            goals[key.does] += key.value
        self._stick = Stick(*(ramp(now, goals[axis], duration) for axis, now in self._stick._asdict().items()))
        return self._stick


def ramp(now: float, goal: float, duration: float) -> float:
    """An axis after `duration`, s, of a ramp to a goal: towards rest with FALL, away from rest with RISE."""
    if now * goal < 0.0 or abs(goal) < abs(now):
        stop = goal if now * goal > 0.0 else 0.0
        spent = abs(now - stop) * FALL
        if duration <= spent:
            return now + (1.0 if stop > now else -1.0) * duration / FALL
        now, duration = stop, duration - spent
    reach = duration / RISE
    return goal if abs(goal - now) <= reach else now + (reach if goal > now else -reach)
