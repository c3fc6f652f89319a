"""Numbers as a speed study's page has them."""

from __future__ import annotations

from fluidsnet.studies.speed_row import Spread

#: In place of a number that there is none of.
NONE = "–"


def number(value: float | None, form: str = ".3g") -> str:
    """A number; without a form three digits of it, or all before the point."""
    if value is None:
        return NONE
    text = f"{value:{form}}"
    # The text decides: what is rounded up to 1,000 would have an exponent.
    return f"{value:,.0f}" if form == ".3g" and abs(float(text)) >= 1000 else text


def milliseconds(values: Spread) -> str:
    """The median, and in brackets the least and the most."""
    middle, least, most = (number(1000 * value) for value in values)
    return f"{middle} ({least} to {most})"
