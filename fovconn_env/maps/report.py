"""What was understood of a map's file, and what was not."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from fovconn_env.maps.obstacles import Map

_MOST = 8  # kinds of refusals in a message
_SHOWN = 20  # obstacles whose names are listed


class MapReport(NamedTuple):
    """What a file holds, as `Map.inspect_file` reads it. `str` lists what is left out and refused, a line each."""

    map: Map  # of the obstacles that are understood
    names: list[str]  # of the obstacles, by number: the elements of a drawing
    left_out: dict[str, int]  # what of a drawing is no obstacle, and how often
    refused: list[tuple[str, str]]  # elements, and why

    def kinds(self) -> list[tuple[str, str, int]]:
        """Refusals that differ by more than a value: first element, why, and how many there are."""
        kinds: dict[tuple[str, str], tuple[str, str, int]] = {}
        for name, why in self.refused:
            key = (name.split()[0].rstrip(">"), why.partition(", got ")[0])
            first, why, count = kinds.get(key, (name, why, 0))
            kinds[key] = (first, why, count + 1)
        return list(kinds.values())

    def refusals(self) -> str:
        """All that is refused, with counts, in one line."""
        kinds = self.kinds()
        lines = [f"{name}: {why}{_more(count)}" for name, why, count in kinds[:_MOST]]
        if len(kinds) > _MOST:
            lines.append(f"and {len(kinds) - _MOST} more kinds of refusals")
        total = f"{len(self.refused)} elements are refused: " if len(self.refused) > 1 else ""
        return total + "; ".join(lines)

    def __str__(self) -> str:
        shown = ", ".join(f"{number} {name}" for number, name in enumerate(self.names[:_SHOWN]))
        lines = [f"{len(self.names)} obstacles: {shown}{', ...' if len(self.names) > _SHOWN else ''}"]
        lines += [f"left out: {what}, {count}" for what, count in self.left_out.items()]
        lines += [f"refused: {name}: {why}{_more(count)}" for name, why, count in self.kinds()]
        return "\n".join(lines)


def _more(count: int) -> str:
    return f" ({count - 1} more like it)" if count > 1 else ""
