"""What is done with every pixel of a picture; pygame and numpy take five to ten times as long."""

from __future__ import annotations

import numpy as np
import pygame

from fovconn_env.kernel.jit import entry

MASKS = (0xFF0000, 0xFF00, 0xFF, 0)  # of red, green and blue in 32 bits


def halve(fine: pygame.Surface, page: pygame.Surface) -> None:
    """Fill the top of the page, as wide as half of `fine`, with the means of 2 x 2 pixels: that smooths every edge."""
    pixels = pygame.surfarray.pixels2d(fine).T
    average(pixels, pygame.surfarray.pixels2d(page).T[: len(pixels) // 2])


def rgb_array(page: pygame.Surface) -> np.ndarray:
    """The page as an array of its own, (height, width, 3) uint8."""
    pixels = pygame.surfarray.pixels2d(page).T
    rgb = np.empty((*pixels.shape, 3), np.uint8)
    unpack(pixels, rgb)
    return rgb


@entry
def average(fine, page):
    """Means of 2 x 2 pixels of fine (2 H, 2 W) into page (H, W), both uint32; two of the four bytes at a time."""
    half, two, eight = np.uint32(0x00FF00FF), np.uint32(2), np.uint32(8)
    rounding = np.uint32(0x00020002)
    for y in range(page.shape[0]):
        upper, lower, row = fine[2 * y], fine[2 * y + 1], page[y]
        for x in range(page.shape[1]):
            a, b, c, d = upper[2 * x], upper[2 * x + 1], lower[2 * x], lower[2 * x + 1]
            even = ((a & half) + (b & half) + (c & half) + (d & half) + rounding) >> two
            odd = (
                (a >> eight & half) + (b >> eight & half) + (c >> eight & half) + (d >> eight & half) + rounding
            ) >> two
            row[x] = (even & half) | (odd & half) << eight


@entry
def unpack(page, rgb):
    """The bytes red, green, blue of page (H, W) uint32, red the third, into rgb (H, W, 3)."""
    for y in range(page.shape[0]):
        for x in range(page.shape[1]):
            pixel = page[y, x]
            rgb[y, x, 0] = pixel >> np.uint32(16) & np.uint32(0xFF)
            rgb[y, x, 1] = pixel >> np.uint32(8) & np.uint32(0xFF)
            rgb[y, x, 2] = pixel & np.uint32(0xFF)
