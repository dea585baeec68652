"""Animated GIFs of flat colours: one palette for all frames, and frames of changed pixels alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

_SAME = 255  # palette entry of an unchanged pixel: transparent
_FREQUENT = 160  # of the other 255 entries: the most frequent colours, exactly
_BITS = 6  # upper bits of each channel that select the palette entry


def write_gif(path: Path, frames: Iterable[np.ndarray], samples: list[np.ndarray], durations: list[int]) -> None:
    """Write images (H, W, 3) uint8 with `durations` (ms); the palette is chosen from the samples."""
    palette = choose_palette(np.concatenate(samples))
    first, *rest = _changed_pixels(frames, palette)
    how = {"loop": 0, "disposal": 1, "transparency": _SAME, "optimize": False}
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=durations, **how)


def choose_palette(sample: np.ndarray) -> np.ndarray:
    """255 colours (255, 3) uint8 for images like the sample (H, W, 3): the most frequent, the others by median cut."""
    red, green, blue = np.moveaxis(sample.astype(np.int32), -1, 0)
    colors, counts = np.unique((red << 16) + (green << 8) + blue, return_counts=True)
    frequent = colors[np.argsort(-counts, kind="stable")[:_FREQUENT]]
    exact = np.stack([frequent >> 16, frequent >> 8 & 255, frequent & 255], axis=-1)
    cut = Image.fromarray(sample).quantize(_SAME - len(exact), Image.Quantize.MEDIANCUT).getpalette() or []
    rest = np.zeros((_SAME - len(exact), 3))
    rest.flat[: len(cut)] = cut[: rest.size]
    return np.concatenate([exact, rest]).astype(np.uint8)


def _changed_pixels(frames: Iterable[np.ndarray], palette: np.ndarray) -> Iterator[Image.Image]:
    """Frames as palette images in which unchanged pixels are transparent."""
    table, before, canvas = _nearest_entries(palette), None, np.empty(0, np.uint8)
    for frame in frames:
        if before is None:
            canvas = table[_color_cell(frame)]
            image = Image.fromarray(canvas.copy())  # the image shares the array, which changes below
        else:
            y, x = np.nonzero(np.logical_or.reduce([frame[..., c] != before[..., c] for c in range(3)]))
            new, old = table[_color_cell(frame[y, x])], canvas[y, x]
            fresh = np.full(canvas.shape, _SAME, np.uint8)
            fresh[y, x] = np.where(new == old, np.uint8(_SAME), new)
            canvas[y, x] = new
            image = Image.fromarray(fresh)
        image.putpalette(palette.ravel().tolist())
        before = frame
        yield image


def _color_cell(colors: np.ndarray) -> np.ndarray:
    """Index (...,) into the table of colours (..., 3) uint8: their upper bits."""
    bits = colors.astype(np.int32) >> (8 - _BITS)
    return (bits[..., 0] << 2 * _BITS) + (bits[..., 1] << _BITS) + bits[..., 2]


def _nearest_entries(palette: np.ndarray) -> np.ndarray:
    """Table (2^18,) from the upper bits of a colour to the nearest palette entry; a frequent colour gets its own."""
    step, colors = 1 << (8 - _BITS), palette.astype(np.float32)
    level = np.arange(0, 256, step, dtype=np.float32) + (step - 1) / 2
    cells = np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = (colors**2).sum(1)  # without the cell's own square, a constant
    nearest = [(distance - 2 * part @ colors.T).argmin(1) for part in np.split(cells, 64)]
    table = np.concatenate(nearest).astype(np.uint8)
    table[_color_cell(palette[_FREQUENT - 1 :: -1])] = np.arange(_FREQUENT - 1, -1, -1)  # the most frequent one last
    return table
