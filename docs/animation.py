"""Fly the best policy on a hard task, and write the animation at the top of README.md: `python docs/animation.py`."""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

from PIL import Image

from fovconn_env import scenario
from fovconn_env.baselines import find_policy
from fovconn_env.files import replacing
from fovconn_env.flights.rollout import rollout
from fovconn_env.render.live.view import View, ViewSettings

PICTURE = Path(__file__).parent / "images" / "hard.webp"
TASK, POLICY, SEED = "HardPillars-v1", "generalist", 22
SIZE, SETTINGS = (640, 420), ViewSettings(above=False, distance=15.0, elevation=math.radians(42))  # px; m
FIRST, EVERY, FPS = 60, 6, 10  # steps before the first picture, and from each to the next; pictures a second
HOLD, QUALITY = 2500, 17  # ms that the last picture stays; of WebP, for less than 1 MB

if __name__ == "__main__":
    chosen, pictures = scenario(TASK), []
    view = View(chosen, SIZE, settings=SETTINGS)
    for k, simulator in enumerate(rollout(find_policy(POLICY), chosen, [SEED])):
        if k % EVERY == 0 or simulator.over[0]:
            pictures.append(Image.fromarray(view.draw_array(simulator)))
    first, *rest = pictures[FIRST // EVERY :]
    how = {"duration": [round(1000 / FPS)] * len(rest) + [HOLD], "loop": 0, "quality": QUALITY, "method": 6}
    with replacing(PICTURE) as (part,):
        first.save(part, format="WEBP", save_all=True, append_images=rest, **how)
    print(f"{PICTURE}: {len(rest) + 1} pictures, {PICTURE.stat().st_size / 1e6:.2f} MB")
