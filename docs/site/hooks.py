"""What the site has besides docs/*.md: pages made of the repository, and links that stay in the site. See mkdocs.yml.

docs/ is written for a git host, where a link may lead to any file. Here README, changelog and notebook are pages; a
source file or folder that a page links to becomes one; the reference is made of the public names, and each scenario's
card gets a flight to play back.
"""

from __future__ import annotations

import ast
import fnmatch
import functools
import importlib
import json
import os
import re
import runpy
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MOVED = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "docs/quickstart.ipynb": "quickstart.md"}
ORIGIN = {page: name for name, page in MOVED.items()}
PILOT = "adaptive"  # flies the pages of the cards
_LINK = re.compile(r"(?<=\]\()([^()\s#]+)(?=[)#])")
_LEXERS = {".cff": "yaml", ".css": "css", ".js": "js", ".json": "json", ".py": "python", ".toml": "toml"}
_CARD = re.compile(r"^!\[.*\]\(images/scenarios/(.*)\.png\)$", re.MULTILINE)

# Modules and their public names, as docs/api.md lists them; None: all of `__all__`.
PUBLIC: dict[str, list[str] | None] = {
    "fovconn_env": None,
    "fovconn_env.envs": ["JointEnv", "VectorEnv"],
    "fovconn_env.baselines": None,
    "fovconn_env.maps": None,
    "fovconn_env.scenarios": None,
    "fovconn_env.sim": None,
    "fovconn_env.flights": None,
    "fovconn_env.flights.rollout": ["rollout", "Observer"],
    "fovconn_env.layout": ["Column", "Rows", "rows", "detections"],
    "fovconn_env.errors": ["FovconnError", "SettingError", "SettingTypeError", "MissingPlugin", "MissingPackage"],
    "fovconn_env.training.sb3": ["make_vec_env", "AsymmetricPolicy", "EpisodeLog"],
    "fovconn_env.training.rllib": ["RobotsMultiAgentEnv", "ModulePolicy"],
    "fovconn_env.training.benchmarl": ["Fovconn", "FovconnTask"],
    "fovconn_env.training.evaluation": ["evaluate", "summary"],
}


# ------------------------------------------------------------------------------------------------ mkdocs calls these
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made, and put the pages that a pattern of the navigation stands for in its place."""
    for name, text in (pages() | flights()).items():
        listed = name in ORIGIN or name.startswith("reference/")
        inclusion = InclusionLevel.INCLUDED if listed else InclusionLevel.NOT_IN_NAV
        files.append(File.generated(config, name, content=text, inclusion=inclusion))
    for section in config.nav or []:
        for title, entries in section.items():
            if isinstance(entries, list):
                section[title] = [page for entry in entries for page in _matching(entry, files)]
    return files


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """The page with links that stay in the site, and on the scenarios' cards a link to a flight."""
    name = page.file.src_uri
    if name == "scenarios.md":
        markdown = _CARD.sub(rf"\g<0>\n\n[Play back a flight of `{PILOT}` from this start](flights/\1.html)", markdown)
    if name.startswith(("reference/", "source/")):
        return markdown
    here = posix_folder(name)
    return _LINK.sub(lambda link: _relative(link[1], origin(name), here), markdown)


# ------------------------------------------------------------------------------------------------------------- links
def origin(page: str) -> Path:
    """The file of the repository that a page shows."""
    return ROOT / ORIGIN[page] if page in ORIGIN else DOCS / page


def posix_folder(page: str) -> str:
    """The folder of a page in the site, "." at the top."""
    return os.path.dirname(page) or "."


def place(path: Path) -> str:
    """Where the site shows a file or folder of the repository."""
    name = path.relative_to(ROOT).as_posix()
    if name in MOVED:
        return MOVED[name]
    if path.is_file() and path.is_relative_to(DOCS) and path.suffix != ".py":
        return path.relative_to(DOCS).as_posix()
    return f"source/{name}.md"


def _target(link: str, file: Path) -> Path | None:
    """What a link of a file leads to in the repository, if anything."""
    path = Path(os.path.normpath(file.parent / link))
    return path if ":" not in link and path.is_relative_to(ROOT) and path.exists() else None


def _relative(link: str, file: Path, folder: str) -> str:
    path = _target(link, file)
    return link if path is None else os.path.relpath(place(path), folder)


def _matching(entry: Any, files: Files) -> list[Any]:
    """The pages that an entry of the navigation stands for: those that fit its pattern, or itself."""
    if not isinstance(entry, str) or "*" not in entry:
        return [entry]
    return sorted(fnmatch.filter(files.src_uris, entry), key=lambda page: page.removesuffix(".md"))


# ------------------------------------------------------------------------------------------------- pages of the rest
def pages() -> dict[str, str]:
    """Text of all pages that are not in docs/, by name."""
    made = {"index.md": (ROOT / "README.md").read_text("utf-8"), "quickstart.md": _notebook()}
    made["changelog.md"] = (ROOT / "CHANGELOG.md").read_text("utf-8")
    made |= {f"reference/{module}.md": reference(module) for module in PUBLIC}
    written = {path: path.read_text("utf-8") for path in DOCS.rglob("*.md")}
    written |= {origin(name): made[name] for name in ORIGIN}
    targets = {_target(link, path) for path, text in written.items() for link in _LINK.findall(text)}
    sources = {path: name for path in targets if path is not None and (name := place(path)).startswith("source/")}
    return made | {name: _source(path, sources) for path, name in sources.items()}


def _notebook() -> str:
    cells = json.loads((DOCS / "quickstart.ipynb").read_text("utf-8"))["cells"]
    texts = {"markdown": "{}", "code": "```python\n{}\n```"}
    return "\n\n".join(texts[cell["cell_type"]].format("".join(cell["source"])) for cell in cells)


def _source(path: Path, sources: dict[Path, str]) -> str:
    """A page with a file's text, or with what is in a folder; the search does not look into it."""
    name = path.relative_to(ROOT).as_posix()
    head = f"---\ntitle: {name}\nsearch: {{exclude: true}}\n---\n\n# {name}\n\n"
    if path.is_file():
        return f"{head}~~~~ {_LEXERS.get(path.suffix, 'text')}\n{path.read_text('utf-8')}~~~~\n"
    inside = [entry for entry in sorted(path.iterdir()) if not entry.name.startswith(("__pycache__", "."))]
    return head + "\n".join(f"- {_listed(entry, posix_folder(sources[path]), sources)}" for entry in inside) + "\n"


def _listed(entry: Path, folder: str, sources: dict[Path, str]) -> str:
    """A line of a folder's page: the name, a link where there is a page, and how the file's docstring begins."""
    name = f"`{entry.name}`"
    if entry in sources:
        name = f"[{name}]({os.path.relpath(sources[entry], folder)})"
    text = ast.get_docstring(ast.parse(entry.read_text("utf-8"))) if entry.suffix == ".py" else None
    return f"{name}: {text.splitlines()[0]}" if text else name


# --------------------------------------------------------------------------------------------------------- reference
def public() -> dict[str, str]:
    """The module on whose page each public name stands, by its path: the first that has it."""
    where: dict[str, str] = {}
    seen: set[str] = set()
    for module, names in PUBLIC.items():
        for name in names or importlib.import_module(module).__all__:
            if name not in seen and name != "__version__":
                seen.add(name)
                where[f"{module}.{name}"] = module
    return where


def reference(module: str) -> str:
    """A page of the reference, for mkdocstrings: a module's public names, settings with their table."""
    settings = (DOCS / "settings.md").read_text("utf-8")
    tables = dict(re.findall(r"<!-- settings:(\w+) -->\n(.*?)<!-- end -->", settings, re.DOTALL))
    names = [path for path, where in public().items() if where == module]
    text = "\n".join(f"::: {path}\n\n{tables.get(path.rpartition('.')[2], '')}" for path in names)
    here = {path.rpartition(".")[2] for path in names}
    others = [f"`{name}`" for name in PUBLIC[module] or importlib.import_module(module).__all__ if name not in here]
    more = f"It also has {', '.join(others)}, see [fovconn_env](fovconn_env.md).\n\n" if others and names else ""
    return f"# {module}\n\n{more}{text}"


# ----------------------------------------------------------------------------------------------------------- flights
@functools.cache
def flights() -> dict[str, str]:
    """A page that plays back a flight from the start in each card's picture, by name."""
    return dict(_flights())


def _flights() -> Iterator[tuple[str, str]]:
    from fovconn_env.baselines import find_policy
    from fovconn_env.flights import Film
    from fovconn_env.flights.rollout import rollout
    from fovconn_env.render.page.web_page import write_page

    starts = runpy.run_path(str(DOCS / "pictures.py"))["starts"]
    for name, (scenario, seed) in starts().items():
        film = Film()
        for _ in rollout(find_policy(PILOT), scenario, [seed], observers=[film]):
            pass
        with tempfile.TemporaryDirectory() as folder:
            yield f"flights/{name}.html", write_page(film.flight(), Path(folder) / "flight.html").read_text("utf-8")
