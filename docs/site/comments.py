"""What the reference shows of a field: the comment on its line, where this package writes shapes, units and frames."""

from __future__ import annotations

from typing import Any

from griffe import Attribute, Docstring, ExprCall, Extension


class Comments(Extension):
    """An attribute without a docstring has the comment at the end of its first line as one."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        """Called for each attribute that griffe finds in a file."""
        if attr.docstring is None and attr.lineno is not None:
            _, mark, comment = attr.lines_collection[attr.filepath][attr.lineno - 1].partition("  # ")
            if mark:
                attr.docstring = Docstring(comment, parent=attr)
        call = attr.value
        if isinstance(call, ExprCall) and call.function.canonical_path.startswith("fovconn_env.bounds."):
            attr.value = call.arguments[0]  # of a setting, whose bounds stand in a table, its default
