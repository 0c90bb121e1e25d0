"""Contrast of colours to the paper that they are on, as WCAG 2 defines it, and what makes a figure
legible on any.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

_TEXT_CONTRAST = 4.5  # smallest contrast of texts with the paper
_LINE_CONTRAST = 3.0  # smallest contrast of lines with dark paper
_MIDDLE = 0.18  # luminance that is as far from black as from white
_GREY = 0.06  # largest difference of red, green and blue in a grey
_TO_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # weights of red, green and blue


def make_legible(figure: Figure, former_artists: set[Artist]) -> None:
    """Turn texts, and lines on dark paper, towards black or white as far as they need; names are no
    formulas.
    """
    sheet = _on(to_rgba(figure.figure.get_facecolor()), np.ones(3))
    artists = {artist for artist in artists_of(figure) if isinstance(artist, Text | Line2D)}
    for artist in artists - former_artists:
        if artist.axes is None:
            paper = sheet
        else:
            paper = _on(to_rgba(artist.axes.get_facecolor()), sheet)
        if isinstance(artist, Text):
            papers = (paper,) if artist.get_bbox_patch() else (sheet, paper)
            artist.set_parse_math(False)
            artist.set_color(legible(artist.get_color(), papers, _TEXT_CONTRAST))
        elif _luminance(paper) < _MIDDLE:
            artist.set_color(legible(artist.get_color(), (paper,), _LINE_CONTRAST))


def artists_of(parent: Artist) -> Iterator[Artist]:
    """Yield all artists within another, but the ticks of axes, which are made as they are drawn."""
    if isinstance(parent, Axis):
        children = [parent.label]
    else:
        children = parent.get_children()
    for child in children:
        yield child
        yield from artists_of(child)


def legible(color: Any, papers: Sequence[np.ndarray], lowest_contrast: float) -> np.ndarray:
    """Return the colour (3,), or the nearest towards black or white that has the lowest contrast
    [-] to papers in sRGB (3,), or more.

    A grey of too little contrast becomes as light as it is dark first, since what is fainter has to
    stay so.
    """
    rgb = np.array(to_rgb(color))
    black_or_white = np.full(3, float(_luminance(papers[0]) < _MIDDLE))
    shades = [rgb]
    if np.ptp(rgb) < _GREY:
        shades.append(1.0 - rgb)
    for share in np.linspace(0.05, 0.95, 19):
        shades.append((1.0 - share) * rgb + share * black_or_white)
    for shade in shades:
        if min(contrast(shade, paper) for paper in papers) >= lowest_contrast:
            return shade
    return black_or_white


def _on(color: tuple[float, float, float, float], paper: np.ndarray) -> np.ndarray:
    """Return the colour (3,) that a translucent one has on paper (3,)."""
    *rgb, opacity = color
    return opacity * np.array(rgb) + (1.0 - opacity) * paper


def contrast(color: np.ndarray, paper: np.ndarray) -> float:
    """Return the contrast of two colours in sRGB (3,), from 1 to 21, as WCAG 2 defines it."""
    dark, light = sorted((_luminance(color), _luminance(paper)))
    return (light + 0.05) / (dark + 0.05)


def _luminance(rgb: np.ndarray) -> float:
    """Return the relative luminance [-] of a colour in sRGB (3,), as WCAG 2 defines it."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ _TO_LUMINANCE)
