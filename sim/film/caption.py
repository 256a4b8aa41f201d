"""The caption below each frame: title, time, the key to the colours, and notes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from swarmd.sim.film.colours import Rgb

_BACK, _TEXT, _DIM = (255, 255, 255), (22, 25, 29), (90, 101, 114)
_LINES_A_FRAME = 32  # the height of a frame in lines of text
_SMALLEST = 13  # pixels of text


class Caption:
    """Draws the caption of one film."""

    def __init__(
        self,
        size: tuple[int, int],
        title: str,
        key: Sequence[tuple[Rgb, str]],
        notes: Sequence[str] = (),
    ) -> None:
        """`size` in pixels of the whole frame. A title or key that does not fit its line is cut."""
        self.width, height = size
        text = max(_SMALLEST, round(height / _LINES_A_FRAME))
        self._line = round(1.45 * text)
        self.height = 2 * (self._line + round(0.2 * text))
        self.height += (height - self.height) % 2  # the picture above needs an even height
        self._pad = round(0.6 * text)
        self._font = ImageFont.load_default(text)
        self._image = Image.new("RGB", (self.width, self.height), _BACK)
        self._draw = ImageDraw.Draw(self._image)
        self._top = round(0.2 * text)
        self._draw.text((self._pad, self._top), self._fitted(title), _TEXT, self._font)
        self._paint_key(key, notes)
        self._blank = np.asarray(self._image).copy()

    def below(self, picture: NDArray[np.uint8], time: str) -> NDArray[np.uint8]:
        """The picture with the caption and this time below it."""
        image = Image.fromarray(self._blank)
        width = self._length(time)
        place = (self.width - self._pad - width, self._top)
        ImageDraw.Draw(image).text(place, time, _TEXT, self._font)
        return np.concatenate((picture, np.asarray(image)))

    def _paint_key(self, key: Sequence[tuple[Rgb, str]], notes: Sequence[str]) -> None:
        side, gap = round(0.55 * self._line), self._pad
        text = "; ".join(notes)
        # Notes come before the key.
        room = self.width - 2 * self._pad - self._length(text) - self._length("...") - gap
        at, top = self._pad, self._top + self._line
        for colour, word in key:
            end = at + side + gap // 2 + self._length(word)
            if end > room:
                self._draw.text((at, top), "...", _TEXT, self._font)
                break
            high = top + (self._line - side) // 3
            self._draw.ellipse((at, high, at + side, high + side), fill=colour, outline=_DIM)
            self._draw.text((at + side + gap // 2, top), word, _TEXT, self._font)
            at = end + 2 * gap
        place = (self.width - self._pad - self._length(text), top)
        self._draw.text(place, text, _DIM, self._font)

    def _fitted(self, title: str) -> str:
        room = self.width - 2 * self._pad - self._length("  0000.0 s")
        kept = len(title)
        while kept and self._length(title[:kept]) > room:
            kept -= 1
        return title[:kept]

    def _length(self, text: str) -> int:
        return round(self._font.getlength(text))
