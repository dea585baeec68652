"""Give the pictures in docs/images palettes of 256 colours, half of the bytes or less: `python docs/shrink.py`."""

from pathlib import Path

from PIL import Image

IMAGES = Path(__file__).parent / "images"
COLORS = 256


def shrink(path: Path) -> None:
    """Rewrite a PNG with a palette, on white; one that has a palette stays as it is."""
    with Image.open(path) as picture:
        if picture.mode == "P":
            return
        opaque = Image.new("RGBA", picture.size, "white")
        opaque.alpha_composite(picture.convert("RGBA"))
    flat = opaque.convert("RGB").quantize(COLORS, Image.Quantize.MEDIANCUT, kmeans=8, dither=Image.Dither.NONE)
    flat.save(path, optimize=True)


if __name__ == "__main__":
    for path in sorted(IMAGES.rglob("*.png")):
        shrink(path)
