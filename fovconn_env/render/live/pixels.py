"""What is done with every pixel of a picture; pygame and numpy take five to ten times as long."""

from __future__ import annotations

import math

import numpy as np
import pygame

from fovconn_env.kernel.jit import entry, kernel

MASKS = (0xFF0000, 0xFF00, 0xFF, 0)  # of red, green and blue in 32 bits


def halve(fine: pygame.Surface, page: pygame.Surface) -> None:
    """Fill the top of the page, as wide as half of `fine`, with the means of 2 x 2 pixels: that smooths every edge."""
    pixels = pygame.surfarray.pixels2d(fine).T
    average(pixels, pygame.surfarray.pixels2d(page).T[: len(pixels) // 2])


def shade(surface: pygame.Surface, polygons: np.ndarray, colors: np.ndarray, alpha: int) -> None:
    """Lay polygons (P, n, 2), px, over a surface, translucent, one after the other; gfxdraw takes ten times as long.

    colors: (P,) uint32, as 0xRRGGBB; alpha: of 256.
    """
    blend(pygame.surfarray.pixels2d(surface).T, polygons, colors, alpha, np.empty(polygons.shape[1]))


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
def blend(pixels, polygons, colors, alpha, sides):
    """Mix colors (P,), alpha of 256, into what lies in polygons (P, n, 2) of pixels (H, W) uint32, row by row.

    Inside is what has an odd number of edges to its left. sides: (n,) scratch.
    """
    height, width = pixels.shape
    for p in range(polygons.shape[0]):
        corners = polygons[p]
        top, bottom = corners[0, 1], corners[0, 1]
        for k in range(corners.shape[0]):
            top, bottom = min(top, corners[k, 1]), max(bottom, corners[k, 1])
        for y in range(max(math.ceil(top - 0.5), 0), min(math.ceil(bottom - 0.5), height)):
            found = cross(corners, y + 0.5, sides)
            for k in range(0, found - 1, 2):
                left, right = max(math.ceil(sides[k] - 0.5), 0), min(math.ceil(sides[k + 1] - 0.5), width)
                mix(pixels[y, left : max(left, right)], colors[p], alpha)


@kernel
def cross(corners, y, sides):
    """Where the edges of a polygon (n, 2) cross a height y: how many do, their x in order in sides (n,)."""
    found = 0
    for k in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[k - 1, 0], corners[k - 1, 1] - y, corners[k, 0], corners[k, 1] - y
        if (y0 <= 0.0) == (y1 <= 0.0):
            continue
        x, at = x0 + y0 / (y0 - y1) * (x1 - x0), found
        while at > 0 and sides[at - 1] > x:
            sides[at] = sides[at - 1]
            at -= 1
        sides[at] = x
        found += 1
    return found


@kernel
def mix(row, color, alpha):
    """Mix a color into a row of pixels; two of the four bytes at a time."""
    half, eight = np.uint32(0x00FF00FF), np.uint32(8)
    share, rest = np.uint32(alpha), np.uint32(256 - alpha)
    even, odd = (color & half) * share, (color >> eight & half) * share
    for x in range(row.shape[0]):
        below = row[x]
        low = ((below & half) * rest + even) >> eight & half
        row[x] = low | ((below >> eight & half) * rest + odd) & ~half


@entry
def unpack(page, rgb):
    """The bytes red, green, blue of page (H, W) uint32, red the third, into rgb (H, W, 3)."""
    for y in range(page.shape[0]):
        for x in range(page.shape[1]):
            pixel = page[y, x]
            rgb[y, x, 0] = pixel >> np.uint32(16) & np.uint32(0xFF)
            rgb[y, x, 1] = pixel >> np.uint32(8) & np.uint32(0xFF)
            rgb[y, x, 2] = pixel & np.uint32(0xFF)
