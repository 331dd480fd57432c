"""How a number is written: as many digits as its interval supports, no more."""

from __future__ import annotations

import math

LARGEST_DIGITS = 3
"""Most significant digits ever printed: beyond that a table cannot be read."""

_WIDE = 4.0
"""Bounds this far apart, as a ratio, get two significant digits each, whatever the value has."""


def decimals_for(value: float, low: float | None = None, high: float | None = None) -> int:
    """Decimal places that the interval supports.

    The half-width gets two significant digits if they are below 36 and one if they are above
    (so that rounding changes it by a few percent at most; the Particle Data Group's rule).
    Without an interval, three significant digits of the value. Never fewer than two significant
    digits of the value, never more than :data:`LARGEST_DIGITS`. The answer may be negative:
    -2 means hundreds.
    """
    magnitude = _magnitude(value)
    least, most = 1 - magnitude, LARGEST_DIGITS - 1 - magnitude
    half = _half_width(low, high)
    wanted = 2 - magnitude
    if half is not None:
        leading = half / 10.0 ** (_magnitude(half) - 1)
        wanted = (1 if leading < 35.5 else 0) - _magnitude(half)
    return min(max(wanted, least), most)


def plain(value: float, decimals: int) -> str:
    """``value`` with ``decimals`` places, in scientific form where digits would drown it."""
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    magnitude = _magnitude(value)
    if value != 0 and (magnitude < -3 or magnitude >= 5):
        digits = min(max(magnitude + decimals, 0), LARGEST_DIGITS - 1)
        mantissa, exponent = f"{value:.{digits}e}".split("e")
        return f"{mantissa}e{int(exponent)}".replace("-", "−")
    return f"{round(value, decimals):.{max(decimals, 0)}f}".replace("-", "−")


def with_interval(value: float, low: float | None, high: float | None) -> tuple[str, str]:
    """(value, interval) as text, e.g. ``("1.87", "[1.72, 2.02]")``; interval "" if unknown."""
    decimals = decimals_for(value, low, high)
    if _half_width(low, high) is None:
        return ("0" if value == 0 else plain(value, decimals)), ""
    text = plain(value, decimals)
    if low > 0 and high > _WIDE * low:
        bounds = [plain(bound, 1 - _magnitude(bound)) for bound in (low, high)]
    else:
        bounds = [_bound(bound, decimals) for bound in (low, high)]
    return text, f"[{bounds[0]}, {bounds[1]}]"


def plain_bound(value: float) -> str:
    """A bound with two significant digits."""
    return plain(value, 1 - _magnitude(value))


def p_value(p: float) -> str:
    """A p-value; below a thousandth only that it is."""
    return "<0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def count(value: float) -> str:
    """A count in three digits with k / M / G."""
    for factor, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= 0.9995 * factor:
            scaled = value / factor
            return f"{plain(scaled, max(0, 2 - _magnitude(scaled)))} {suffix}"
    return f"{value:.0f}"


def size(value: float) -> str:
    """Bytes with binary prefixes."""
    for factor, suffix in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if value >= 0.9995 * factor:
            scaled = value / factor
            return f"{plain(scaled, max(0, 2 - _magnitude(scaled)))} {suffix}"
    return f"{value:.0f} B"


def duration(seconds: float) -> str:
    """A duration in the unit that suits it."""
    if seconds == 0:
        return "0 s"
    units = ((3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"), (1e-6, "µs"))
    factor, suffix = next((u for u in units if seconds >= 0.9995 * u[0]), units[-1])
    scaled = seconds / factor
    return f"{plain(scaled, max(0, 1 - _magnitude(scaled)))} {suffix}"


def duration_with_interval(value: float, low: float, high: float) -> str:
    """``26 s [24 s, 29 s]``; the value alone where the ends read the same."""
    said, *ends = (duration(float(v)) for v in (value, low, high))
    return said if ends[0] == ends[1] else f"{said} [{ends[0]}, {ends[1]}]"


def _bound(value: float, decimals: int) -> str:
    """A bound of an interval: the value's places, but no more digits than can be read."""
    return plain(value, min(decimals, LARGEST_DIGITS - 1 - _magnitude(value)))


def _half_width(low: float | None, high: float | None) -> float | None:
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return None
    half = (high - low) / 2
    return half if half > 0 else None


def _magnitude(value: float) -> int:
    """Decimal exponent of ``value``; 0 for zero and infinity, which have none."""
    if value == 0 or not math.isfinite(value):
        return 0
    return math.floor(math.log10(abs(value)))
