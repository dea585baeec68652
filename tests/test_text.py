"""Texts of users and files: shown as they are, whatever is in them."""

import io
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fovconn_env.text import file_name, in_figure, literal, printable
from tests.fuzzing import count

# Markup of rich, commands of terminals, half a letter, lines, a right-to-left override, formulas, HTML, Markdown.
HOSTILE = (
    "[/nothing]",
    "[bold]x[/]",
    "\x1b[31mred\x1b[2J\x1b]0;title\x07",
    "\udcff",
    "a\r\nb\tc\x00\x08",
    "\u202egpj.exe",
    "$\\frac{a}$ $",
    "_hidden",
    "</script><script>alert(1)</script>&amp;",
    "[a](javascript:b) | `c`",
    ":smile:",
    "CON",
    "../../etc/passwd",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_a_terminal_obeys_nothing(text):
    shown = literal(text)
    assert shown.replace("\n", "").isprintable()
    assert printable(text).isprintable()
    assert shown.encode()
    assert literal("n_agents = 3, λ₂ > 0, 機体") == "n_agents = 3, λ₂ > 0, 機体"


def test_very_long_lines_lose_their_middle():
    shown = literal("a" * 3_000_000 + "\n" + "b" * 2000 + "\n" + "c" * 2001)
    assert len(shown) < 6100
    assert shown.split("\n")[1] == "b" * 2000
    assert "c ... c" in shown.split("\n")[2]


@pytest.mark.parametrize("text", [*HOSTILE, "", "a" * 3_000_000, "a.b", "a b", "a/b", "a:b"])
def test_names_of_files(text, tmp_path):
    """Any system takes them, different texts have different ones, and the usual ones are as they were."""
    name = file_name(text)
    assert re.fullmatch(r"[A-Za-z0-9_.+-]{0,90}", name)
    (tmp_path / f"{name}@{name}-1.npz").touch()
    assert file_name(f"{text} ") != name
    assert file_name("safe_Mine.v-0+1") == "safe_Mine.v-0+1"


@pytest.mark.parametrize("text", [*HOSTILE, "a" * 3000])
def test_figures_show_it(text):
    pytest.importorskip("matplotlib")
    from fovconn_env.render.figures import style

    figure = style.sheet(14.0, 3.0)
    axes = figure.subplots()
    axes.plot([0, 1], label=in_figure(text))
    axes.set_title(in_figure(text))
    legend = axes.legend()
    assert len(legend.get_texts()) == 1, "a name that begins with _ is listed, too"
    figure.savefig(io.BytesIO(), format="png")


@pytest.mark.parametrize("text", HOSTILE)
def test_windows_show_it(text):
    pytest.importorskip("pygame")
    from fovconn_env.render.live.text import Typesetter

    assert Typesetter(12).render(text, "#000000").get_width() == Typesetter(12).width(text) > 0


@pytest.mark.fuzz
@settings(max_examples=count(50, 10_000), deadline=None, derandomize=True)
@given(st.text(st.characters(), max_size=300))
def test_any_text_is_printed(text):
    """Through a table, a line and a progress bar."""
    pytest.importorskip("rich")
    from fovconn_env.training.commands import screen

    stream = io.StringIO()
    console = screen._LiteralConsole(file=stream, width=400, force_terminal=False)
    console.print(text, soft_wrap=True)
    console.print(screen.grid(text, [text, "b"], [[text, text]]))
    with screen.Progress(screen._Description(), console=console) as bar:
        bar.add_task(text, total=1)
    printed = stream.getvalue()
    assert printed.replace("\n", "").isprintable()
    assert printed.encode()
    assert printed.startswith(literal(text))
