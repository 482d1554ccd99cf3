"""HTML files without any outside link, from the templates beside the modules: pictures are
inlined, and every text is escaped.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

import arfx
from arfx.core.opener import printable
from arfx.errors import RenderError, counted

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def _templates() -> Environment:
    from jinja2 import ChainableUndefined, Environment, FileSystemLoader

    found = Environment(
        autoescape=lambda name: str(name).endswith(".html"),
        finalize=_told,
        undefined=ChainableUndefined,
        loader=FileSystemLoader(Path(arfx.__file__).parent),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {
        "jpeg": jpeg,
        "png": png,
        "json": json.dumps,
        "counted": counted,
        "percent": percent,
        "cell": lambda text: re.sub("[\t\n]", " ", text),
    }
    return found


def render(template: str, **values: Any) -> str:
    """The page that a template makes of these values.

    template : path from the package, "measure/batch.html". What it puts out is told by
    `number`; `jpeg` and `png` are filters that make a picture's address
    Raises ValueError for values that are not of the template's form.
    """
    from jinja2 import UndefinedError

    try:
        return _templates().get_template(template).render(**values)
    except UndefinedError as e:
        raise ValueError(str(e)) from e


def _told(value: Any) -> Any:
    return value if hasattr(value, "__html__") else printable(number(value))


def number(value: Any) -> str:
    """A value for reading: 3 significant digits, dashes for nothing, yes and no."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(number(v) for v in value) or "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {number(v)}" for k, v in value.items()) or "–"
    return str(value)


def percent(share: float, digits: int = 0) -> str:
    return f"{share:.{digits}%}"


def jpeg(rgb: ndarray, quality: int = 88) -> str:
    """The address of an (h, w, 3) uint8 RGB picture; quality : 0 to 100"""
    import cv2

    ok, data = cv2.imencode(
        ".jpg",
        np.ascontiguousarray(rgb[..., ::-1]),
        [cv2.IMWRITE_JPEG_QUALITY, quality],
    )
    if not ok:
        raise RenderError(f"a picture of shape {rgb.shape} cannot be encoded")
    return _address(data.tobytes(), "image/jpeg")


def png(data: bytes) -> str:
    """The address of a PNG file's content."""
    return _address(data, "image/png")


def _address(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
