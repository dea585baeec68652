"""Fly the demo, write it as a web page, and take its picture for flights.md.

Run `python docs/flight_page.py`, then `python docs/shrink.py`. Needs a Chromium (apt-get install chromium) and the
`render` extra.
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

from PIL import Image

from fovconn_env import scenario
from fovconn_env.baselines import find_policy
from fovconn_env.flights import Film
from fovconn_env.flights.rollout import rollout
from fovconn_env.render.page.web_page import write_page
from tests.chromium import Browser

PICTURE = Path(__file__).parent / "images" / "flight_page.png"
AT = 40.0  # s

if __name__ == "__main__":
    film = Film()
    for _ in rollout(find_policy("expert"), scenario("LeaderObstacles-v0"), [3], observers=[film]):
        pass
    with tempfile.TemporaryDirectory() as folder:
        page = write_page(film.flight(), Path(folder) / "flight.html")
        browser = Browser(Path(folder) / "chromium")
        try:
            browser.open(page, f"#t={AT:g}")
            browser.settle()
            picture = Image.open(io.BytesIO(browser.screenshot()))
        finally:
            browser.close()
    picture.convert("RGB").save(PICTURE, optimize=True)
    print(PICTURE)
