"""Compiled operations on every pixel of a picture; pygame and numpy take five to ten times as long."""

from __future__ import annotations

import math

import numpy as np
import pygame

from fovconn_env.kernel.jit import entry, kernel

MASKS = (0xFF0000, 0xFF00, 0xFF, 0)  # of red, green and blue in 32 bits


def downsample(fine: pygame.Surface, page: pygame.Surface) -> None:
    """Fill the top of the page, as wide as half of `fine`, with the means of 2 x 2 pixels, which smooths edges."""
    pixels = pygame.surfarray.pixels2d(fine).T
    average(pixels, pygame.surfarray.pixels2d(page).T[: len(pixels) // 2])


def shade(surface: pygame.Surface, polygons: np.ndarray, colors: np.ndarray, alpha: int) -> None:
    """Draw translucent polygons (P, n, 2), px, one after the other; gfxdraw takes ten times as long.

    colors: (P,) uint32, as 0xRRGGBB; alpha: of 256.
    """
    blend_polygons(pygame.surfarray.pixels2d(surface).T, polygons, colors, alpha, np.empty(polygons.shape[1]))


def rgb_array(page: pygame.Surface) -> np.ndarray:
    """The page as a new array (height, width, 3) uint8."""
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
def blend_polygons(pixels, polygons, colors, alpha, sides):
    """Mix colors (P,), alpha of 256, into the polygons (P, n, 2) of pixels (H, W) uint32, row by row.

    A pixel with an odd number of edges to its left is inside. sides: (n,) scratch.
    """
    height, width = pixels.shape
    for p in range(polygons.shape[0]):
        corners = polygons[p]
        top, bottom = corners[0, 1], corners[0, 1]
        for k in range(corners.shape[0]):
            top, bottom = min(top, corners[k, 1]), max(bottom, corners[k, 1])
        for y in range(max(math.ceil(top - 0.5), 0), min(math.ceil(bottom - 0.5), height)):
            count = find_crossings(corners, y + 0.5, sides)
            for k in range(0, count - 1, 2):
                left, right = max(math.ceil(sides[k] - 0.5), 0), min(math.ceil(sides[k + 1] - 0.5), width)
                blend_row(pixels[y, left : max(left, right)], colors[p], alpha)


@kernel
def find_crossings(corners, y, sides):
    """Number of edges of a polygon (n, 2) that cross the height y; their x, sorted, are written to sides (n,)."""
    count = 0
    for k in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[k - 1, 0], corners[k - 1, 1] - y, corners[k, 0], corners[k, 1] - y
        if (y0 <= 0.0) == (y1 <= 0.0):
            continue
        x, k_x = x0 + y0 / (y0 - y1) * (x1 - x0), count
        while k_x > 0 and sides[k_x - 1] > x:
            sides[k_x] = sides[k_x - 1]
            k_x -= 1
        sides[k_x] = x
        count += 1
    return count


@kernel
def blend_row(row, color, alpha):
    """Mix a color, alpha of 256, into a row of pixels; two of the four bytes at a time."""
    half, eight = np.uint32(0x00FF00FF), np.uint32(8)
    share, rest = np.uint32(alpha), np.uint32(256 - alpha)
    even, odd = (color & half) * share, (color >> eight & half) * share
    for x in range(row.shape[0]):
        pixel = row[x]
        low = ((pixel & half) * rest + even) >> eight & half
        row[x] = low | ((pixel >> eight & half) * rest + odd) & ~half


@entry
def unpack(page, rgb):
    """Write red, green and blue of page (H, W) uint32, 0xRRGGBB, to rgb (H, W, 3)."""
    for y in range(page.shape[0]):
        for x in range(page.shape[1]):
            pixel = page[y, x]
            rgb[y, x, 0] = pixel >> np.uint32(16) & np.uint32(0xFF)
            rgb[y, x, 1] = pixel >> np.uint32(8) & np.uint32(0xFF)
            rgb[y, x, 2] = pixel & np.uint32(0xFF)
