"""Numbers in words, the same on a picture and on the console."""

from __future__ import annotations

import math


def percent(part: float) -> str:
    """A part, rounded up to two digits so that "at most" stays true: 0.87 %."""
    if part <= 0:
        return "0 %"
    digits = 1 - math.floor(math.log10(100 * part))
    up = math.ceil(100 * part * 10**digits - 1e-9) / 10**digits
    return f"{up:.{max(digits, 0)}f}".rstrip("0").rstrip(".") + " %" if digits > 0 else f"{up:.0f} %"
